"""Error of the failing load against processor time and memory, on a beam and on a plate: docs/speed_vs_error.md.

Each run has a folder in runs/speed_vs_error/. ``--fine`` adds the finest cells, which the reference needs. Rows of
peers come from ``tools/benchmarks/oofem_beam`` and ``lammps_plate``, whose output stands in the same folder; without it
the study says so, and draws the rest.
"""

from __future__ import annotations

import re
import resource
from collections.abc import Sequence
from dataclasses import dataclass

from tools.studies.series import DOCS, RUNS, Results, fill, kept, parser_of, run_deck, summary_of, table
from tools.studies.speed_vs_error.cases import ALL, FINEST, SOFT, Case, cases, plate_cases
from tools.studies.speed_vs_error.drawing import Mark, draw

FOLDER = RUNS / "speed_vs_error"
COSTS = Results(FOLDER / "costs")
DOCUMENT, FIGURES = DOCS / "speed_vs_error.md", DOCS / "figures"
NUMBER = r"(?P<{}>[\d,.]+)"
COST = f"{NUMBER.format('seconds')} s of a processor, {NUMBER.format('memory')} MiB"


@dataclass(frozen=True)
class Peer:
    """Another program: its words, the file with what its script of tools/benchmarks printed, and a line of that."""

    group: str
    script: str
    file: str
    line: re.Pattern


BEAM_PEER = Peer(
    "OOFEM, smeared cracks", "oofem_beam --plane-strain", "oofem.txt",
    re.compile(rf"elements of (?P<edge>\S+): .* peak {NUMBER.format('peak')} N .*, {COST}"),
)  # fmt: skip
PLATE_PEER = Peer(
    "LAMMPS, peri/pmb", "lammps_plate", "lammps.txt",
    re.compile(
        rf"cells of (?P<edge>\S+): .* first break {NUMBER.format('first')} lbf, peak {NUMBER.format('peak')} lbf, "
        rf"{NUMBER.format('steps')} steps, {COST}"
    ),
)  # fmt: skip


@dataclass(frozen=True)
class Row:
    """What came of a case, or of a peer: loads of the whole body, processor seconds with start-up, MiB."""

    group: str
    spacing: float
    setting: str
    first: float | None
    peak: float
    sweeps: int | None
    seconds: float
    memory: float


