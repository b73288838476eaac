"""Series of runs as ``pdfem study`` makes them: a deck and keys that vary; what is left is run, results are read."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tools.studies.internals import study
from tools.studies.series import JOBS, rows_of


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
        return axes, study.make_members(JOBS / self.deck, axes, self.overrides)


def run_series(series: Series, folder: Path, ranks: int, dry_run: bool, start: study.Start | None = None) -> int:
    """Run what is left of a series; members whose deck has changed are run anew. Returns the exit code."""
    axes, members = series.members()
    if dry_run:
        for member in members:
            if study.outcome_in(folder / "members" / member.name, member).status != "finished":
                print(f"{series.name} {member.label}")
        return 0
    interruption = study.Interruption()
    start = start or study.starter(JOBS / series.deck, series.overrides, ranks, interruption)
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
        rows = rows_of(self.folder / "lines" / f"{name}.csv")
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
