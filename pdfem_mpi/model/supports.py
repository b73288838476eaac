"""Prescribed displacements of a deck, over the unknowns of a rank."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pdfem_mpi.body.share import Share
from pdfem_mpi.deck.formulas import names_in
from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.deck.table import AXES, show
from pdfem_mpi.model.factor_formulas import Following, differences, displacements_of, ever_moves, factors_of, of_formula
from pdfem_mpi.model.model import Model
from pdfem_mpi.model.own_places import OwnPlaces
from pdfem_mpi.model.parts import positions
from pdfem_mpi.parallel.comm import largest, sum_integers


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
    factors = factors_of(scene)
    for index, (support, chosen) in enumerate(zip(scene.supports, share.selections.supports, strict=True)):
        messages += share.selections.problems["supports"][index]
        sizes = [0.0]
        for d, amount in enumerate(support.amounts if chosen else ()):
            if amount is None:
                continue
            new = _component(share, model, places, chosen, (index, d, amount), messages)
            sizes.append(float(largest(share.comm, np.array([np.abs(new.values).max(initial=0.0)]))[0]))
            through = mirrored[new.unknowns]
            through[through] = new.only(through).moves(factors)
            messages += _out_of_planes(share, new, through)
            for kind in (new.is_point, ~new.is_point):
                messages += _contradictions(share, found, following, new.only(kind))
                messages += _contradictions_in_time(scene, share, found, following, new.only(kind), factors)
            found.amounts[new.unknowns], found.holders[new.unknowns] = new.values, index
            following = [part.without(new.unknowns) for part in following] + ([new.part] if new.part else [])
        reach.append(max(sizes))
    found.amounts[model.rollers] = 0.0
    following = [part.without(model.rollers) for part in following]
    return Prescription(found.amounts, found.holders, tuple(following), tuple(reach))


@dataclass(frozen=True)
class _Component:
    """What one support prescribes along one axis, on this rank.

    Attributes
    ----------
    key : str
    amount : float or str
    along : int
    unknowns, numbers : int64, shape (n,)
        Points first, with the numbers of their cells in the mesh, then nodes with theirs.
    is_point : bool, shape (n,)
    values : float64, shape (n,), dimension length
        At load factor 1, model units.
    part : Following or None
        Where it is a formula of the load factor.
    """

    key: str
    amount: float | str
    along: int
    unknowns: np.ndarray
    numbers: np.ndarray
    is_point: np.ndarray
    values: np.ndarray
    part: Following | None

    def only(self, chosen: np.ndarray) -> _Component:
        """The same for some of the unknowns; bool, shape (n,)."""
        rows = (rows[chosen] for rows in (self.unknowns, self.numbers, self.is_point, self.values))
        return _Component(self.key, self.amount, self.along, *rows, self.part and self.part.only(chosen))

    def moves(self, factors: tuple[float, ...]) -> np.ndarray:
        """Whether it is something else than 0 at some load factor; bool, shape (n,)."""
        return self.values != 0.0 if self.part is None else ever_moves(self.part, factors)

    def at(self, load_factor: float) -> np.ndarray:
        """Displacements, model units, shape (n,)."""
        return load_factor * self.values if self.part is None else self.part.at(load_factor)


def _component(share: Share, model: Model, places: OwnPlaces, chosen, entry, messages: list[str]) -> _Component:
    """A component of a support, given by the support's number, the axis and the amount. Collective."""
    index, d, amount = entry
    key, units = f"supports.{index}.{AXES[d]}", share.units
    of_points, of_nodes = (rows[:, d] for rows in places.unknowns(chosen))
    unknowns = np.concatenate([of_points, of_nodes])
    part = None
    if isinstance(amount, str):
        x = _positions(model, places, chosen)
        values = of_formula(amount, x, 1.0)
        messages += _not_finite(share, key, amount, x, values)
        values = units.numbers(values / units.length)
        if "f" in names_in(amount):
            part = Following(unknowns, amount, x, units.length)
    else:
        values = np.full(len(unknowns), units.numbers(amount / units.length))
    numbers = np.concatenate([places.cells_of(chosen), places.nodes_of(chosen)])
    return _Component(key, amount, d, unknowns, numbers, np.arange(len(unknowns)) < len(of_points), values, part)


