"""Grid cells and grid nodes that are dealt out over the ranks, known by their numbers in the grid."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pdfem_mpi.parallel.directory import Directory
from pdfem_mpi.parallel.election import elect, told
from pdfem_mpi.parallel.halo import Halo, build_halo


@dataclass(frozen=True)
class Spread:
    """What one rank has of them.

    Attributes
    ----------
    ids : int64, shape (n_owned + n_ghost,)
        Numbers of those that the rank owns, rising, then of others' by rank and number.
    halo : Halo
    """

    ids: np.ndarray
    halo: Halo

    @property
    def owned(self) -> np.ndarray:
        """Numbers of the rank's own, int64, rising."""
        return self.ids[: self.halo.n_owned]

    def places(self, ids: np.ndarray) -> np.ndarray:
        """Where known ones stand here; int64, shape of ``ids``."""
        order = np.argsort(self.ids, kind="stable")
        return order[np.searchsorted(self.ids, ids, sorter=order)]


def spread_by_claims(comm, ids: np.ndarray, claims: np.ndarray, together: int = 1) -> Spread:
    """Find owners for what ranks know, each by its largest claim. Collective.

    Parameters
    ----------
    ids, claims : int64, shape (n,)
        As for `elect`.
    together : int
        Of so many ranks, which follow one another, the first one owns for all. Those lie side by side in the body.
    """
    owner = elect(comm, ids, claims) // together * together
    others = owner != comm.rank
    return _spread(comm, told(comm, ids, owner), ids[others], owner[others])


def with_copies(comm, owned: np.ndarray, seen: np.ndarray, n: int) -> Spread:
    """Copies of what this rank sees of others', beside its own; what nobody owns is left out. Collective.

    Parameters
    ----------
    owned : int64, shape (n_owned,)
        Rising.
    seen : int64, any shape
    n : int
        Of the whole grid.
    """
    others = np.setdiff1d(seen, owned)
    owner = Directory.of(comm, owned, np.full(len(owned), comm.rank), n).ask(others)
    there = owner >= 0
    return _spread(comm, owned, others[there], owner[there])


def _spread(comm, owned: np.ndarray, others: np.ndarray, owner: np.ndarray) -> Spread:
    order = np.lexsort((others, owner))
    return Spread(np.concatenate([owned, others[order]]), build_halo(comm, owned, others[order], owner[order]))
