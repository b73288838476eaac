"""The hard cases: decks of jobs/hard, their variants, what is expected of each and how it is judged.

A case is solved, or refused by name: with the exit code and the words that are expected. Expected values are closed
forms, statements of theory with a source, or direct solutions of the same equations by `hard_reference`.
`tools/hard_cases` runs all cases and writes docs/hard_cases.md; tests/verification/test_hard_cases.py runs the short
forms.
"""

from __future__ import annotations

import csv
import hashlib
import json
import math
import tomllib
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import hard_reference as reference
import numpy as np

from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.deck.toml import parse_deck
from pdfem_mpi.results import vtkhdf

ROOT = Path(__file__).resolve().parent.parent
DECKS = ROOT / "jobs" / "hard"
BAD_DECK, NOT_CONVERGED = 64, 74

FAMILIES = {
    1: "an interface meets a free edge and a corner",
    2: "a crack runs into the overlap and into a region without damage",
    3: "two cracks become critical at the same load",
    4: "fragments: pieces cut loose, single points without bonds",
    5: "a plate one cell thick, thinner than the cutoff radius",
    6: "internal lengths of half a cell to three cells, cutoff radii of 1.5 to 3.5 of them",
    7: "stiffness contrast 1 : 1000, hard and soft inclusion",
    8: "cells jittered by 15 %, graded 1 : 20, sheared by 45 degrees, of aspect 1 : 10",
    9: "rigid rotation by 10 and 90 degrees, finite kinematics",
    10: "compression by 30 % and tension by 30 %",
    11: "every unit scaled by 1e-9 and 1e+9",
    12: "a body far from the origin, 1e6 times its size",
    13: "nearly mechanisms: a hinge of one cell, a body held at one node",
    14: "bending and torsion of slender bars, relaxation against conjugate gradients",
    15: "load steps of 1e-12 and of ten times the failure load",
    16: "a tolerance at round-off, no load at all",
    17: "the smallest regions, overlaps of one to five layers, one description enclosed by the other",
    18: "one to eight ranks, ranks that own one cell, only elements, only bonds",
    19: "a million broken bonds in one event",
    20: "supports that contradict each other, loads and supports at one place",
}


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
        Further ones that make it small enough for the default tests; None: too long for them.
    against : str
        A case to compare with, which runs before.
    ranks : tuple of int
        The same bits are demanded of all of them; the first one is judged.
    change : callable or None
        Changes the deck's data before it is run (units, place).
    program : str
        "run" is ``pdfem run``; else a check of `hard_checks`.
    seconds : float
        Hard limit of each run on an idle machine; reached, the case has failed.
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
    seconds: float = 300.0

    @property
    def path(self) -> Path:
        """The deck's file."""
        return DECKS / f"{self.deck}.toml"


# --- judges --------------------------------------------------------------------------------------------------------


def _solved(outcome: Outcome) -> Finding | None:
    """None where a run finished and every number of it is finite."""
    if outcome.exit_code:
        return Finding(f"exit code {outcome.exit_code}: {last_words(outcome.said)}", None, False)
    numbers = [value for row in outcome.history for value in row.values() if isinstance(value, float)]
    if not all(math.isfinite(value) for value in numbers):
        return Finding("numbers that are not finite", None, False)
    return None


def last_words(said: str) -> str:
    """The last line, without the program's name and the deck's path."""
    lines = [line for line in said.splitlines() if line.strip()] or [""]
    return lines[-1].removeprefix("pdfem: ").split(".toml: ")[-1]


def refused(code: int, *words: str) -> Judge:
    """Refused with this exit code and all of these words."""

    def judge(case, scene, outcome, others):
        missing = [word for word in words if word not in outcome.said]
        clean = "Traceback" not in outcome.said
        lines = [line for line in outcome.said.splitlines() if all(word in line for word in words)] or [outcome.said]
        return Finding(
            f"exit code {outcome.exit_code}: {last_words(lines[-1])}",
            None,
            outcome.exit_code == code and not missing and clean,
        )

    return judge


def compared(measure: Callable[[Scene, Outcome, dict], tuple[str, float]], tolerance: float) -> Judge:
    """Solved, and ``measure`` gives (what came out, an error) with an error of at most ``tolerance``."""

    def judge(case, scene, outcome, others):
        failed = _solved(outcome)
        if failed:
            return failed
        got, error = measure(scene, outcome, others)
        return Finding(got, error, bool(error <= tolerance))

    return judge


