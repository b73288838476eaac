"""The plate with the cutout broken in many settings: the tables of docs/failure.md.

Each case is a run folder in runs/failure_study/; one that holds a finished run of the same settings is kept. ``--full``
adds the paper's spacing. A case without a run is marked in its table.
"""

from __future__ import annotations

import json
import sys
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tools.studies.series import DOCS, JOBS, RUNS, Results, fill, parser_of, rows_of, run_deck, summary_of, table

RESULTS = Results(RUNS / "failure_study")
DECK = "plate_cutout.toml"
#: Exit codes of a run that counts: finished, or apart.
ENDED = (0, 74)
COARSE = 0.1  # twice the paper's spacing: two cells across the thickness
PAPERS_INCREMENT = 3.125e-6  # of the load factor, an iteration: 3.125e-8 in of 0.01 in
QUIET = {f"output.{name}": "false" for name in ("fields", "figures", "damage")}
RAMP_ROWS = 1.0e-3  # of the load factor between two rows of a ramp


@dataclass(frozen=True)
class Case:
    """One run: a name, and what it overrides in the deck."""

    name: str
    label: str
    overrides: tuple[tuple[str, str], ...] = ()
    full: bool = False

    @property
    def settings(self) -> dict[str, str]:
        """All overrides, as text."""
        return {"mesh.spacing": repr(COARSE)} | QUIET | dict(self.overrides)


def events(name, label, **keys):
    """A case of events with other stepping keys."""
    return Case(name, label, tuple((f"stepping.{key}", repr(value)) for key, value in keys.items()))


def noisy(amplitude, seed):
    """A case with seeded noise of the bonds' stiffness."""
    keys = (("peridynamics.stiffness_noise", repr(amplitude)), ("peridynamics.seed", repr(seed)))
    return Case(f"noise-{amplitude:g}-{seed}", f"{amplitude:g}, seed {seed}", keys)


def ramp(times):
    """A ramp so many times faster than the paper's."""
    increment = PAPERS_INCREMENT * times
    table = f'{{kind = "ramp", increment = {increment!r}, report_every = {max(1, round(RAMP_ROWS / increment))}}}'
    return Case(f"ramp-{times}", f"{times} x", (("solver.kind", '"adr"'), ("stepping", table)))


BASE = Case("base", "default")
OF_BASE = {  # what the base case is in each section
    "eta": "1e-3, the default", "inner_iterations": "8, the default", "arrest_tolerance": "1e-3, the default",
    "noise": "none", "ramp": "events instead", "Delta": "0.1",
}  # fmt: skip
SECTIONS = (
    ("eta", "eta", (
        events("eta-1e-6", "1e-6", eta=1e-6), events("eta-1e-4", "1e-4", eta=1e-4), BASE,
        events("eta-1e-2", "1e-2", eta=1e-2),
    )),
    ("inner_iterations", "sweeps between batches", (
        events("inner-2", "2", inner_iterations=2), events("inner-4", "4", inner_iterations=4), BASE,
        events("inner-16", "16", inner_iterations=16),
        events("inner-200", "to the arrest tolerance", inner_iterations=200),
    )),
    ("arrest_tolerance", "arrest tolerance", (
        events("arrest-1e-2", "1e-2", arrest_tolerance=1e-2), BASE,
        events("arrest-1e-4", "1e-4", arrest_tolerance=1e-4),
    )),
    ("noise", "stiffness noise", (BASE, noisy(1e-3, 1), noisy(1e-3, 2), noisy(1e-3, 3), noisy(1e-2, 1))),
    ("ramp", "rate, of the paper's", (ramp(300), ramp(100), ramp(30), ramp(10), BASE)),
    ("Delta", "spacing / in", (
        BASE,
        Case("spacing-0.05", "0.05, the paper's", (("mesh.spacing", "0.05"),), full=True),
    )),
)  # fmt: skip


def all_cases() -> list[Case]:
    """Every case once, in the order of the sections."""
    return list(dict.fromkeys(case for _, _, cases in SECTIONS for case in cases))


