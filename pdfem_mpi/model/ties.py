"""Places that move as one along some axes, such as those beneath a loading pin.

All displacements lie in the space in which tied unknowns are equal, and the force that counts for each of them is the
mean over its group: the projection of the forces on that space. A residual is 0 where the sum over the group is. So
relaxation and conjugate gradients work as they are. The mean is an exact sum over a count: the same bits everywhere.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from pdfem_mpi.body.share import Share
from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.deck.table import AXES
from pdfem_mpi.model.own_places import OwnPlaces
from pdfem_mpi.model.unknowns import Unknowns
from pdfem_mpi.parallel.comm import largest, sum_integers
from pdfem_mpi.parallel.sums import exact_dots


@dataclass(frozen=True)
class Group:
    """Unknowns that are equal.

    Attributes
    ----------
    table, axis : int
        Of the deck's ``ties``, and 0, 1 or 2 for x, y and z.
    index : int64, shape (n,)
        Of this rank.
    ones : float64, shape (n,)
    count : int
        On all ranks.
    """

    table: int
    axis: int
    index: np.ndarray
    ones: np.ndarray
    count: int


@dataclass(frozen=True)
class Ties:
    """All groups of a body; their methods are collective."""

    groups: tuple[Group, ...]

    @property
    def index(self) -> np.ndarray:
        """All tied unknowns of this rank; int64."""
        return np.concatenate([group.index for group in self.groups])

    def average(self, comm, *vectors: np.ndarray) -> None:
        """Give each group its mean, in vectors over the unknowns."""
        pairs = [(vector[group.index], group.ones) for vector in vectors for group in self.groups]
        sums = iter(exact_dots(comm, pairs).tolist())
        for vector in vectors:
            for group in self.groups:
                vector[group.index] = next(sums) / group.count

    def raise_to_largest(self, comm, mass: np.ndarray) -> None:
        """Give each group the largest of its masses: together they bound the stiffness of all its rows."""
        tops = largest(comm, np.array([mass[group.index].max(initial=0.0) for group in self.groups]))
        for group, top in zip(self.groups, tops.tolist(), strict=True):
            mass[group.index] = top

    def apart(self, comm, vectors: Iterable[np.ndarray]) -> list[np.ndarray]:
        """What vectors have at tied unknowns beside their groups' means: 0 for what a tie lets be."""
        found = []
        for vector in vectors:
            mean = vector.copy()
            self.average(comm, mean)
            found.append((vector - mean)[self.index])
        return found


def make_ties(scene: Scene, share: Share, unknowns: Unknowns) -> Ties | None:
    """The deck's ties on this rank; None without any. Collective.

    Tables whose places were not found are left out: `loads.make_load_case` refuses them.
    """
    if not scene.ties:
        return None
    groups, places = [], OwnPlaces(share, unknowns)
    for number, (tie, chosen) in enumerate(zip(scene.ties, share.selections.ties, strict=True)):
        if chosen is None:
            continue
        table = np.concatenate(places.unknowns(chosen))
        for d in tie.axes:
            index = np.unique(table[:, d])
            (count,) = sum_integers(share.comm, np.array([len(index)])).tolist()
            groups.append(Group(number, d, index, np.ones(len(index)), max(count, 1)))
    return Ties(tuple(groups)) if groups else None


def find_problems(share: Share, ties: Ties, fixed: np.ndarray) -> list[str]:
    """Sentences about ties of one place, of places that supports or mirror planes hold, or of two ties. Collective.

    Parameters
    ----------
    fixed : bool, shape (n_unknowns,)
    """
    messages, tied = [], np.full(len(fixed), -1)
    for group in ties.groups:
        held = np.count_nonzero(fixed[group.index])
        other = tied[group.index]
        (n_held, n_twice) = sum_integers(share.comm, np.array([held, np.count_nonzero(other >= 0)])).tolist()
        first = int(largest(share.comm, np.array([other.max(initial=-1)], float))[0])
        where = f"ties.{group.table}.along"
        if group.count < 2:
            messages.append(f"{where} = {AXES[group.axis]} ties one place to itself. Choose more places, or remove it.")
        elif n_held:
            messages.append(
                f"{where} = {AXES[group.axis]} ties {group.count} places, and {n_held} of them are held along "
                f"{AXES[group.axis]} by supports or mirror planes. Move all of them by a support, or tie others."
            )
        elif n_twice:
            messages.append(
                f"{where} = {AXES[group.axis]} ties {n_twice} places that ties.{first} ties along {AXES[group.axis]} "
                "already. Make one table of both, or choose other places."
            )
        tied[group.index] = group.table
    return messages
