"""The books of a body whose bonds soften: what left its rows, how far each of it is, and the energy it took.

A bond that passes its first limit leaves its row for the list of `softened`, and goes on there tooth by tooth. Its
energy is booked at the limits of the teeth; what it released beyond them was on its way to somewhere else, and is told
apart. So the books mean fracture energy times area, however far a load overshoots.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from pdfem_mpi.kernels.exact_sums import SIZE, add_products, carry, value
from pdfem_mpi.kernels.simd import W
from pdfem_mpi.parallel.comm import largest, sum_integers
from pdfem_mpi.peridynamics.bonds import Bonds
from pdfem_mpi.peridynamics.failure import Broken, Failure, break_again, global_ids, nowhere, widen
from pdfem_mpi.peridynamics.points import Points
from pdfem_mpi.peridynamics.softened import LawTable, Moved, SoftenedBonds, squared_lengths

#: A tooth beyond all: of bonds that a run with a brittle law broke.
GONE = 2**16


@dataclass
class SofteningFailure(Failure):
    """Critical stretches, and the books of one rank's bonds that soften.

    ``count`` and ``extent`` are of bonds that are gone, ``global_pairs`` and `broken_pairs` of all that have softened.

    Attributes
    ----------
    softened : SoftenedBonds
    soft : int
        Bonds in the lists of all ranks.
    left : int
        Bonds that left the rows on all ranks: softened or gone.
    area : float, dimension length^2
        Energy of the bonds that are gone over the fracture energy of their law.
    skipped : int
        Bonds that passed more than one tooth in one sweep, on all ranks.
    """

    softened: SoftenedBonds = None
    soft: int = 0
    left: int = 0
    area: float = 0.0
    skipped: int = 0
    in_teeth: ClassVar[bool] = True
    _teeth: list[np.ndarray] = field(default_factory=list)
    _moved: np.ndarray = field(default_factory=lambda: np.zeros(3, np.int64))
    _sums: np.ndarray = field(default_factory=lambda: np.zeros((2, SIZE), np.int64))
    _area: np.ndarray = field(default_factory=lambda: np.zeros(SIZE, np.int64))
    _gone_box: np.ndarray = field(default_factory=lambda: nowhere())
    _excess: float = 0.0
    _lost: list[Broken] = field(default_factory=list)

    def book(self, points: Points, bonds: Bonds, S: np.ndarray) -> None:
        """Take the records into the list; `advance` finds their teeth."""
        n = int(self.counter[0])
        if n:
            self.counter[0] = 0
            self._leave(points, self.pairs[:n].copy(), self.strengths[:n].copy(), 0)

    def _leave(self, points: Points, pairs: np.ndarray, strengths: np.ndarray, tooth: np.ndarray | int) -> None:
        """Enter bonds that left their rows."""
        first = sum(map(len, self._teeth))
        self.global_pairs.append(global_ids(points, pairs))
        self._teeth.append(np.full(len(pairs), tooth, np.int64))
        if len(self._teeth) > 1:  # one array, in which bonds have their places
            self._teeth = [np.concatenate(self._teeth)]
        place = first + np.arange(len(pairs))
        law = self.softened.law_of[self.class_of[pairs[:, 0] // W], self.class_of[pairs[:, 1] // W]]
        self.softened.append(pairs, strengths, law, place, tooth)
        self._moved[2] += len(pairs)
        if self._pairs is not None:
            self._pairs.append(pairs)

    def advance(self, points: Points, S: np.ndarray, margin: float) -> None:
        """Move bonds of the list on at the displacements of the table, those that came since the last time at least
        through their first tooth, and book them.
        """
        moved = self.softened.advance(S.reshape(-1), margin)
        if moved is None:
            return
        ones, laws = np.ones(len(moved.pairs)), self.softened.laws
        self._teeth[0][moved.place] = moved.after
        add_products(moved.spent, ones, self._digits)
        add_products(moved.excess, ones, self._sums[0])
        gone = moved.after >= laws.teeth[moved.law]
        area = moved.whole[gone] / laws.fracture_energy[moved.law[gone]]
        add_products(area, np.ones(len(area)), self._sums[1])
        widen(self._box, points, moved.pairs)
        widen(self._gone_box, points, moved.pairs[gone])
        skips = np.count_nonzero(moved.after - moved.before > 1)
        self._moved += np.array([len(ones), skips, 0])
        self._fresh += changes(moved, laws)
        if self.released_at_points:
            self._lost.append(lost(moved, laws))

    def close(self, comm) -> int:
        """Join the books of all ranks after an evaluation that breaks; the bonds that moved on in it. Collective."""
        counts = np.append(self._moved, [self.softened.n, sum(map(len, self._teeth)) - self.softened.n])
        joined = sum_integers(comm, np.concatenate([self._digits, self._sums.reshape(-1), counts]))
        moved, skipped, left, soft, gone = joined[3 * SIZE :].tolist()
        if not moved:
            return 0
        digits, excess, area = joined[: 3 * SIZE].reshape(3, SIZE)
        self._total += digits
        self._area += area
        for sums in (self._total, self._area, excess):
            carry(sums)
        self.dissipated, self.area = value(self._total), value(self._area)
        self._excess += value(excess)
        if self.released_at_points:
            close_at_points(self, comm, value(digits), value(excess))
        self.left, self.skipped = self.left + left, self.skipped + skipped
        self.soft, self.count = soft, gone
        sign = np.array([[-1.0], [1.0]])
        self.last_extent = sign * largest(comm, sign * self._box)
        self.extent = sign * np.maximum(sign * self.extent, largest(comm, sign * self._gone_box))
        self._digits[:], self._sums[:], self._moved[:] = 0, 0, 0
        self._box, self._gone_box = nowhere(), nowhere()
        return moved

    def take_excess(self) -> float:
        """What bonds released beyond the energy that is booked, since the last call; the same on all ranks."""
        excess, self._excess = self._excess, 0.0
        return excess

    def broken_pairs(self) -> np.ndarray:
        """Global ids (lower, higher) and tooth of the bonds that left the rows on this rank, int64, shape (n, 3)."""
        return np.column_stack([super().broken_pairs(), np.concatenate([np.empty(0, np.int64), *self._teeth])])

    def restore(
        self, comm, points: Points, bonds: Bonds, broken: np.ndarray, dissipated: np.ndarray, total: int | None = None
    ) -> None:
        """Soften and break the bonds of another run of the scene; see `Failure.restore`. Collective.

        ``broken`` has a third column, the teeth.
        """
        total = len(broken) if total is None else total
        softened, laws = self.softened, self.softened.laws
        for pairs, strengths, which in break_again(points, bonds, broken[:, :2]):
            self._leave(points, pairs, strengths, broken[which, 2])
        n = softened.n
        softened.tooth[:n] = np.minimum(softened.tooth[:n], laws.teeth[softened.law[:n]])
        law, tooth = softened.law[:n].copy(), softened.tooth[:n].copy()
        pairs, strengths = softened.pairs[:n].copy(), softened.strengths[:n].copy()
        square = 1.0 / strengths[:, 1].astype(float) if bonds.finite else squared_lengths(pairs, points.x)
        whole = softened.unit_energy(strengths[:, 0], square) * laws.spent[law, -1]
        gone = tooth >= laws.teeth[law]
        area = whole[gone] / laws.fracture_energy[law[gone]]
        add_products(area, np.ones(len(area)), self._sums[1])
        nothing = np.zeros(n)
        moved = Moved(
            pairs, strengths, law, np.zeros_like(tooth), tooth, softened.place[:n].copy(), nothing, nothing, whole
        )
        widen(self._gone_box, points, pairs[gone])
        self._fresh += changes(moved, laws)
        self._moved[0] += n
        softened.let_go()
        self.close(comm)
        if self.left != total:
            raise ValueError(f"only {self.left} of {total} softened and broken bonds are bonds of this scene")
        self._total[:] = dissipated
        self.dissipated = value(self._total)

    def _rank_ratio(self, bonds: Bonds, S: np.ndarray, nearest: float, most: float) -> float:
        return max(
            super()._rank_ratio(bonds, S, nearest, most), self.softened.largest_ratio(S.reshape(-1), nearest**2, most)
        )


def close_at_points(failure: SofteningFailure, comm, spent: float, excess: float) -> None:
    """Book what the dilatations of points released with the bonds, in the parts in which these did. Collective.

    Parameters
    ----------
    spent, excess : float, dimension force length
        What the bonds spent at their limits and what they released beyond them, on all ranks.
    """
    released = failure.released_at_points(comm, all_lost(failure._lost))
    failure._lost.clear()
    carry(released)
    part = spent / (spent + excess) if spent + excess > 0.0 else 1.0
    add_products(np.array([part * value(released)]), np.ones(1), failure._total)
    carry(failure._total)
    failure.dissipated = value(failure._total)
    failure._excess += (1.0 - part) * value(released)


def lost(moved: Moved, laws: LawTable) -> Broken:
    """Bonds that moved on, with the part of their stiffness that they lost."""
    before, after = (laws.stiffness[moved.law, tooth] for tooth in (moved.before, moved.after))
    return Broken(moved.pairs, moved.strengths, before - after)


def all_lost(parts: list[Broken]) -> Broken:
    """What bonds lost, in one table."""
    none = Broken(np.empty((0, 2), np.int64), np.empty((0, 2), np.float32), np.empty(0))
    names = ("pairs", "strengths", "share")
    return Broken(*(np.concatenate([getattr(part, name) for part in [none, *parts]]) for name in names))


def changes(moved: Moved, laws: LawTable) -> list[Broken]:
    """The stiffness that bonds had and that they have now, as it is taken out of diagonal blocks.

    What is left of a bond is taken out with the other sign, so that the sum over its teeth telescopes: a run that goes
    on from a checkpoint takes it out at once.
    """
    found = []
    for sign, tooth in ((1.0, moved.before), (-1.0, moved.after)):
        scaled = moved.strengths.copy()
        scaled[:, 0] *= (sign * laws.stiffness[moved.law, tooth]).astype(np.float32)
        found.append(Broken(moved.pairs, scaled))
    return found
