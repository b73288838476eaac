"""What a hard case is: a deck of jobs/hard, what changes it, what is expected of it, and what a run of it leaves.

A case is solved, or refused by name: with the exit code and the words that are expected. Expected values are closed
forms, statements of theory with a source, or direct solutions of the same equations by `support.direct_solution`.
"""

from __future__ import annotations

import csv
import hashlib
import json
import tomllib
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.deck.toml import parse_deck
from pdfem_mpi.results import vtkhdf
from support.helpers import ROOT

DECKS = ROOT / "jobs" / "hard"
BAD_DECK, NOT_CONVERGED = 64, 74


@dataclass
class Outcome:
    """What a run leaves: exit code, all that it said, and its results (empty for a refused deck).

    Attributes
    ----------
    exit_code : int
    said : str
        Lines it printed, the reason of its end among them.
    summary : dict
        Of summary.json.
    history : list of dict
        Rows of history.csv as numbers, empty entries left out.
    points, nodes : float, shape (n, 3) or None
        Displacements of the last frame, rounded to single precision by the file.
    """

    exit_code: int
    said: str
    summary: dict[str, Any] = field(default_factory=dict)
    history: list[dict[str, Any]] = field(default_factory=list)
    points: np.ndarray | None = None
    nodes: np.ndarray | None = None


@dataclass(frozen=True)
class Finding:
    """What came out, how far from what was expected, and whether that is good enough."""

    got: str
    error: float | None
    holds: bool


Judge = Callable[["Case", Scene | None, Outcome, dict[str, Outcome]], Finding]


@dataclass(frozen=True)
class Case:
    """One run and what is expected of it.

    Attributes
    ----------
    family : int
    name : str
    deck : str
        In jobs/hard, without suffix.
    expected : str
        In words, with its source.
    judge : callable
    sets : tuple of str
        What ``--set`` gets.
    short : tuple of str or None
        Further ones that make it small enough for the default tests; none: it is; None: too long for them.
    against : str
        A case to compare with, which runs before.
    ranks : tuple of int
        The same bits are demanded of all of them; the first one is judged.
    change : callable or None
        Changes the deck's data before it is run (units, place).
    program : str
        "run", or a check of `hard.rotations`.
    """

    family: int
    name: str
    deck: str
    expected: str
    judge: Judge
    sets: tuple[str, ...] = ()
    short: tuple[str, ...] | None = ()
    against: str = ""
    ranks: tuple[int, ...] = (1, 2)
    change: Callable[[dict[str, Any]], dict[str, Any]] | None = None
    program: str = "run"

    @property
    def path(self) -> Path:
        """The deck's file."""
        return DECKS / f"{self.deck}.toml"

    @property
    def title(self) -> str:
        """Family and name, as tests are called."""
        return f"{self.family}: {self.name}"


#: Keys of positions; other keys of dimension length are displacements or sizes.
POSITIONS = ("lower", "upper", "centre", "point", "start", "stop", "polygon")
LENGTHS = ("spacing", "hole_radius", "radius", "internal_length", "cutoff_radius", "x", "y", "z")


def scaled(length: float, force: float) -> Callable[[dict], dict]:
    """A deck in other units: lengths and forces multiplied."""
    units = dict.fromkeys(POSITIONS + LENGTHS, length)
    units |= {"youngs_modulus": force / length**2, "fracture_energy": force / length, "total": force}
    units |= {"traction": force / length**2, "stress": force / length**2, "density": force / length**3}
    return lambda data: _map(data, lambda key, value: value * units[key] if key in units else value)


def moved(distance: float) -> Callable[[dict], dict]:
    """A deck whose body lies elsewhere: positions shifted along all axes."""
    return lambda data: _map(data, lambda key, value: value + distance if key in POSITIONS else value)


def _map(value: Any, change: Callable[[str, float], float], key: str = "") -> Any:
    if isinstance(value, dict):
        return {name: _map(item, change, name) for name, item in value.items()}
    if isinstance(value, list):
        return [_map(item, change, key) for item in value]
    return change(key, value) if isinstance(value, int | float) and not isinstance(value, bool) else value


def deck_text(case: Case) -> str:
    """The case's deck, changed if the case says so."""
    text = case.path.read_text(encoding="utf-8")
    return text if case.change is None else _toml(case.change(tomllib.loads(text)))


def _toml(table: dict[str, Any]) -> str:
    """TOML with inline tables; a JSON value is one of TOML's but for the tables."""

    def show(value):
        if isinstance(value, dict):
            return "{" + ", ".join(f"{name} = {show(item)}" for name, item in value.items()) + "}"
        if isinstance(value, list):
            return "[" + ", ".join(show(item) for item in value) + "]"
        return json.dumps(value)

    return "".join(f"{name} = {show(value)}\n" for name, value in table.items())


def read_scene(case: Case, short: bool = False) -> Scene:
    """The case's scene.

    Raises
    ------
    DeckError
    """
    sets = (*case.sets, *(case.short or ())) if short else case.sets
    return parse_deck(deck_text(case), str(case.path), sets)


def read_outcome(folder: Path, exit_code: int, said: str) -> Outcome:
    """What a run left in its folder; empty results where it was refused."""
    if not (folder / "summary.json").exists():
        return Outcome(exit_code, said)
    summary = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    history = []
    if (folder / "history.csv").exists():
        with (folder / "history.csv").open(encoding="utf-8", newline="") as file:
            history = [_numbers(row) for row in csv.DictReader(file)]
    frames = [_last_frame(folder / f"{name}.vtkhdf") for name in ("points", "elements")]
    return Outcome(exit_code, said + "\n" + (summary.get("reason") or ""), summary, history, *frames)


def _numbers(row: dict[str, str]) -> dict[str, Any]:
    """The row's numbers, and its event as it stands; empty entries and the wall clock's left out."""
    return {
        name: text if name == "event" else float(text) for name, text in row.items() if text and name != "wall_seconds"
    }


def _last_frame(path: Path) -> np.ndarray | None:
    if not path.exists() or not vtkhdf.frames(path):
        return None
    return vtkhdf.read_frame(path, "displacement", vtkhdf.frames(path) - 1)


def last_words(said: str) -> str:
    """The last line, without the program's name and the deck's path."""
    lines = [line for line in said.splitlines() if line.strip()] or [""]
    return lines[-1].removeprefix("pdfem: ").split(".toml: ")[-1]


def digest(outcome: Outcome) -> str:
    """Of all that must be the same on any number of ranks: fields in double precision, history, words of an end."""
    said = last_words(outcome.said) if outcome.exit_code else ""
    found = (outcome.summary.get(name) for name in ("fields_sha256", "probes"))
    return hashlib.sha256(json.dumps((outcome.exit_code, outcome.history, said, *found)).encode()).hexdigest()
