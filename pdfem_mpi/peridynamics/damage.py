"""Local damage of the peridynamic points, eq. (5): the weighted share of a point's bonds that are broken."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from pdfem_mpi.kernels.local_damage import add_bond_weights, add_listed_weights, add_shared_weights
from pdfem_mpi.kernels.simd import W
from pdfem_mpi.parallel.comm import largest
from pdfem_mpi.peridynamics.bonds import Bonds
from pdfem_mpi.peridynamics.images import SCALAR, halo_for
from pdfem_mpi.peridynamics.points import Points

#: A term has this many bits: a point may have ``2**(63 - TERM_BITS)`` bonds, far more than fit into memory.
TERM_BITS = 40


def family_weights(comm, points: Points, bonds: Bonds, listed: np.ndarray | None = None) -> np.ndarray:
    """``sum_j mu exp(-(|xi|/l)^2) w_j`` over the bonds that the owned points have now (eq. 5). Collective.

    Parameters
    ----------
    listed : int64, shape (n, 2), optional
        The bonds to take instead: local points, each bond on one rank.

    Returns
    -------
    int64, shape (n_owned, 8)
        By cell and point, in multiples of one quantum: the same integers on any number of ranks. Two calls for one
        body have the same quantum.
    """
    quantum = _quantum(comm, points)
    sums = np.zeros(points.n_clusters * W, np.int64)
    stride = (2 if bonds.finite else 1) * W
    numbers = points.cell_number, points.x, points.volume, quantum, sums
    if listed is not None:
        add_listed_weights(listed, *numbers)
    else:
        for rows in bonds.rows:
            add_bond_weights(*rows.arrays, stride, *numbers)
    halo_for(points.halo, SCALAR).scatter_reverse(sums.reshape(-1, 2, 1, W))
    return sums.reshape(-1, 2 * W)[: points.n_owned].copy()  # without the ghosts


def softened_weights(comm, points: Points, bonds: Bonds, share: np.ndarray) -> np.ndarray:
    """`family_weights` of the bonds that have softened, each times a share of it. Collective.

    Parameters
    ----------
    share : float64, shape (bonds.softened.n,)
    """
    quantum = _quantum(comm, points)
    sums = np.zeros(points.n_clusters * W, np.int64)
    pairs = bonds.softened.pairs[: bonds.softened.n]
    add_shared_weights(pairs, share, points.cell_number, points.x, points.volume, quantum, sums)
    halo_for(points.halo, SCALAR).scatter_reverse(sums.reshape(-1, 2, 1, W))
    return sums.reshape(-1, 2 * W)[: points.n_owned].copy()


def _quantum(comm, points: Points) -> float:
    bound = float(largest(comm, np.array([points.volume.max(initial=0.0)]))[0])
    return 2.0 ** (math.frexp(bound)[1] - TERM_BITS)


@dataclass
class Remaining:
    """`family_weights` of the bonds that are left, from row to row: few bonds break in between, and few are summed.

    Attributes
    ----------
    weights : int64, shape (n_owned, 8), or None
        As of the last call.
    """

    weights: np.ndarray | None = None

    def without(self, comm, points: Points, bonds: Bonds, broken: np.ndarray) -> np.ndarray:
        """The weights after the bonds ``broken`` since the last call; at the first those of all bonds. Collective.

        ``broken`` are local points of bonds, int64, shape (n, 2).
        """
        if self.weights is None:
            self.weights = family_weights(comm, points, bonds)
        else:
            self.weights -= family_weights(comm, points, bonds, broken)
        return self.weights


def local_damage(comm, points: Points, bonds: Bonds, intact: np.ndarray, now: np.ndarray | None = None) -> np.ndarray:
    """Local damage of the owned points (eq. 5). Collective.

    Of a bond that has softened counts what is left of its stiffness.

    Parameters
    ----------
    intact : int64, shape (n_owned, 8)
        `family_weights` before any bond was cut or broken: the denominator. Its own point, whose bond would have no
        length, has no part in either sum.
    now : int64, shape (n_owned, 8), optional
        `family_weights` of the bonds in the rows, where they are known.

    Returns
    -------
    float64, shape (n_owned, 8), dimension 1
        0 where all bonds are there, exactly 1 where none is; 0 for a point that never had any.
    """
    now = family_weights(comm, points, bonds) if now is None else now
    if bonds.softened:
        now = now + softened_weights(comm, points, bonds, bonds.softened.share)
    return 1.0 - np.where(intact > 0, now, 1) / np.maximum(intact, 1)


def softened_and_gone(
    comm, points: Points, bonds: Bonds, intact: np.ndarray, now: np.ndarray | None = None
) -> np.ndarray:
    """Weighted shares of a point's bonds that have softened, and that are gone; see `local_damage`. Collective.

    Returns
    -------
    float64, shape (n_owned, 8, 2), dimension 1
    """
    now = family_weights(comm, points, bonds) if now is None else now
    soft = softened_weights(comm, points, bonds, np.ones(bonds.softened.n))
    gone = intact - now - soft
    return np.stack([soft, gone], axis=2) / np.maximum(intact, 1)[:, :, None]
