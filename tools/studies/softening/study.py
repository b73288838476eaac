"""Bodies whose bonds soften at cells h, h/2 and h/4, and with one setting changed at a time: docs/failure.md.

Strength and fracture energy are the material's, the internal length is the cells' edge. Brittle members have the
critical stretch of the same fracture energy (at the coarse cells; it follows the cells). ``--full`` adds peaks at h/4,
whose runs end soon after them. Each run has a folder in runs/softening_study/. With ``--keep`` those rows of the page
stay whose runs are not here.
"""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from tools.studies.series import DOCS, RUNS, fill, kept, parser_of, program, summary_of, table
from tools.studies.softening.bodies import BODIES, with_length

FOLDER = RUNS / "softening_study"
DOCUMENT = DOCS / "failure.md"
#: Of the peak, where runs end that are not followed to separation.
PAST_PEAK = "0.85"
#: By how many cells rows of a table are told apart.
KEYS = {"convergence": 2, "settings": 1, "batches": 1}
#: How bonds go on together, and how far the rest relaxes between two batches: of three bodies at their coarse cells.
BATCHES: dict[str, dict[str, str]] = {
    "eta 1e-3": {"stepping.eta": "1e-3"},
    "defaults": {},
    "eta 1.5e-2": {"stepping.eta": "1.5e-2"},
    "eta 2e-2": {"stepping.eta": "2e-2"},
    "eta 3e-2": {"stepping.eta": "3e-2"},
    "inner iterations 2": {"stepping.inner_iterations": "2"},
    "inner iterations 3": {"stepping.inner_iterations": "3"},
}
PLATES = ("centre crack", "hole", "notch")
#: One setting at a time, of the centre crack at its coarse cells.
SETTINGS: dict[str, dict[str, str]] = {
    **{name: BATCHES[name] for name in ("defaults", "eta 1e-3", "eta 3e-2")},
    "inner iterations 8": {"stepping.inner_iterations": "8"},
    "inner iterations 16": {"stepping.inner_iterations": "16"},
    "arrest tolerance 1e-4": {"stepping.arrest_tolerance": "1e-4"},
    "tooth ratio 1.1": {"stepping.tooth_ratio": "1.1"},
    "tooth ratio 1.5": {"stepping.tooth_ratio": "1.5"},
    "noise 0.02": {"peridynamics.stiffness_noise": "0.02"},
    "noise seed 1": {"peridynamics.seed": "1"},
    "appendix A": {"peridynamics.surface_correction": "appendix_a"},
    "energy control": {"stepping.control": "energy"},
}


@dataclass(frozen=True)
class Case:
    """One run: a body at cells of its ``h / level``, with settings, of bonds that soften or are brittle."""

    body: str
    level: int = 1
    setting: str = "defaults"
    brittle: bool = False

    @property
    def name(self) -> str:
        """Of its folder."""
        parts = (self.body, str(self.level), self.setting, "brittle" if self.brittle else "")
        return "-".join(part for part in parts if part).replace(" ", "_")

    @property
    def folder(self) -> Path:
        """Of its run."""
        return FOLDER / self.name

    @property
    def short(self) -> bool:
        """Whether it ends soon after its peak."""
        return self.level == 4

    @property
    def h(self) -> float:
        """Edge of its cells."""
        return BODIES[self.body].h / self.level


CASES = (
    *(Case(body, level) for level in (1, 2) for body in BODIES),
    *(Case(body, level, brittle=True) for level in (1, 2) for body in PLATES),
    *(Case("centre crack", setting=setting) for setting in SETTINGS if setting != "defaults"),
    *(Case(body, setting=setting) for body in PLATES for setting in BATCHES),
)
CASES = tuple(dict.fromkeys(CASES))  # some serve two tables
FULL = tuple(Case(body, 4) for body in PLATES)


def deck_of(case: Case) -> Path:
    """Write the deck of a case, and its mesh."""
    body = BODIES[case.body]
    material: Mapping[str, object] = body.material
    if case.brittle:
        keys = ("youngs_modulus", "fracture_energy")
        material = {key: body.material[key] for key in keys}
    folder = FOLDER / "decks"
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{case.name}.toml"
    text = with_length(body.write(case.h, material, folder), case.h)
    if case.short:
        text = re.sub(r"end_reaction = \S+", f"end_reaction = {PAST_PEAK}", text)
    path.write_text(text, encoding="utf-8")
    return path


