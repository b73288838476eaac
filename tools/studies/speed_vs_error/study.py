"""Error of the peak against processor time and memory, on a beam that softens: docs/speed_vs_error.md.

Each run has a folder in runs/speed_vs_error/. ``--fine`` adds the finest cells, which the reference needs. A peer's
rows come from ``tools/benchmarks/oofem_beam``, whose output stands in runs/speed_vs_error/oofem.txt; without it the
study says so, and draws the rest.
"""

from __future__ import annotations

import re
import resource
from collections.abc import Sequence
from dataclasses import dataclass

from tools.studies.series import DOCS, RUNS, Results, fill, parser_of, run_deck, summary_of, table
from tools.studies.speed_vs_error.cases import DECK, FINEST, SOFT, THICKNESS, Case, cases
from tools.studies.speed_vs_error.drawing import draw

FOLDER = RUNS / "speed_vs_error"
COSTS = Results(FOLDER / "costs")
PEER = FOLDER / "oofem.txt"
PEER_GROUP = "OOFEM, smeared cracks"
DOCUMENT, FIGURE = DOCS / "speed_vs_error.md", DOCS / "figures" / "speed_vs_error.svg"
PEER_LINE = re.compile(
    r"elements of (?P<edge>\S+): .* peak (?P<peak>[\d,]+) N .* (?P<seconds>\S+) s of a processor, (?P<memory>\d+) MiB"
)


@dataclass(frozen=True)
class Row:
    """What came of a case, or of a peer: loads in N of the whole beam, processor seconds with start-up, MiB."""

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
    done = run_deck(DECK, case.overrides(), FOLDER / case.name, "--overwrite", check=False)
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
    scale, failure = THICKNESS / case.spacing, summary["failure"]
    memory = max(summary["memory"]["peak_bytes_per_rank"]) / 2**20
    first, peak = (scale * failure[name]["load"] for name in ("first_break", "peak"))
    sweeps = summary["solve"]["evaluations"]
    return Row(case.group, case.spacing, case.setting, first, peak, sweeps, cost["seconds"], memory)


def peer_rows() -> list[Row]:
    """What OOFEM gave; empty, and a sentence, where it was not run."""
    if not PEER.exists():
        print(f"{PEER.name} is missing: no rows of OOFEM (tools/benchmarks/oofem_beam > {PEER}).")
        return []
    found = PEER_LINE.finditer(PEER.read_text(encoding="utf-8"))
    return [
        Row(PEER_GROUP, float(m["edge"]), "", None, float(m["peak"].replace(",", "")), None,
            float(m["seconds"]), float(m["memory"]))
        for m in found
    ]  # fmt: skip


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
    peer = sorted((row.spacing, row.peak) for row in rows if row.group == PEER_GROUP)
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


def main(arguments: Sequence[str]) -> int:
    """Run what is left, fill the table and draw the figure."""
    options = parser_of(__doc__, fine="the finest cells, too").parse_args(arguments)
    wanted = [case for case in cases(options.fine) if options.only in case.name]
    for case in wanted:
        if row_of(case) is None:
            print(case.name, flush=True)
            if not (options.dry_run or options.report):
                run(case)
    if options.dry_run:
        return 0
    rows = [row for case in cases(fine=True) if (row := row_of(case)) is not None] + peer_rows()
    found = reference(rows)
    if found is not None:
        print(f"reference {found[0]:,.1f} N, the finest cells within {found[1]:,.1f} N of it")
    fill(DOCUMENT, {"rows": rows_table(rows, found and found[0])})
    draw(FIGURE, rows, found and found[0])
    return 0
