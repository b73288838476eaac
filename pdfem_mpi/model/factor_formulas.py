"""Supports that follow the load factor by a formula: their displacements, and where two of them disagree."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.model.formula_values import evaluate

#: Load factors at which formulas are compared, beside those of the program.
SAMPLES = (0.25, 0.5, 0.75, 1.0, 2.0)
#: Two displacements are one within this part of the larger.
SAME = 1e-9

#: From a load factor to displacements, model units, float64 (n,).
AtFactor = Callable[[float], np.ndarray]


@dataclass(frozen=True)
class Following:
    """Unknowns whose displacement is a formula of the load factor.

    Attributes
    ----------
    index : int64, shape (n,)
    text : str
    x : float64, shape (n, 3), dimension length
        Their places, the deck's units.
    length : float
        One model unit, the deck's.
    """

    index: np.ndarray
    text: str
    x: np.ndarray
    length: float

    def at(self, load_factor: float) -> np.ndarray:
        """Displacements, model units, shape (n,)."""
        return of_formula(self.text, self.x, load_factor) / self.length

    def only(self, chosen: np.ndarray) -> Following:
        """Some of its unknowns, bool (n,) or their places, int64."""
        return replace(self, index=self.index[chosen], x=self.x[chosen])

    def without(self, unknowns: np.ndarray) -> Following:
        """All but some unknowns; int64, shape (m,)."""
        others = ~np.isin(self.index, unknowns)
        return self if others.all() else self.only(others)


def of_formula(text: str, x: np.ndarray, load_factor: float) -> np.ndarray:
    """Values of a formula at places (n, 3), the deck's units; float64, shape (n,)."""
    values = evaluate(text, {"x": x[:, 0], "y": x[:, 1], "z": x[:, 2], "f": load_factor})
    return np.array(np.broadcast_to(values, len(x)))


def factors_of(scene: Scene) -> tuple[float, ...]:
    """Load factors at which supports are compared: those of the program, where it names them, and some more."""
    schedule = getattr(scene.stepping, "schedule", ())
    return tuple(dict.fromkeys([*(factor for _, factor in schedule), *SAMPLES]))


def displacements_of(amounts: np.ndarray, following: Sequence[Following], rows: np.ndarray) -> AtFactor:
    """Displacements of some unknowns, int64 (n,), as a function of the load factor; model units.

    Parameters
    ----------
    amounts : float64, shape (n_unknowns,)
        At load factor 1.
    following : sequence of Following
        No unknown is in two of them.
    """
    shared = [(part, *np.intersect1d(rows, part.index, return_indices=True)[1:]) for part in following]
    parts = [(there, part.only(own)) for part, there, own in shared if len(own)]

    def at(load_factor: float) -> np.ndarray:
        values = load_factor * amounts[rows]
        for there, part in parts:
            values[there] = part.at(load_factor)
        return values

    return at


def ever_moves(part: Following, factors: Sequence[float]) -> np.ndarray:
    """Whether a formula is something else than 0 at some load factor; bool, shape (n,)."""
    moves = np.zeros(len(part.index), bool)
    for factor in factors:
        values = part.at(factor)
        moves |= np.isfinite(values) & (values != 0.0)
    return moves


def differences(one: AtFactor, two: AtFactor, factors: Sequence[float]) -> np.ndarray:
    """Where displacements differ that are both finite; bool, shape (n_factors, n)."""
    size = 0.0
    for factor in SAMPLES:
        size = np.maximum(size, _sizes(one(factor), two(factor)))
    rows = []
    for factor in factors:
        a, b = one(factor), two(factor)
        with np.errstate(invalid="ignore"):
            apart = np.abs(a - b) > SAME * np.maximum(size, _sizes(a, b))
        rows.append(apart & np.isfinite(a) & np.isfinite(b))
    return np.array(rows)


def _sizes(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """The larger of two amounts where both are finite, else 0."""
    return np.where(np.isfinite(a) & np.isfinite(b), np.maximum(np.abs(a), np.abs(b)), 0.0)
