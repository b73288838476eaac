"""Failure of bonds (eq. 4): which may break and when, and the books of those that broke.

A bond breaks for good when its stretch passes the critical one, which depends on the regions of its two points: the
value for their two materials, infinity where one of them may not fail. The sweeps break and record bonds; the books
gather the records: which bonds, on this rank, and the energy they had, as an exact sum over all ranks.

Points of the overlap follow the nodes of elements, which hold together whatever breaks: between two of them no crack
can open, and where the overlap is shallower than bonds are long, what is left of their families stretches several
times as far as the material beside it. Such bonds do not break. Bonds with one end there do: it is by them that a
free point hangs on the elements, and without them it parts from these.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np

from pdfem_mpi.kernels import bond_failure
from pdfem_mpi.kernels.exact_sums import SIZE, add_products, carry, value
from pdfem_mpi.kernels.simd import W
from pdfem_mpi.parallel.comm import largest, sum_integers
from pdfem_mpi.peridynamics.bonds import Bonds
from pdfem_mpi.peridynamics.critical_stretches import UNBREAKABLE
from pdfem_mpi.peridynamics.points import Points

#: Records a sweep can hold before they are booked; a point with more rows gets more.
RECORDS = 16384
#: Signs by which lower and upper corners of bounding boxes are both largest.
SIDES = np.array([[-1.0], [1.0]])


@dataclass(frozen=True)
class Broken:
    """Bonds that broke on this rank: local points and stored numbers, shapes (n, 2).

    ``share`` is the part of their stiffness that they lost, shape (n,); None: all of it.
    """

    pairs: np.ndarray
    strengths: np.ndarray
    share: np.ndarray | None = None


@dataclass
class Failure:
    """Critical stretches, and the books of broken bonds of one rank.

    Attributes
    ----------
    class_of : uint8, shape (n_clusters,)
        Class (see `point_classes`) of the points of each local cluster.
    stretch : float64, shape (n_classes, n_classes)
        Critical stretch by the classes of the two points; at least `UNBREAKABLE` if the bond does not break.
    pairs, strengths, counter
        Records of the sweep under way (see kernels/bond_sweeps.py).
    nearest : float, dimension length
        Bonds up to this length break like others, but do not tell at which load the next bond breaks.
    global_pairs : list of int64 arrays (n, 2)
        Global ids (lower, higher) of all bonds broken on this rank; an image's id is above that of its point by the
        number of its reflection times the number of points.
    count : int
        Their number on all ranks.
    dissipated : float, dimension force length
        The energy all of them had when they broke.
    extent : float64, shape (2, 3), dimension length
        Bounding box of the midpoints of all broken bonds; inf where there are none.
    last_extent : float64, shape (2, 3), dimension length
        That of the bonds broken by the last evaluation that broke any.
    released_at_points : callable or None
        What else than their own energy `Broken` bonds took at the last evaluation, as digits of all ranks. Collective.
    """

    class_of: np.ndarray
    stretch: np.ndarray
    pairs: np.ndarray
    strengths: np.ndarray
    counter: np.ndarray
    nearest: float = 0.0
    global_pairs: list[np.ndarray] = field(default_factory=list)
    count: int = 0
    dissipated: float = 0.0
    extent: np.ndarray = field(default_factory=lambda: nowhere())
    last_extent: np.ndarray = field(default_factory=lambda: nowhere())
    released_at_points: Callable[[Any, Broken], np.ndarray] | None = None
    in_teeth: ClassVar[bool] = False  # whether bonds lose their stiffness in steps
    _fresh: list[Broken] = field(default_factory=list)
    _pairs: list[np.ndarray] | None = None
    _digits: np.ndarray = field(default_factory=lambda: np.zeros(SIZE, np.int64))
    _total: np.ndarray = field(default_factory=lambda: np.zeros(SIZE, np.int64))
    _box: np.ndarray = field(default_factory=lambda: nowhere())
    _closed: int = 0

    def limits(self, finite: bool, margin: float) -> tuple[np.ndarray, np.ndarray]:
        """What the sweeps compare with, for stretches beyond ``(1 - margin) s_0``.

        Returns
        -------
        trigger : float64, shape (n_classes,)
        critical : float64, shape (n_classes, n_classes)
            Of ``e`` (finite) or of the stretch (linear).
        """
        s = (1.0 - margin) * self.stretch
        critical = s * (2.0 + s) if finite else s
        return critical.min(axis=1), critical

    @property
    def records(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """What the sweeps write to."""
        return self.pairs, self.strengths, self.counter

    def book(self, points: Points, bonds: Bonds, S: np.ndarray) -> None:
        """Empty the records into the books; the bonds' energies are those at the displacements of the table ``S``."""
        n = int(self.counter[0])
        if n == 0:
            return
        self.counter[0] = 0
        pairs, strengths = self.pairs[:n].copy(), self.strengths[:n].copy()
        energies = np.empty(n)
        bond_failure.broken_energies(pairs, strengths, n, S.reshape(-1), bonds.finite, energies)
        add_products(energies, np.ones(n), self._digits)
        self._enter(points, pairs, strengths)

    def _enter(self, points: Points, pairs: np.ndarray, strengths: np.ndarray) -> None:
        self.global_pairs.append(global_ids(points, pairs))
        widen(self._box, points, pairs)
        self._fresh.append(Broken(pairs, strengths))
        if self._pairs is not None:
            self._pairs.append(pairs)

    def advance(self, points: Points, S: np.ndarray, margin: float) -> None:
        """Move on what has softened, at the displacements of the table; brittle bonds do not."""

    def take_excess(self) -> float:
        """What bonds released beyond the energy that is booked: brittle ones are booked with all of it."""
        return 0.0

    def close(self, comm) -> int:
        """Join the books of all ranks after an evaluation that breaks; the number of bonds it broke. Collective."""
        fresh = _joined(self._fresh[self._closed :])
        joined = sum_integers(comm, np.append(self._digits, len(fresh.pairs)))
        self._closed = len(self._fresh)
        if joined[-1]:
            self._digits[:] = 0
            more = self.released_at_points(comm, fresh) if self.released_at_points else 0
            self._total += joined[:-1] + more
            carry(self._total)
            self.count += int(joined[-1])
            self.dissipated = value(self._total)
            self.last_extent = SIDES * largest(comm, SIDES * self._box)
            self.extent = SIDES * np.maximum(SIDES * self.extent, SIDES * self.last_extent)
            self._box = nowhere()
        return int(joined[-1])

    def take(self) -> Broken:
        """The bonds broken on this rank since the last call."""
        taken = _joined(self._fresh)
        self._fresh.clear()
        self._closed = 0
        return taken

    def take_pairs(self) -> np.ndarray:
        """Local points of the bonds broken on this rank since the last call, int64, shape (n, 2); none at the first."""
        taken = np.concatenate([np.empty((0, 2), np.int64), *(self._pairs or ())])
        self._pairs = []
        return taken

    def largest_ratio(self, comm, bonds: Bonds, S: np.ndarray, most: float = math.inf) -> float:
        """Largest stretch relative to its critical one, of the intact bonds that tell at the table ``S``. Collective.

        Where none of them is stretched, all tell. Ratios above ``most`` do not count; then all bonds tell at once.
        """

        def top(nearest):
            return float(largest(comm, np.array([self._rank_ratio(bonds, S, nearest, most)]))[0])

        return (top(self.nearest) if most == math.inf else 0.0) or top(0.0)

    def _rank_ratio(self, bonds: Bonds, S: np.ndarray, nearest: float, most: float) -> float:
        """`largest_ratio` of this rank's bonds that are longer than ``nearest``."""
        inverse = np.where(self.stretch < UNBREAKABLE, 1.0 / self.stretch, 0.0)
        rest = S.reshape(-1), self.class_of, inverse, bonds.finite, nearest**2, most
        return max(bond_failure.largest_ratio(*rows.arrays, *rest) for rows in bonds.rows)

    def broken_pairs(self) -> np.ndarray:
        """Global ids (lower, higher) of the bonds broken on this rank, int64, shape (n, 2)."""
        return np.concatenate([np.empty((0, 2), np.int64), *self.global_pairs])

    def restore(
        self, comm, points: Points, bonds: Bonds, broken: np.ndarray, dissipated: np.ndarray, total: int | None = None
    ) -> None:
        """Break the bonds of another run of the scene, on whatever ranks they stand now. Collective.

        Parameters
        ----------
        broken : int64, shape (n, 2)
            Global ids of all broken bonds with an end on this rank, at least.
        dissipated : int64, shape (SIZE,)
            `dissipated_digits` of that run.
        total : int, optional
            Number of broken bonds on all ranks, if ``broken`` are not all of them.

        Raises
        ------
        ValueError
            On all ranks: some of them are not bonds of this scene.
        """
        total = len(broken) if total is None else total
        for pairs, strengths, _ in break_again(points, bonds, broken):
            self._enter(points, pairs, strengths)
        if self.close(comm) != total:
            raise ValueError(f"only {self.count} of {total} broken bonds are bonds of this scene")
        self._total[:] = dissipated
        self.dissipated = value(self._total)

    @property
    def dissipated_digits(self) -> np.ndarray:
        """The dissipated energy as an exact sum, equal on all ranks; int64, shape (SIZE,)."""
        return self._total


