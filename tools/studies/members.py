"""Series of runs as ``pdfem study`` makes them: a deck and keys that vary; what is left is run, results are read."""

from __future__ import annotations

import hashlib
import itertools
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from pdfem_mpi import RunFolder, Scene, open_run, read_deck, write_deck
from tools.studies.series import JOBS, program, rows_of


@dataclass(frozen=True)
class Member:
    """One run of a series: the values of the keys that vary, and its whole scene."""

    values: dict[str, str]
    scene: Scene

    @property
    def label(self) -> str:
        """Its values in one line."""
        return " ".join(f"{key}={value}" for key, value in self.values.items())

    @property
    def sha256(self) -> str:
        """Hash of the whole deck, as in the summary of its run."""
        return hashlib.sha256(write_deck(self.scene).encode()).hexdigest()


@dataclass(frozen=True)
class Series:
    """Runs of one deck: ``vary`` as ``pdfem study --vary`` takes it, without commas and colons in values."""

    name: str
    deck: str
    vary: tuple[str, ...]
    overrides: tuple[str, ...] = ()

    def members(self) -> list[Member]:
        """All combinations of values, the last key fastest."""
        axes = []
        for text in self.vary:
            keys, _, values = text.partition("=")
            axes.append([dict(zip(keys.split(":"), v.split(":"), strict=True)) for v in values.split(",")])
        found = []
        for chosen in itertools.product(*axes):
            values = {key: value for pairs in chosen for key, value in pairs.items()}
            settings = [*self.overrides, *(f"{key}={value}" for key, value in values.items())]
            found.append(Member(values, read_deck(JOBS / self.deck, settings)))
        return found


def run_series(series: Series, folder: Path, ranks: int, dry_run: bool) -> int:
    """Run what is left of a series; members whose deck has changed are run anew. Returns the exit code."""
    left = [member for member in series.members() if run_of(member, folder) is None]
    if dry_run or not left:
        for member in left:
            print(f"{series.name} {member.label}")
        return 0
    settings = [f"--set={text}" for text in series.overrides] + [f"--vary={text}" for text in series.vary]
    command = [program(), "study", str(JOBS / series.deck), *settings, "-n", str(ranks), "--out", str(folder)]
    print(series.name, flush=True)
    return subprocess.run([*command, "--overwrite"]).returncode


def run_of(member: Member, folder: Path) -> RunFolder | None:
    """The finished run of a member in the folder of its series; None where there is none of the same deck."""
    table = folder / "study.csv"
    for row in rows_of(table) if table.exists() else ():
        if row["deck_sha256"] == member.sha256 and row["status"] == "finished":
            run = open_run(folder / row["folder"])
            if run.summary["deck_sha256"] == member.sha256:
                return run
    return None


@dataclass(frozen=True)
class Result:
    """One finished member: its values, and its run with the numbers of its summary."""

    values: dict[str, str]
    run: RunFolder
    numbers: dict[str, float]


def results(series: Sequence[Series], runs: Path) -> dict[str, list[Result]]:
    """Finished members of every series; a series without any is left out."""
    found = {}
    for item in series:
        pairs = [(member, run_of(member, runs / item.name)) for member in item.members()]
        members = [Result(member.values, run, run.numbers) for member, run in pairs if run]
        if members:
            found[item.name] = members
    return found
