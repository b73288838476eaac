"""The bonds of a rank: what is summed over them, and how many there are."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from pdfem_mpi.kernels.bond_densities import add_densities
from pdfem_mpi.kernels.rounding import start_sums
from pdfem_mpi.kernels.simd import W
from pdfem_mpi.kernels.union_find import join_bonds
from pdfem_mpi.parallel.comm import sum_integers
from pdfem_mpi.peridynamics.images import MAGNITUDES, Parity, halo_for
from pdfem_mpi.peridynamics.points import Points, sums_table
from pdfem_mpi.peridynamics.rows import Rows
from pdfem_mpi.peridynamics.softened import SoftenedBonds
from pdfem_mpi.peridynamics.volumetric import Volumetric, stiffening

#: Response constant ``c = 9 k / (pi l^4)`` (eq. 2) per Young's modulus in model units, where
#: ``k = E / (3 (1 - 2 nu)) = 2/3``.
BULK_MODULUS = 2.0 / 3.0
RESPONSE_CONSTANT = 9.0 * BULK_MODULUS / math.pi


@dataclass(frozen=True)
class Bonds:
    """Bonds this rank computes, each bond of the body on exactly one rank.

    Attributes
    ----------
    interior, boundary : Rows
        Rows against owned clusters, and against clusters of ghosts and images.
    finite : bool
        Finite (else linear) kinematics: eight (else four) stored numbers a row.
    cutoff : float, dimension length
        Guarded cutoff radius: no bond is longer.
    rows_of_point : int32, shape (n_clusters * 4,)
    rows_at_cluster : int32, shape (n_clusters,)
        Rows against others that a point has, and rows of others against a cluster.
    by_material : int64, shape (n_materials, n_materials)
        Bonds on this rank, from the material of the row's point to that of its cluster.
    strongest : float, dimension force
        Largest force of a bond per unit stretch, on all ranks.
    stiffest : float, dimension force / length
        Largest half of that over the bond's length, on all ranks.
    volumetric : Volumetric or None
        What Poisson's ratio asks for beside the bonds; None where it is 1/4.
    softened : SoftenedBonds or None
        Bonds that left the rows and are not gone; None where none can soften.
    """

    interior: Rows
    boundary: Rows
    finite: bool
    cutoff: float
    rows_of_point: np.ndarray
    rows_at_cluster: np.ndarray
    by_material: np.ndarray
    strongest: float
    stiffest: float
    volumetric: Volumetric | None = None
    softened: SoftenedBonds | None = None

    @property
    def added(self) -> np.ndarray:
        """How often a point's sum receives a term through its own rows; int64, shape (n_clusters * 4,)."""
        return W * self.rows_of_point.astype(np.int64)

    @property
    def taken(self) -> np.ndarray:
        """How often a point's sum receives a term through rows at its cluster; int64, shape (n_clusters * 4,)."""
        return np.repeat(self.rows_at_cluster.astype(np.int64), W)

    @property
    def count(self) -> int:
        """Bonds on this rank."""
        return int(self.by_material.sum())

    @property
    def rows(self) -> tuple[Rows, Rows]:
        """Interior and boundary rows."""
        return self.interior, self.boundary

    @property
    def most_slots(self) -> int:
        """Slots for bonds of the point that has most, in one kind of rows on this rank."""
        return W * max(int(np.diff(rows.start).max(initial=0)) for rows in self.rows)

    def sum_over(self, kernel: Callable, T: np.ndarray, bound: float, points: Points, parity: Parity, *options):
        """Sum three terms of every bond at both of its points, in any order to the same bits. Collective.

        Parameters
        ----------
        kernel : callable
            Takes rows, table, its view as integers, pattern, kinematics and the options; see `kernels.bond_densities`.
        T : float64, shape (n_clusters, 9, 4)
            From `sums_table`; rows 6-8 are overwritten.
        bound : float
            Of a term.
        parity : Parity
            Of the three sums at mirror planes.

        Returns
        -------
        sums : int64, shape (2 n_owned, 3, 4)
            View of the table, of the owned points.
        quantum, pattern : float
        """
        integers = T.view(np.int64)
        quantum, pattern = start_sums(T, self.added + self.taken, bound)
        for rows in self.rows:
            kernel(*rows.arrays, T.reshape(-1), integers.reshape(-1), pattern, self.finite, *options)
        halo_for(points.halo, parity).scatter_reverse(integers.reshape(-1, 2, 9, W)[:, :, 6:9])
        return integers[: 2 * points.n_owned, 6:9], quantum, pattern

    def join(self, parent: np.ndarray, bonded: np.ndarray) -> None:
        """Join the points of every bond in a forest, int64 (n_points,), and count the bonds of each point."""
        for rows in self.rows:
            join_bonds(*rows.arrays, self._stride, parent, bonded)
        if self.softened:
            self.softened.join(parent, bonded)

    def planes_crossed(self, points: Points) -> np.ndarray:
        """How many bonds of each owned point cross a mirror plane normal to x, y, z. Collective.

        Returns
        -------
        int64, shape (n_owned * 8, 3)
        """
        return planes_crossed(self, points)

    def storage(self) -> dict[str, tuple[np.ndarray, ...]]:
        """The arrays that hold the bonds: which there are, and their stored numbers."""
        return {
            "bond_rows": tuple(array for rows in self.rows for array in (rows.start, rows.offset)),
            "bond_strengths": tuple(rows.data for rows in self.rows),
        }

    @property
    def share_of_lengths(self) -> float:
        """Part of the stored numbers that are lengths; the others are strengths."""
        return 0.5 if self.finite else 0.0

    def weights_of(self, rows: Rows) -> np.ndarray:
        """Fitted weights of the slots of interior or boundary rows in dilatations; empty where all are 1."""
        part = self.volumetric
        return part.weights[int(rows is self.boundary)] if part else np.empty(0, np.float32)

    @property
    def _stride(self) -> int:
        """Stored numbers of a row."""
        return 2 * W if self.finite else W