def _joined(parts: list[Broken]) -> Broken:
    """All of several."""
    pairs = np.concatenate([np.empty((0, 2), np.int64), *(part.pairs for part in parts)])
    return Broken(pairs, np.concatenate([np.empty((0, 2), np.float32), *(part.strengths for part in parts)]))


def nowhere() -> np.ndarray:
    """The bounding box of nothing."""
    return np.array([[np.inf] * 3, [-np.inf] * 3])


def break_again(points: Points, bonds: Bonds, broken: np.ndarray) -> Iterator[tuple[np.ndarray, ...]]:
    """Break bonds given by their global ids, int64, shape (n, 2), as far as they stand in rows of this rank.

    Yields
    ------
    pairs, strengths : int64, float32, shape (m, 2)
        As the sweeps record them.
    which : int64, shape (m,)
        Of the bonds given.
    """
    wanted, which = local_points(points, broken)
    for rows in bonds.rows:
        pairs, strengths = np.empty_like(wanted), np.empty(wanted.shape, np.float32)
        found = np.empty(len(wanted), np.int64)
        n = bond_failure.break_listed(wanted, *rows.arrays, bonds.finite, pairs, strengths, found)
        if n:
            yield pairs[:n].copy(), strengths[:n].copy(), which[found[:n]]