def _positions(model: Model, places: OwnPlaces, chosen) -> np.ndarray:
    """Where chosen points and nodes are, the deck's units, shape (n, 3)."""
    return positions(model)[np.concatenate(places.rows(chosen))] * model.units.length + model.units.origin


def _not_finite(share: Share, key: str, text: str, x: np.ndarray, values: np.ndarray) -> list[str]:
    """A sentence about values of a formula that are not finite. Collective."""
    bad = ~np.isfinite(values)
    own = tuple(x[bad][np.lexsort(x[bad].T)[0]].tolist()) if bad.any() else None
    found = [place for place in share.comm.allgather(own) if place]
    if not found:
        return []
    place = ", ".join(f"{c:.6g}" for c in min(found))
    return [f"{key} = {show(text)} is not finite at ({place}). Use a formula that is finite at all of the support."]


def _out_of_planes(share: Share, new: _Component, through: np.ndarray) -> list[str]:
    """A sentence about nodes that a support moves out of a mirror plane. Collective."""
    count = _count(share, len(np.flatnonzero(through))) if share.mirrors else 0
    if not count:
        return []
    return [
        f"{new.key} = {_shown(new.amount)} moves {count} nodes out of a mirror plane (mesh.symmetry). Keep the "
        "support off the plane, or remove the mirror."
    ]


def _contradictions(share: Share, found: Prescription, following: list[Following], new: _Component) -> list[str]:
    """A sentence about places where an earlier support prescribes something else, whatever the factor. Collective."""
    before = found.amounts[new.unknowns]
    other = ~np.isnan(before) & (before != new.values) & ~_follow(following, new)
    count = _count(share, len(np.unique(new.numbers[other])))
    if not count:
        return []
    value = _first(share, new.numbers[other], before[other]) * share.units.length
    return [
        f"{new.key} = {_shown(new.amount)} contradicts {value:.6g}, prescribed by an earlier support at {count} of the "
        "same places. Keep one of them."
    ]


def _contradictions_in_time(
    scene: Scene, share: Share, found: Prescription, following: list[Following], new: _Component, factors
) -> list[str]:
    """The same where one of both supports, or both, follow the load factor by a formula. Collective."""
    if new.part is None and not following:
        return []
    new = new.only(~np.isnan(found.amounts[new.unknowns]) & _follow(following, new))
    earlier = displacements_of(found.amounts, following, new.unknowns)
    apart = differences(new.at, earlier, factors)
    counts = sum_integers(share.comm, np.array([len(np.unique(new.numbers[row])) for row in apart]))
    if not counts.any():
        return []
    k = int(np.argmax(counts > 0))
    holder = int(_first(share, new.numbers[apart[k]], found.holders[new.unknowns[apart[k]]]))
    return [
        f"{new.key} = {_shown(new.amount)} contradicts supports.{holder}.{AXES[new.along]} = "
        f"{_shown(scene.supports[holder].amounts[new.along])} at load factor {factors[k]:.6g}, at {counts[k]} of the "
        "same places. Keep one of them."
    ]


def _follow(following: list[Following], new: _Component) -> np.ndarray:
    """Unknowns of which this or an earlier support prescribes a formula of the load factor; bool, shape (n,)."""
    if new.part is not None:
        return np.ones(len(new.unknowns), bool)
    return np.isin(new.unknowns, np.concatenate([part.index for part in following] or [np.empty(0, np.int64)]))


def _shown(amount: float | str) -> str:
    return show(amount) if isinstance(amount, str) else f"{amount:.6g}"


def _count(share: Share, own: int) -> int:
    return int(sum_integers(share.comm, np.array([own]))[0])


def _first(share: Share, numbers: np.ndarray, values: np.ndarray) -> float:
    """The value at the lowest number on all ranks. Collective."""
    lowest = int(np.argmin(numbers)) if len(numbers) else 0
    own = (int(numbers[lowest]), float(values[lowest])) if len(numbers) else None
    return min(found for found in share.comm.allgather(own) if found)[1]
