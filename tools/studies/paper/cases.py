"""The runs behind the figures of docs/paper.md: decks of jobs/, keys that vary, and what is read from the results."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pdfem_mpi.command import study

ROOT = Path(__file__).resolve().parent.parent

# Appendix B: the paper's cells, thicknesses and lengths; the coarse set keeps the ratios to the cells
STRAIN, X0, Y0 = 1.875e-3, 2.5, 1.0
STRESS = 18750.0
COARSE_CORNERS = {
    "elements_left.upper": "[-2.1,1.5,0.1]",
    "elements_right.lower": "[2.1,-1.5,-0.1]",
    "band_left.lower": "[-2.1,-1.5,-0.1]",
    "band_right.upper": "[2.1,1.5,0.1]",
}


@dataclass(frozen=True)
class Series:
    """Runs of one deck, as ``pdfem study`` takes them."""

    name: str
    deck: str
    vary: tuple[str, ...]
    overrides: tuple[str, ...] = ()

    def members(self) -> tuple[list[study.Axis], list[study.Member]]:
        """Its axes and its members, validated."""
        axes = study.parse_axes(self.vary)
        return axes, study.make_members(ROOT / "jobs" / self.deck, axes, self.overrides)


def make_series(full: bool) -> list[Series]:
    """All series, cheap ones first."""
    bar = () if full else ("mesh.spacing=0.2", "probes.axis.n=51")
    plate = () if full else ("mesh.spacing=0.2", "probes.bottom.n=91")
    # with cells of 0.2 in, interfaces at 2 would not lie between cells
    moved = () if full else tuple(f"regions.{name}={corner}" for name, corner in COARSE_CORNERS.items())
    quiet = ("output.fields=false", "output.figures=false")
    readings = "coupling.kind=paper,paper_a"
    cg = "solver.kind=cg"
    h = 0.08 if full else 0.5
    box = () if full else ("mesh.lower.0=-4.5", "mesh.upper.0=4.5", f"mesh.spacing={h}")
    density = STRESS / h
    loads = tuple(f"loads.{k}.density=[{sign * density},0.0,0.0]" for k, sign in ((0, 1.0), (1, -1.0)))

    def varied(key, ratios):
        return f"{key}=" + ",".join(f"{ratio * h:.12g}" for ratio in ratios)

    def lengths(*ratios):
        return varied("peridynamics.internal_length", ratios)

    def thicknesses(*cells):
        pairs = (f"{-0.5 * n * h:.12g}:{0.5 * n * h:.12g}" for n in cells)
        return "mesh.lower.2:mesh.upper.2=" + ",".join(pairs)

    one, ten = (1, 10 if full else 2)
    series = [
        Series("bar_fe", "bar_fe.toml", (cg,), (*bar, *quiet)),
        Series("bar_pd", "bar_pd.toml", (cg,), (*bar, *quiet)),
        Series("bar_coupled", "bar_tension.toml", (readings,), (cg, *bar, *quiet)),
        Series("plate_fe", "plate_fe.toml", (cg,), (*plate, *quiet)),
        Series("plate_pd", "plate_pd.toml", (cg,), (*plate, *quiet)),
        Series("plate_coupled", "plate_coupled.toml", (readings,), (*plate, *moved, *quiet)),
        Series("b_fe", "appendix_b_fe.toml", (thicknesses(one),), (*box, *quiet)),
        Series(
            "b4_cutoff",
            "appendix_b_pd.toml",
            (varied("peridynamics.cutoff_radius", (1, 1.5, 2, 2.25, 2.5, 3, 4) if full else (1, 2.5, 3)),),
            (*box, *loads, *one_thickness(one, h), lengths(1), *quiet),
        ),
        Series(
            "b2_thickness",
            "appendix_b_pd.toml",
            (lengths(1, 1.5) if full else lengths(1, 1.25), thicknesses(*((1, 2, 3, 5, 10) if full else (1, 2)))),
            (*box, *loads, *quiet),
        ),
        Series(
            "b5_internal_length",
            "appendix_b_pd.toml",
            (lengths(*((0.4, 0.5, 0.6, 0.8) if full else (0.5,))),),  # 1 and 1.5 are in b2_thickness
            (*box, *loads, *one_thickness(ten, h), *quiet),
        ),
    ]
    if full:
        series.append(Series("b2_long", "appendix_b_pd.toml", (lengths(2), thicknesses(1, 2, 3)), (*loads, *quiet)))
    return series


def one_thickness(cells: int, h: float) -> tuple[str, str]:
    """Overrides for one thickness."""
    return f"mesh.lower.2={-0.5 * cells * h:.12g}", f"mesh.upper.2={0.5 * cells * h:.12g}"


def run_series(series: Series, folder: Path, ranks: int, dry_run: bool, start: study.Start | None = None) -> int:
    """Run what is left of a series; members whose deck has changed are run anew. Returns the exit code."""
    axes, members = series.members()
    if dry_run:
        for member in members:
            if study.outcome_in(folder / "members" / member.name, member).status != "finished":
                print(f"{series.name} {member.label}")
        return 0
    interruption = study.Interruption()
    start = start or study.starter(ROOT / "jobs" / series.deck, series.overrides, ranks, interruption)
    return study.run_study(
        members, axes, folder, start, lambda text: print(f"{series.name} {text}", flush=True), (), interruption
    )


@dataclass(frozen=True)
class Result:
    """One finished member: its values, the numbers of its summary, and its folder."""

    values: dict[str, str]
    numbers: dict[str, float]
    summary: dict
    folder: Path

    def line(self, name: str) -> dict[str, np.ndarray]:
        """Columns of ``lines/NAME.csv``."""
        with open(self.folder / "lines" / f"{name}.csv", newline="", encoding="utf-8") as file:
            rows = list(csv.DictReader(file))
        columns = {key: np.array([float(row[key]) for row in rows]) for key in rows[0] if key != "model"}
        return columns | {"model": np.array([row["model"] for row in rows])}


def results(series: Sequence[Series], runs: Path) -> dict[str, list[Result]]:
    """Finished members of every series; a series without any is left out."""
    found = {}
    for item in series:
        members = []
        for member in item.members()[1]:
            folder = runs / item.name / "members" / member.name
            outcome = study.outcome_in(folder, member)
            if outcome.status == "finished":
                numbers = study.results_of(outcome.summary)
                members.append(Result(dict(member.values), numbers, outcome.summary, folder))
        if members:
            found[item.name] = members
    return found