def widen(box: np.ndarray, points: Points, pairs: np.ndarray) -> None:
    """Widen a bounding box, shape (2, 3), by the midpoints of bonds."""
    place = 12 * (pairs // W) + pairs % W
    for d in range(3):
        middle = 0.5 * (points.x[place[:, 0] + W * d] + points.x[place[:, 1] + W * d])
        box[0, d] = min(box[0, d], middle.min(initial=np.inf))
        box[1, d] = max(box[1, d], middle.max(initial=-np.inf))


def global_ids(points: Points, pairs: np.ndarray) -> np.ndarray:
    """Global ids (lower, higher) of bonds given by local points, int64, shape (n, 2)."""
    return np.sort(8 * points.cell_key[pairs // 8] + pairs % 8, axis=1)


def local_points(points: Points, ids: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Local indices of pairs of points, images included, of which this rank owns one and sees both.

    Returns
    -------
    int64, shape (m, 2)
    int64, shape (m,)
        Which of the pairs they are.
    """
    number = points.cell_key
    order = np.argsort(number, kind="stable")
    if not len(order) or not len(ids):
        return np.empty((0, 2), np.int64), np.empty(0, np.int64)
    place = np.minimum(np.searchsorted(number, ids // 8, sorter=order), len(order) - 1)
    cell = order[place]
    here = (number[cell] == ids // 8).all(axis=1) & (cell < points.n_owned).any(axis=1)
    return np.ascontiguousarray((8 * cell + ids % 8)[here]), np.flatnonzero(here)