def run(case: Case) -> None:
    """Run a case, and keep what it cost."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = run_deck(case.deck, case.overrides(), FOLDER / case.name, "--overwrite", check=False)
    if done.returncode:
        print(f"{case.name} gave no result:\n{done.stdout[-500:]}{done.stderr[-500:]}", flush=True)
        return
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    COSTS.write(case.name, None, {"seconds": after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime})


def row_of(case: Case) -> Row | None:
    """The row of a case; None without a result."""
    summary, cost = summary_of(FOLDER / case.name), COSTS.read(case.name)
    if summary.get("exit_code") != 0 or cost is None:
        return None
    failure = summary["failure"]
    memory = max(summary["memory"]["peak_bytes_per_rank"]) / 2**20
    first, peak = (case.scale * failure[name]["load"] for name in ("first_break", "peak"))
    sweeps = summary["solve"]["evaluations"]
    return Row(case.group, case.spacing, case.setting, first, peak, sweeps, cost["seconds"], memory)


def peer_rows(peer: Peer) -> list[Row]:
    """What a peer gave; empty, and a sentence, where it was not run."""
    path = FOLDER / peer.file
    if not path.exists():
        print(f"{path.name} is missing: no rows of {peer.group} (tools/benchmarks/{peer.script} > {path}).")
        return []
    rows = []
    for match in peer.line.finditer(path.read_text(encoding="utf-8")):
        of = {name: float(text.replace(",", "")) for name, text in match.groupdict().items()}
        steps = int(of["steps"]) if "steps" in of else None
        rows.append(Row(peer.group, of["edge"], "", of.get("first"), of["peak"], steps, of["seconds"], of["memory"]))
    return rows


def richardson(coarse: float, middle: float, fine: float) -> tuple[float, float]:
    """The limit of three peaks at cells halved twice, and how far the finest is from it.

    The order is that of the three; differences that do not shrink have no limit, and the finest stands for it, with
    the last difference as its error.
    """
    one, two = middle - coarse, fine - middle
    if one == two or abs(two) >= abs(one):
        return fine, abs(two)
    rest = two * two / (one - two)
    return fine + rest, abs(rest)


def reference(rows: Sequence[Row]) -> tuple[float, float] | None:
    """Limit of the peaks, and how far the finest cells are from it; None where there are too few.

    That of the peer, an independent discretisation of the same curve, by its two finest cells and an error in the
    square of their size; else that of bonds that soften at three cell sizes.
    """
    peer = sorted((row.spacing, row.peak) for row in rows if row.group == BEAM_PEER.group)
    if len(peer) > 1:
        (fine, one), (coarse, two) = peer[:2]
        rest = (one - two) / ((coarse / fine) ** 2 - 1.0)
        return one + rest, abs(rest)
    peaks = {row.spacing: row.peak for row in rows if row.group == SOFT and not row.setting}
    return richardson(*(peaks[h] for h in FINEST)) if all(h in peaks for h in FINEST) else None


def rows_table(rows: Sequence[Row], limit: float | None) -> list[str]:
    """All rows, each with its error."""
    head = ["what", "cells / mm", "first break / N", "peak / N", "error %", "sweeps", "processor s", "MiB"]
    lines = []
    for row in rows:
        error = "" if limit is None else f"{100.0 * (row.peak / limit - 1.0):+.1f}"
        lines.append([
            ", ".join(part for part in (row.group, row.setting) if part), f"{row.spacing:g}",
            "" if row.first is None else f"{row.first:,.0f}", f"{row.peak:,.0f}", error,
            "" if row.sweeps is None else f"{row.sweeps:,}", f"{row.seconds:.0f}", f"{row.memory:.0f}",
        ])  # fmt: skip
    return table(head, lines)


def plate_errors(rows: Sequence[Row]) -> dict[Row, tuple[float, float]]:
    """Errors of first break and peak in percent, against bonds everywhere in the same cells.

    The setting is the same, too, where it was run everywhere (a Poisson's ratio), else it is that without any.
    """
    everywhere = {(row.spacing, row.setting): row for row in rows if row.group == ALL}
    found = {}
    for row in rows:
        right = everywhere.get((row.spacing, row.setting)) or everywhere.get((row.spacing, ""))
        if right is not None:
            found[row] = tuple(
                100.0 * (mine / its - 1.0) for mine, its in ((row.first, right.first), (row.peak, right.peak))
            )
    return found


def plate_table(rows: Sequence[Row]) -> list[str]:
    """All rows of the plate, each with its errors."""
    head = [
        "what", "cells / in", "first break / lbf", "error %", "peak / lbf", "error %", "sweeps", "processor s", "MiB"
    ]  # fmt: skip
    errors, lines = plate_errors(rows), []
    for row in rows:
        first, peak = (f"{error:+.2f}" for error in errors[row]) if row in errors else ("", "")
        itself = row.group == ALL
        lines.append([
            ", ".join(part for part in (row.group, row.setting) if part), f"{row.spacing:g}", f"{row.first:,.0f}",
            "0" if itself else first, f"{row.peak:,.0f}", "0" if itself else peak, f"{row.sweeps:,}",
            f"{row.seconds:.1f}", f"{row.memory:.0f}",
        ])  # fmt: skip
    return table(head, lines)


def marks_of_beam(rows: Sequence[Row], limit: float | None) -> list[Mark]:
    """Marks of the first chart; none without a reference."""
    return [
        Mark(row.group, not row.setting, row.seconds, row.memory, 100.0 * (row.peak / limit - 1.0))
        for row in (rows if limit else ())
    ]


def marks_of_plate(rows: Sequence[Row]) -> list[Mark]:
    """Marks of the second chart, by the larger of the two errors."""
    return [
        Mark(row.group, not row.setting, row.seconds, row.memory, max(errors, key=abs))
        for row, errors in plate_errors(rows).items()
    ]


def main(arguments: Sequence[str]) -> int:
    """Run what is left, fill the tables and draw the figures."""
    options = parser_of(
        __doc__, fine="the finest cells of the beam, too", keep="keep rows and figures whose runs are not here"
    ).parse_args(arguments)
    wanted = [case for case in [*cases(options.fine), *plate_cases()] if options.only in case.name]
    for case in wanted:
        if row_of(case) is None:
            print(case.name, flush=True)
            if not (options.dry_run or options.report):
                run(case)
    if options.dry_run:
        return 0
    rows = [row for case in cases(fine=True) if (row := row_of(case)) is not None] + peer_rows(BEAM_PEER)
    plate = [row for case in plate_cases() if (row := row_of(case)) is not None] + peer_rows(PLATE_PEER)
    found = reference(rows)
    if found is not None:
        print(f"reference {found[0]:,.1f} N, the finest cells within {found[1]:,.1f} N of it")
    limit = found and found[0]
    tables = {"rows": rows_table(rows, limit), "plate": plate_table(plate)}
    if options.keep:
        tables = {name: kept(lines, DOCUMENT, name, 2) for name, lines in tables.items()}
    fill(DOCUMENT, tables)
    for name, of, marks, what, floor in (
        ("speed_vs_error", cases(fine=False), marks_of_beam(rows, limit), "error of the peak", 0.1),
        (
            "speed_vs_error_plate",
            plate_cases(),
            marks_of_plate(plate),
            "error of first break and peak, the larger",
            0.01,
        ),
    ):
        if not (options.keep and any(row_of(case) is None for case in of)):
            draw(FIGURES / f"{name}.svg", marks, what, floor)
    return 0