def fictitious_masses(comm, points: Points, bonds: Bonds) -> np.ndarray:
    """``lambda_i w_i`` of the owned points (eq. 11 with g_ij), for a time step of 1. Collective.

    Returns
    -------
    float64, shape (n_owned * 8,), dimension force / length
        By cluster and lane.
    """
    T, _ = sums_table(points)
    h, growth = stiffening(comm, points, bonds)
    bound = bonds.stiffest * (1.0 + growth)
    sums, quantum, _ = bonds.sum_over(add_densities, T, bound, points, MAGNITUDES, h)
    return np.ascontiguousarray((sums * quantum).max(axis=1)).reshape(-1)


def count_by_material(comm, bonds: Bonds) -> np.ndarray:
    """Undirected bonds of the whole body between materials a and b, symmetric. Collective.

    Returns
    -------
    int64, shape (n_materials, n_materials)
    """
    counts = sum_integers(comm, bonds.by_material)
    return counts + counts.T - np.diag(np.diag(counts))


def total_bonds(comm, bonds: Bonds | None) -> int:
    """Undirected bonds of the whole body. Collective."""
    return int(sum_integers(comm, np.array([bonds.count if bonds else 0]))[0])


def planes_crossed(bonds: Bonds, points: Points) -> np.ndarray:
    """`Bonds.planes_crossed`. Collective."""
    images, n_real = points.images, len(points.cell_number) - len(points.images.source)
    table = np.zeros((len(points.cell_number), 2, 3, W), np.int64)
    for i, j in _to_images(bonds, n_real):
        axes = ((images.sign < 0.0) | (images.shift != 0.0))[j // (2 * W) - n_real]
        for point in (i, j):
            cluster = point // W
            np.add.at(table, (cluster // 2, cluster % 2, slice(None), point % W), axes)
    halo_for(points.halo, MAGNITUDES).scatter_reverse(table)
    return table[: points.n_owned].swapaxes(2, 3).reshape(-1, 3)


def _to_images(bonds: Bonds, n_real: int):
    """Local points of the bonds to images, whose cells begin at ``n_real``: those in the rows, and softened ones."""
    rows = bonds.boundary
    cluster = rows.offset[:-1].astype(np.int64) // (9 * W)
    row = np.flatnonzero(cluster // 2 >= n_real)
    slot, lane = np.nonzero(rows.data.reshape(-1, bonds._stride)[row, :W])
    row = row[slot]
    yield np.searchsorted(rows.start, row, side="right") - 1, W * cluster[row] + lane
    if bonds.softened:
        pairs = bonds.softened.pairs[: bonds.softened.n]
        yield pairs[pairs[:, 1] // (2 * W) >= n_real].T
