"""The softened bonds of a rank: a list beside the rows, whose kernels are `kernels.softened_bonds`.

Few bonds are ever in it, a crack's process zone: those that left their rows and are not gone. Loops over the rows do
not know of them, so that a body of brittle bonds has and does nothing of this.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from pdfem_mpi.body.share import Share
from pdfem_mpi.body.softening import BondLaw
from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.kernels.exact_sums import add_products
from pdfem_mpi.kernels.simd import W
from pdfem_mpi.kernels.softened_bonds import (
    add_softened_forces,
    add_softened_tangent,
    advance_softened,
    measure_softened,
    write_slots,
)
from pdfem_mpi.kernels.union_find import join_rows
from pdfem_mpi.peridynamics.critical_stretches import bond_laws

if TYPE_CHECKING:
    from pdfem_mpi.peridynamics.bonds import Bonds

#: Bonds that the list has room for at first; it doubles.
ROOM = 1024


@dataclass(frozen=True)
class LawTable:
    """Laws side by side, each filled up to the longest.

    Attributes
    ----------
    limit : float64, shape (n_laws, most teeth), dimension 1
    stiffness : float64, shape (n_laws, most teeth + 1), dimension 1
        Of the intact one.
    teeth : int64, shape (n_laws,)
    spent : float64, shape (n_laws, most teeth + 1), dimension 1
        Energy spent up to a tooth, over that of the intact bond at stretch 1.
    fracture_energy : float64, shape (n_laws,), dimension force / length
        Of the bulk's bonds, without the dilatation beside them; model units.
    """

    limit: np.ndarray
    stiffness: np.ndarray
    teeth: np.ndarray
    spent: np.ndarray
    fracture_energy: np.ndarray


def make_law_table(laws: Sequence[BondLaw], energy_unit: float) -> LawTable:
    """The table of some laws; ``energy_unit`` is the model's unit of force / length in the deck's units."""
    teeth = np.array([len(law.teeth.limit) for law in laws])
    limit = np.full((len(laws), teeth.max()), np.inf)
    stiffness = np.zeros((len(laws), teeth.max() + 1))
    spent = np.zeros_like(stiffness)
    for k, law in enumerate(laws):
        n = teeth[k]
        limit[k, :n], stiffness[k, : n + 1] = law.teeth.limit, law.teeth.stiffness
        spent[k, 1 : n + 1] = np.cumsum(-np.diff(law.teeth.stiffness) * law.teeth.limit**2)
        spent[k, n + 1 :] = spent[k, n]
    return LawTable(limit, stiffness, teeth, spent, np.array([law.energy_of_bonds for law in laws]) / energy_unit)


@dataclass(frozen=True)
class Moved:
    """Bonds that moved on by one sweep.

    Attributes
    ----------
    pairs, strengths : int64, float32, shape (n, 2)
    law, before, after, place : int64, shape (n,)
        Law, teeth, and the bond's place in the books.
    spent, excess, whole : float64, shape (n,), dimension force length
        Energy spent at the limits passed, what the bonds released beyond it, and what they spend until they are gone.
    """

    pairs: np.ndarray
    strengths: np.ndarray
    law: np.ndarray
    before: np.ndarray
    after: np.ndarray
    place: np.ndarray
    spent: np.ndarray
    excess: np.ndarray
    whole: np.ndarray


class SoftenedBonds:
    """The list of one rank.

    Parameters
    ----------
    laws : LawTable
    law_of : int64, shape (n_classes, n_classes)
        Law of the bonds between points of two classes.
    finite : bool
        Of the bonds' kinematics.

    Attributes
    ----------
    n : int
        Bonds in the list.
    pairs, strengths : int64, float32, shape (room, 2)
        Local points, and stored numbers of the intact bond.
    law, tooth, place : int64, shape (room,)
        ``place`` is that in the books of `SofteningFailure`.
    """

    def __init__(self, laws: LawTable, law_of: np.ndarray, finite: bool):
        self.laws, self.law_of, self.finite, self.n, self._fresh = laws, law_of, finite, 0, 0
        self.pairs, self.strengths = np.empty((ROOM, 2), np.int64), np.empty((ROOM, 2), np.float32)
        self.law, self.tooth, self.place = (np.empty(ROOM, np.int64) for _ in range(3))

    def append(
        self, pairs: np.ndarray, strengths: np.ndarray, law: np.ndarray, place: np.ndarray, tooth: np.ndarray | int = 0
    ) -> None:
        """Take bonds that have left their rows."""
        first, self.n = self.n, self.n + len(pairs)
        while self.n > len(self.law):
            for name in ("pairs", "strengths", "law", "tooth", "place"):
                array = getattr(self, name)
                setattr(self, name, np.concatenate([array, np.empty_like(array)]))
        new = slice(first, self.n)
        self.pairs[new], self.strengths[new], self.law[new], self.place[new] = pairs, strengths, law, place
        self.tooth[new] = tooth

    def add_forces(self, S: np.ndarray, SI: np.ndarray, quantum: float) -> float:
        """Add the forces to a table; the largest of what `Bounds.bond` bounds."""
        return add_softened_forces(*self.listed, self.finite, S, SI, quantum)

    def add_tangent(self, S: np.ndarray, SI: np.ndarray, quantum: float) -> float:
        """Add the tangent's forces to a table; the largest component."""
        return add_softened_tangent(*self.listed, S, SI, quantum)

    def add_energies(self, S: np.ndarray, digits: np.ndarray) -> None:
        """Add the strain energies to an exact sum."""
        _, _, energy = self._measure(S)
        add_products(energy * self.share, np.ones(self.n), digits)

    def largest_ratio(self, S: np.ndarray, nearest: float, most: float) -> float:
        """Largest stretch over its next limit; bonds as `bond_failure.largest_ratio` counts them."""
        if not self.n:
            return 0.0
        stretch, square, _ = self._measure(S)
        ratio = stretch / self.laws.limit[self.law[: self.n], self.tooth[: self.n]]
        counts = (square > nearest) & (ratio < most)
        return float(ratio[counts].max(initial=0.0))

    def advance(self, S: np.ndarray, margin: float) -> Moved | None:
        """Move bonds on through the teeth that they pass, and let go of those that are gone; None if none moved."""
        n, laws = self.n, self.laws
        if not n:
            return None
        stretch, square, energy = self._measure(S)
        before = self.tooth[:n].copy()
        if not advance_softened(n, self.law, self.tooth, laws.limit, laws.teeth, self._fresh, stretch, margin):
            return None
        moved = np.flatnonzero(before != self.tooth[:n])
        law, before, after = self.law[moved], before[moved], self.tooth[moved]
        unit = self.unit_energy(self.strengths[moved, 0], square[moved])
        spent = unit * (laws.spent[law, after] - laws.spent[law, before])
        released = energy[moved] * (laws.stiffness[law, before] - laws.stiffness[law, after])
        result = Moved(
            self.pairs[moved], self.strengths[moved], law, before, after, self.place[moved], spent, released - spent,
            unit * laws.spent[law, -1],
        )  # fmt: skip
        self.let_go()
        return result

    def unit_energy(self, strength: np.ndarray, square: np.ndarray) -> np.ndarray:
        """Energy of intact bonds at stretch 1 from their first stored number and squared length."""
        strength = strength.astype(float)
        return strength * square if self.finite else 0.5 * strength * square * square

    @property
    def share(self) -> np.ndarray:
        """What is left of the stiffness of each bond, float64, shape (n,)."""
        return self.laws.stiffness[self.law[: self.n], self.tooth[: self.n]]

    def join(self, parent: np.ndarray, bonded: np.ndarray) -> None:
        """Join the points of every bond, as `Bonds.join`."""
        pairs = self.pairs[: self.n]
        bonded[pairs.reshape(-1)] = 1
        join_rows(pairs, parent)

    @property
    def listed(self) -> tuple:
        """What every kernel of the list begins with."""
        return self.n, self.pairs, self.strengths, self.law, self.tooth, self.laws.stiffness

    def _measure(self, S: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        stretch, square, energy = (np.empty(self.n) for _ in range(3))
        measure_softened(*self.listed, self.finite, S, stretch, square, energy)
        return stretch, square, energy

    def let_go(self) -> None:
        """Leave out the bonds that are gone; those that come next are fresh."""
        n = self.n
        stays = self.tooth[:n] < self.laws.teeth[self.law[:n]]
        self.n = int(np.count_nonzero(stays))
        if self.n < n:
            for array in (self.pairs, self.strengths, self.law, self.tooth, self.place):
                array[: self.n] = array[:n][stays]
        self._fresh = self.n


def squared_lengths(pairs: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Squared lengths of bonds; ``x``, shape (n_clusters * 12,), are positions in cluster layout."""
    place = 12 * (pairs // W) + pairs % W
    d = [x[place[:, 1] + W * k] - x[place[:, 0] + W * k] for k in range(3)]
    return (d[0] * d[0] + d[1] * d[1]) + d[2] * d[2]


def make_softened(scene: Scene, share: Share, bonds: Bonds) -> SoftenedBonds:
    """The empty list of a scene whose bonds soften.

    Raises
    ------
    SceneError
        Strength and energy do not go with the internal length.
    """
    laws, which = bond_laws(scene, share)
    unit = share.units.stress * share.units.length
    return SoftenedBonds(make_law_table(laws, unit), which, bonds.finite)


@contextlib.contextmanager
def in_their_rows(bonds: Bonds | None, softened_still: bool = False) -> Iterator[None]:
    """Have the softened bonds in the rows again: as stiff as they were, for sums that bound the stiffness, or with what
    is left of it, for stresses.
    """
    softened = bonds and bonds.softened
    if not softened:
        yield
        return
    pairs, strengths = (array[: softened.n].copy() for array in (softened.pairs, softened.strengths))
    if softened_still:
        strengths[:, 0] *= softened.share.astype(np.float32)

    def write(values: np.ndarray) -> None:
        for rows in bonds.rows:
            write_slots(pairs, values, *rows.arrays, softened.finite)

    write(strengths)
    try:
        yield
    finally:
        write(np.zeros_like(strengths))