def identity(case: Case) -> dict[str, Any]:
    """What a run depends on: the settings, and the deck without its comments, as JSON holds it."""
    return json.loads(json.dumps({"settings": case.settings, "deck": tomllib.loads((JOBS / DECK).read_text())}))


def is_done(case: Case) -> bool:
    """Whether there is a finished run with these settings of this deck."""
    return RESULTS.read(case.name, identity(case)) is not None


def run_case(case: Case, ranks: int) -> None:
    """Run it, and keep how it ended."""
    done = run_deck(DECK, case.settings, RESULTS.folder / case.name, "-n", str(ranks), "--overwrite", check=False)
    if done.returncode not in ENDED:
        sys.exit(f"{case.name}: exit code {done.returncode}\n{done.stdout}{done.stderr}")
    RESULTS.write(case.name, identity(case), {"code": done.returncode})


@dataclass(frozen=True)
class Result:
    """What a history says."""

    first: float
    peak: float
    at: float
    broken_at_peak: int
    broken: int
    sweeps: int
    width: float
    ledger: float | None
    end: str


def read_result(folder: Path) -> Result:
    """Peak over stable states (critical ones; of a ramp over all), extents, costs."""
    rows, summary = rows_of(folder / "history.csv"), summary_of(folder)

    def number(row, key):
        return float(row[key]) if row[key] else 0.0

    stable = [row for row in rows if row["event"] in ("critical", "ramp", "end")]
    stable = [row for row in stable if row["event"] != "end" or row["released_energy"] == ""]
    top = max(stable, key=lambda row: number(row, "reaction"))
    unbroken = [row for row in stable if not number(row, "broken_bonds")]
    errors = [abs(number(row, "ledger_error")) for row in rows if row["ledger_error"]]
    last = rows[-1]
    return Result(
        first=number(unbroken[-1], "reaction"),
        peak=number(top, "reaction"),
        at=number(top, "load_factor"),
        broken_at_peak=int(number(top, "broken_bonds")),
        broken=int(number(last, "broken_bonds")),
        sweeps=summary["solve"]["evaluations"],
        width=number(last, "crack_x_max") - number(last, "crack_x_min"),
        ledger=max(errors, default=None),
        end="apart" if number(last, "reaction") < 0.1 * number(top, "reaction") else "stopped",
    )


HEAD = (
    "first break / lbf", "peak / lbf", "displacement at peak / in", "bonds broken at the peak, at the end", "band / in",
    "sweeps", "ledger error", "end",
)  # fmt: skip


def section(name: str, head: str, cases: tuple[Case, ...]) -> list[str]:
    """A section as lines of Markdown."""
    rows = []
    for case in cases:
        if not is_done(case):
            rows.append([case.label, "not run here", *[""] * (len(HEAD) - 1)])
            continue
        r = read_result(RESULTS.folder / case.name)
        label = OF_BASE[name] if case is BASE else case.label
        broken = f"{r.broken_at_peak:,}, {r.broken:,}"
        ledger = "-" if r.ledger is None else f"{r.ledger:.0e}"
        numbers = [f"{r.first:.1f}", f"{r.peak:.1f}", f"{0.01 * r.at:.6f}", broken, f"{r.width:.2f}", f"{r.sweeps:,}"]
        rows.append([label, *numbers, ledger, r.end])
    return table([head, *HEAD], rows)


def main(words: list[str]) -> int:
    """Run what is left, and fill the tables."""
    parser = parser_of(__doc__, full="also at the paper's spacing")
    parser.add_argument("--ranks", type=int, default=2)
    options = parser.parse_args(words)
    for case in all_cases():
        if options.report or options.only not in case.name or (case.full and not options.full) or is_done(case):
            continue
        print(case.name, case.settings, flush=True)
        if not options.dry_run:
            run_case(case, options.ranks)
    if not options.dry_run:
        fill(DOCS / "failure.md", {name: section(name, head, cases) for name, head, cases in SECTIONS})
    return 0
