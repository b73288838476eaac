"""Prescribed displacements of a deck, over the unknowns of a rank."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pdfem_mpi.body.share import Share
from pdfem_mpi.deck.formulas import names_in
from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.deck.table import AXES, show
from pdfem_mpi.model.formula_values import evaluate
from pdfem_mpi.model.model import Model
from pdfem_mpi.model.own_places import OwnPlaces
from pdfem_mpi.model.parts import positions
from pdfem_mpi.parallel.comm import largest, sum_integers


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
        return _of_formula(self.text, self.x, load_factor) / self.length


@dataclass(frozen=True)
class Prescription:
    """What all supports prescribe, at load factor 1 and in model units.

    Attributes
    ----------
    amounts : float64, shape (n_unknowns,), dimension length
        NaN where nothing is prescribed.
    holders : float64, shape (n_unknowns,)
        Number of the support that prescribes it, else NaN.
    following : tuple of Following
    reach : tuple of float, dimension length
        Largest amount of each support, on all ranks.
    """

    amounts: np.ndarray
    holders: np.ndarray
    following: tuple[Following, ...]
    reach: tuple[float, ...]


def prescribe(scene: Scene, share: Share, model: Model, messages: list[str]) -> Prescription:
    """Prescribed displacements of this rank's unknowns; ``messages`` get what is wrong. Collective."""
    found = Prescription(np.full(model.n_unknowns, np.nan), np.full(model.n_unknowns, np.nan), (), ())
    places = OwnPlaces(share, model.unknowns)
    mirrored = np.zeros(model.n_unknowns, bool)
    mirrored[model.rollers] = True
    following: list[Following] = []
    reach: list[float] = []
    for index, (support, chosen) in enumerate(zip(scene.supports, share.selections.supports, strict=True)):
        where = f"supports.{index}"
        messages += share.selections.problems["supports"][index]
        sizes = [0.0]
        for d, amount in enumerate(support.amounts if chosen else ()):
            if amount is None:
                continue
            of_points, of_nodes = (rows[:, d] for rows in places.unknowns(chosen))
            unknowns = np.concatenate([of_points, of_nodes])
            units = share.units
            if isinstance(amount, str):
                x = _positions(model, places, chosen)
                values = _of_formula(amount, x, 1.0)
                messages += _not_finite(share, f"{where}.{AXES[d]}", amount, x, values)
                values = units.numbers(values / units.length)
                if "f" in names_in(amount):
                    following.append(Following(unknowns, amount, x, units.length))
            else:
                values = np.full(len(unknowns), units.numbers(amount / units.length))
            sizes.append(float(largest(share.comm, np.array([np.abs(values).max(initial=0.0)]))[0]))
            messages += _out_of_planes(share, where, d, amount, mirrored[unknowns] & (values != 0.0))
            for rows, numbers, own in (
                (of_points, places.cells_of(chosen), values[: len(of_points)]),
                (of_nodes, places.nodes_of(chosen), values[len(of_points) :]),
            ):
                before = found.amounts[rows]
                other = ~np.isnan(before) & (before != own)
                messages += _contradictions(share, f"{where}.{AXES[d]}", amount, numbers[other], before[other])
                found.amounts[rows], found.holders[rows] = own, index
        reach.append(max(sizes))
    found.amounts[model.rollers] = 0.0
    return Prescription(found.amounts, found.holders, tuple(following), tuple(reach))


def _positions(model: Model, places: OwnPlaces, chosen) -> np.ndarray:
    """Where chosen points and nodes are, the deck's units, shape (n, 3)."""
    return positions(model)[np.concatenate(places.rows(chosen))] * model.units.length + model.units.origin


def _of_formula(text: str, x: np.ndarray, load_factor: float) -> np.ndarray:
    """Values of a formula at places (n, 3), the deck's units; float64, shape (n,)."""
    values = evaluate(text, {"x": x[:, 0], "y": x[:, 1], "z": x[:, 2], "f": load_factor})
    return np.array(np.broadcast_to(values, len(x)))


def _not_finite(share: Share, key: str, text: str, x: np.ndarray, values: np.ndarray) -> list[str]:
    """A sentence about values of a formula that are not finite. Collective."""
    bad = ~np.isfinite(values)
    own = tuple(x[bad][np.lexsort(x[bad].T)[0]].tolist()) if bad.any() else None
    found = [place for place in share.comm.allgather(own) if place]
    if not found:
        return []
    place = ", ".join(f"{c:.6g}" for c in min(found))
    return [f"{key} = {show(text)} is not finite at ({place}). Use a formula that is finite at all of the support."]


def _out_of_planes(share: Share, where: str, d: int, amount: float | str, through: np.ndarray) -> list[str]:
    """A sentence about nodes that a support moves out of a mirror plane. Collective."""
    count = _count(share, len(np.flatnonzero(through))) if share.mirrors else 0
    if not count:
        return []
    return [
        f"{where}.{AXES[d]} = {_shown(amount)} moves {count} nodes out of a mirror plane (mesh.symmetry). Keep the "
        "support off the plane, or remove the mirror."
    ]


def _contradictions(share: Share, key: str, amount: float | str, numbers: np.ndarray, before: np.ndarray) -> list[str]:
    """A sentence about places where an earlier support prescribes something else. Collective."""
    count = _count(share, len(np.unique(numbers)))
    if not count:
        return []
    value = _first(share, numbers, before) * share.units.length
    return [
        f"{key} = {_shown(amount)} contradicts {value:.6g}, prescribed by an earlier support at {count} of the same "
        "places. Keep one of them."
    ]


def _shown(amount: float | str) -> str:
    return show(amount) if isinstance(amount, str) else f"{amount:.6g}"


def _count(share: Share, own: int) -> int:
    return int(sum_integers(share.comm, np.array([own]))[0])


def _first(share: Share, numbers: np.ndarray, values: np.ndarray) -> float:
    """The value at the lowest number on all ranks. Collective."""
    lowest = int(np.argmin(numbers)) if len(numbers) else 0
    own = (int(numbers[lowest]), float(values[lowest])) if len(numbers) else None
    return min(found for found in share.comm.allgather(own) if found)[1]
