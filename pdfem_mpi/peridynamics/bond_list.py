"""Bonds one by one, as arrays: for whoever looks at single bonds; no sweep needs this list."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pdfem_mpi.kernels.simd import W
from pdfem_mpi.peridynamics.bonds import Bonds
from pdfem_mpi.peridynamics.clusters import point_rows
from pdfem_mpi.peridynamics.points import Points


@dataclass(frozen=True)
class BondList:
    """Intact bonds that a rank computes, in the order of their points; none that has broken or softened.

    Attributes
    ----------
    points : int64, shape (n, 2)
        Ids of the two points, the lower first: ``8 cell + g`` with the number of the cell in the mesh. The cell of a
        mirror image has the number of its cell plus the number of all cells times that of the reflection.
    start, vector : float64, shape (n, 3), dimension length
        Reference position of the first point, and from there to the second.
    stiffness : float64, shape (n,), dimension force length
        A bond of stretch s holds the energy ``stiffness s^2 / 2``. What a Poisson's ratio other than 1/4 adds at the
        points is not in it.
    stretch : float64, shape (n,), dimension 1
        At the displacements of the last evaluation.
    """

    points: np.ndarray
    start: np.ndarray
    vector: np.ndarray
    stiffness: np.ndarray
    stretch: np.ndarray

    @property
    def length(self) -> np.ndarray:
        """Reference lengths, shape (n,)."""
        return np.sqrt((self.vector**2).sum(axis=1))


def list_bonds(points: Points, bonds: Bonds, S: np.ndarray) -> BondList:
    """List the intact bonds of this rank.

    Parameters
    ----------
    S : float64, shape (n_clusters, 9, 4), dimension length
        The table of the points at the last evaluation, whose rows 0-2 are displacements.
    """
    ends, strengths = zip(*(_ends(rows, bonds.finite) for rows in bonds.rows), strict=True)
    ends, strengths = np.concatenate(ends), np.concatenate(strengths)
    ids = 8 * points.cell_key[ends // 8] + ends % 8
    swapped = ids[:, 0] > ids[:, 1]
    ends[swapped], ids[swapped] = ends[swapped, ::-1], ids[swapped, ::-1]
    order = np.lexsort(ids.T[::-1])
    ends, strengths = ends[order], strengths[order]
    x, u = point_rows(points.x), point_rows(np.ascontiguousarray(S[:, 0:3]).reshape(-1))
    vector, change = np.diff(x[ends], axis=1)[:, 0], np.diff(u[ends], axis=1)[:, 0]
    square = (vector**2).sum(axis=1)
    stretch = (vector * change).sum(axis=1) / square
    if bonds.finite:
        e = 2.0 * stretch + (change**2).sum(axis=1) / square  # (r / r0)^2 - 1
        stretch = e / (1.0 + np.sqrt(np.maximum(1.0 + e, 0.0)))
    stiffness = 2.0 * strengths * square if bonds.finite else strengths * square**2
    return BondList(ids[order], x[ends[:, 0]], vector, stiffness, stretch)


def _ends(rows, finite: bool) -> tuple[np.ndarray, np.ndarray]:
    """Local points of the bonds of some rows, int64 (n, 2), and their stored strengths, float64 (n,)."""
    stored = rows.data.reshape(-1, 2 * W if finite else W)[:, :W]
    row, lane = np.nonzero(stored)
    first = np.searchsorted(rows.start, row, side="right") - 1
    second = W * (rows.offset[row].astype(np.int64) // (9 * W)) + lane
    return np.column_stack([first, second]), stored[row, lane].astype(float)