def run(case: Case) -> None:
    """Run a case that has no result."""
    sets = [f"--set={key}={value}" for key, value in (SETTINGS | BATCHES)[case.setting].items()]
    command = [program(), "run", str(deck_of(case)), *sets, "--out", str(case.folder), "--overwrite"]
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode:
        sys.exit(f"{' '.join(command)}\n{done.stdout[-2000:]}{done.stderr[-2000:]}")


def loads_of(case: Case) -> dict | None:
    """First break and peak of the whole thickness, sweeps, energy over own G_c and the ligament; None without a run."""
    summary = summary_of(case.folder)
    if summary.get("exit_code") != 0:
        return None
    failure, body = summary["failure"], BODIES[case.body]
    scale = body.thickness / case.h
    own = failure["crack"]["area"] * failure["fracture_energy"]["bulk"] / failure["fracture_energy"]["own_bonds"][0]
    return {
        "first": scale * failure["first_break"]["load"],
        "peak": scale * failure["peak"]["load"],
        "at": failure["peak"]["displacement"],
        "area": own / (body.ligament * case.h),
        "sweeps": summary["solve"]["evaluations"],
        "seconds": summary["seconds"]["total"],
    }


def convergence_table() -> list[str]:
    """Bodies over cells, softening and brittle side by side."""
    head = ["body", "cells", "first softening", "peak", "change", "at", "energy of gone bonds / G_c A", "sweeps",
            "over brittle's", "brittle peak", "change"]  # fmt: skip
    rows = []
    for body in BODIES:
        before: dict[bool, float] = {}

        def peak(found: dict | None, brittle: bool, before: dict[bool, float] = before) -> list[str]:
            if not found:
                return ["", ""]
            last, before[brittle] = before.get(brittle), found["peak"]
            return [f"{found['peak']:,.0f}", f"{100.0 * (found['peak'] / last - 1.0):+.1f} %" if last else ""]

        for level in (1, 2, 4):
            case = Case(body, level)
            if (found := loads_of(case)) is None:
                continue
            brittle = loads_of(Case(body, level, brittle=True))
            rows.append([
                body, f"{case.h:g}", f"{found['first']:,.0f}", *peak(found, False), f"{found['at']:.4g}",
                *(["", ""] if case.short else [f"{found['area']:.2f}", f"{found['sweeps']:,}"]),
                f"{found['sweeps'] / brittle['sweeps']:.1f}" if brittle else "", *peak(brittle, True),
            ])  # fmt: skip
    return table(head, rows)


def settings_table() -> list[str]:
    """The centre crack at its coarse cells, one setting at a time."""
    base = loads_of(Case("centre crack"))
    rows = []
    for setting in SETTINGS:
        if (found := loads_of(Case("centre crack", setting=setting))) is not None and base:
            change = 100.0 * (found["peak"] / base["peak"] - 1.0)
            rows.append([setting, f"{found['peak']:,.1f}", f"{change:+.2f} %", f"{found['sweeps']:,}"])
    return table(["setting", "peak / lbf", "against the defaults", "sweeps"], rows)


def batches_table() -> list[str]:
    """Settings of batches, and the peak and the sweeps of each body."""
    head = ["setting", *(word for body in PLATES for word in (f"{body}: peak / lbf", "sweeps"))]
    bases = {body: loads_of(Case(body, setting="eta 1e-3")) for body in PLATES}

    def cells(body: str, setting: str) -> list[str]:
        found, base = loads_of(Case(body, setting=setting)), bases[body]
        if not found or not base:
            return []
        change = "" if found == base else f" ({100.0 * (found['peak'] / base['peak'] - 1.0):+.1f} %)"
        return [f"{found['peak']:,.0f}{change}", f"{found['sweeps']:,}"]

    rows = [[setting, *(word for body in PLATES for word in cells(body, setting))] for setting in BATCHES]
    return table(head, [row for row in rows if len(row) == len(head)])


def main(arguments: Sequence[str]) -> None:
    """Run what is left and fill the tables."""
    parser = parser_of(__doc__, full="peaks at cells of h/4, too", keep="keep rows whose runs are not here")
    options = parser.parse_args(arguments)
    cases = [case for case in CASES + (FULL if options.full else ()) if options.only in case.name]
    left = [case for case in cases if loads_of(case) is None]
    for case in left:
        print(case.name, flush=True)
        if not (options.dry_run or options.report):
            run(case)
    if not options.dry_run:
        tables = {"convergence": convergence_table(), "settings": settings_table(), "batches": batches_table()}
        if options.keep:
            tables = {name: kept(lines, DOCUMENT, name, KEYS[name]) for name, lines in tables.items()}
        fill(DOCUMENT, tables)
