"""Diagonal blocks of the stiffness that the bonds give their points, without those that broke."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pdfem_mpi.kernels.bond_failure import add_broken_blocks
from pdfem_mpi.kernels.multigrid import add_point_blocks
from pdfem_mpi.peridynamics.bonds import Bonds
from pdfem_mpi.peridynamics.failure import Broken
from pdfem_mpi.peridynamics.images import MAGNITUDES, MIXED_PRODUCTS, halo_for
from pdfem_mpi.peridynamics.points import Points, sums_table


@dataclass
class PointBlocks:
    """Blocks of the owned points, overlap included, as exact integer sums over their surviving bonds.

    Attributes
    ----------
    sums : int64, shape (n_owned_clusters, 6, 4)
        By cluster, entry and lane, in quanta.
    quantum, pattern : float
    """

    sums: np.ndarray
    quantum: float
    pattern: float

    def values(self, points: np.ndarray | slice = slice(None)) -> np.ndarray:
        """Blocks of the chosen points, shape (n, 6), dimension force / length."""
        return self.sums.swapaxes(1, 2).reshape(-1, 6)[points] * self.quantum

    def take_out(self, points: Points, bonds: Bonds, broken: Broken) -> np.ndarray:
        """Subtract the stiffness of broken bonds; the owned points that lost some, int64. Collective."""
        lost = np.zeros((points.n_clusters, 6, 4), np.int64)
        add_broken_blocks(broken.pairs, broken.strengths, points.x, bonds.finite, self.pattern, lost.reshape(-1))
        halo_for(points.halo, MAGNITUDES + MIXED_PRODUCTS).scatter_reverse(lost.reshape(-1, 2, 6, 4))
        lost = lost[: len(self.sums)]
        self.sums -= lost
        return np.flatnonzero(lost.any(axis=1).reshape(-1))


def point_blocks(points: Points, bonds: Bonds) -> PointBlocks:
    """Sum up the blocks of the owned points. Collective."""
    T, _ = sums_table(points)
    halves = []
    for mixed in (False, True):
        parity = MIXED_PRODUCTS if mixed else MAGNITUDES
        sums, quantum, pattern = bonds.sum_over(add_point_blocks, T, 2.0 * bonds.stiffest, points, parity, mixed)
        halves.append(sums.copy())
    return PointBlocks(np.concatenate(halves, axis=1), quantum, pattern)