def _largest(difference: np.ndarray, of: np.ndarray) -> float:
    return float(np.abs(difference).max() / np.abs(of).max())


def _fields(scene: Scene, outcome: Outcome):
    """Positions and displacements of what the scene has: points, then nodes."""
    body = reference.make_body(scene)
    nodes = body.discretization.mesh.nodes[body.discretization.node_number >= 0]
    pairs = [(body.x, outcome.points), (nodes, outcome.nodes)]
    found = [(x, u) for x, u in pairs if len(x)]
    return np.concatenate([x for x, _ in found]), np.concatenate([u for _, u in found])


def uniform_tension(strain: float, tolerance: float, poissons_ratio: float = 0.25) -> Judge:
    """Uniform tension along x, up to a rigid motion; the error is relative to the largest displacement."""

    def measure(scene, outcome, others):
        x, u = _fields(scene, outcome)
        exact = strain * x * np.array([1.0, -poissons_ratio, -poissons_ratio])
        exact = reference.without_rigid_motion(x, exact)
        error = _largest(reference.without_rigid_motion(x, u) - exact, exact)
        return f"strain {strain:g} everywhere", error

    return compared(measure, tolerance)


def direct_solution(tolerance: float) -> Judge:
    """The displacements of `hard_reference`; the error is relative to the largest one."""

    def measure(scene, outcome, others):
        points, nodes = reference.solve(scene)
        exact = np.concatenate([u for u in (points, nodes) if u is not None])
        x, u = _fields(scene, outcome)
        exact = exact * outcome.history[-1]["load_factor"]
        if not scene.supports or scene.supports[0].set == "CORNER":
            exact, u = reference.without_rigid_motion(x, exact), reference.without_rigid_motion(x, u)
        return f"largest displacement {np.abs(u).max():.6g}", _largest(u - exact, exact)

    return compared(measure, tolerance)


def finite_equilibrium(tolerance: float) -> Judge:
    """The residual force, by `hard_reference`, of the points that are free, over the reaction."""

    def measure(scene, outcome, others):
        body = reference.make_body(scene)
        force = reference.finite_forces(body, outcome.points.astype(float))
        held = ~np.isnan(reference.prescribed(body))
        reaction = np.abs(force[held[:, 0] & (body.x[:, 0] > body.x[:, 0].mean()), 0].sum())
        return f"reaction {reaction:.6g}", float(np.linalg.norm(force[~held]) / reaction)

    return compared(measure, tolerance)


def modulus(tolerance: float) -> Judge:
    """Young's modulus that the bar probe finds, over that of the material."""

    def measure(scene, outcome, others):
        ratios = [v for name, v in outcome.summary["probes"].items() if name.startswith("modulus_ratio")]
        return f"E / E0 = {ratios[0]:.6f}", abs(ratios[0] - 1.0)

    return compared(measure, tolerance)


def probe(name: str, value: float, tolerance: float) -> Judge:
    """A probe's result; the error is relative to the expected value."""

    def measure(scene, outcome, others):
        found = outcome.summary["probes"][name]
        return f"{name.replace('_', ' ')} {found:.6g}", abs(found / value - 1.0)

    return compared(measure, tolerance)


def same_as_other(tolerance: float, length: float = 1.0, force: float = 1.0) -> Judge:
    """Probes and last row (load, displacement, reaction, broken bonds) of the case `against`, in other units."""

    def measure(scene, outcome, others):
        other = others["against"]
        here, there = (
            np.array([v for v in o.summary["probes"].values() if isinstance(v, list)]) for o in (outcome, other)
        )
        errors = [_largest(here - length * there, length * there)] if here.size else []
        last, then = outcome.history[-1], other.history[-1]
        units = {"load_factor": 1.0, "displacement": length, "reaction": force, "broken_bonds": 1.0}
        for name, unit in units.items():
            if then.get(name):
                errors.append(abs(last[name] / (unit * then[name]) - 1.0))
        errors.append(float(len(outcome.history) != len(other.history)))
        return f"largest difference {max(errors):.1e}", max(errors)

    return compared(measure, tolerance)


def broken(ledger: float | None = 1e-9, **limits: float) -> Judge:
    """Failure with a ledger that closes (None: of a program without one); bonds must break.

    ``limits`` such as crack_x_max=10.0 hold for every row.
    With ``mirror`` = X the broken bonds are mirror images about x = X after every row, and an even number.
    """
    mirror = limits.pop("mirror", None)

    def measure(scene, outcome, others):
        rows = [row for row in outcome.history if row.get("broken_bonds")]
        errors = [] if rows else [np.inf]
        if ledger is not None:
            known = [row.get("ledger_error") for row in outcome.history]
            errors += [np.inf if error is None else abs(error) / ledger for error in known]
        for name, limit in limits.items():
            side = 1.0 if name.endswith("max") else -1.0
            errors += [2.0 for row in rows if side * (row[name] - limit) > 1e-9]
        if mirror is not None:
            errors += [abs(row["crack_x_min"] + row["crack_x_max"] - 2.0 * mirror) / 1e-9 for row in rows]
            errors += [2.0 for row in rows if row["broken_bonds"] % 2]
        last = outcome.history[-1]
        where = f", x from {last['crack_x_min']:.4g} to {last['crack_x_max']:.4g}" if last.get("broken_bonds") else ""
        got = f"{last['event']} at load factor {last['load_factor']:.6g}, {int(last['broken_bonds']):,} bonds broken"
        return got + where, max(errors, default=0.0) * (ledger or 1.0)

    return compared(measure, ledger or 1.0)


def nothing_moves() -> Judge:
    """No displacement at all."""

    def measure(scene, outcome, others):
        size = max(float(np.abs(u).max()) for u in (outcome.points, outcome.nodes) if u is not None)
        return f"largest displacement {size:g}", size

    return compared(measure, 0.0)


def completed() -> Judge:
    """Solved, whatever the numbers, as long as they are finite."""
    return compared(lambda scene, outcome, others: ("solved", 0.0), 0.0)


def counted_bonds(tolerance: float) -> Judge:
    """All bonds between two regions that move apart, and no others, broke at once; error of their energy."""

    def measure(scene, outcome, others):
        body = reference.make_body(scene)
        i, j, k = reference.bonds(body)
        across = body.discretization.region[body.cell[i]] != body.discretization.region[body.cell[j]]
        moves = np.array([[s.x, s.y, s.z] for s in scene.supports])[body.discretization.region[body.cell]]
        xi, eta = (body.x[j] - body.x[i])[across], (moves[j] - moves[i])[across]
        r = np.linalg.norm(xi, axis=1)
        stretch = (xi * eta).sum(axis=1) / r**2
        energy = float((0.5 * k[across] * r * stretch**2).sum())
        (row,) = outcome.history
        exact = row["broken_bonds"] == across.sum() == (stretch > scene.material.critical_stretch).sum()
        error = abs(row["dissipated_energy"] / energy - 1.0) if exact else math.inf
        return f"{int(row['broken_bonds']):,} of {across.sum():,} bonds", error

    return compared(measure, tolerance)


def numbers(tolerance: float, *names: str) -> Judge:
    """Each named number of a check of `hard_checks` is at most ``tolerance``."""

    def measure(scene, outcome, others):
        found = {name: outcome.summary[name] for name in names}
        return ", ".join(f"{name.replace('_', ' ')} {value:.2g}" for name, value in found.items()), max(found.values())

    return compared(measure, tolerance)


def says(judge: Judge, *words: str) -> Judge:
    """What ``judge`` says, and these words were told."""

    def both(case, scene, outcome, others):
        finding = judge(case, scene, outcome, others)
        missing = [word for word in words if word not in outcome.said]
        told = f"; told: {words[0]}" if not missing else f"; not told: {missing[0]}"
        return Finding(finding.got + told, finding.error, finding.holds and not missing)

    return both


# --- decks ---------------------------------------------------------------------------------------------------------

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


# --- outcomes ------------------------------------------------------------------------------------------------------


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


def digest(outcome: Outcome) -> str:
    """Of all that must be the same on any number of ranks: fields in double precision, history, words of an end."""
    said = last_words(outcome.said) if outcome.exit_code else ""
    found = (outcome.summary.get(name) for name in ("fields_sha256", "probes"))
    return hashlib.sha256(json.dumps((outcome.exit_code, outcome.history, said, *found)).encode()).hexdigest()
