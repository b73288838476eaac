"""Stress, energy density and displacement gradient at the points, from the bonds that they have now.

``sigma_i = 1 / (2 w_i) sum_j f_ij (x) y_ij`` is the virial stress: half of the moment of a point's bonds, over its
volume. The gradient is that of least squares: ``sum_j w_j exp(-r0^2) (eta - H xi)^2`` is smallest. Broken bonds have a
part in neither.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from pdfem_mpi.kernels.bond_stresses import GRADIENTS, STRESSES, add_gradients, add_stresses
from pdfem_mpi.kernels.simd import W
from pdfem_mpi.parallel.comm import largest
from pdfem_mpi.peridynamics.bonds import Bonds
from pdfem_mpi.peridynamics.images import MAGNITUDES, MIXED_PRODUCTS, SCALAR, Parity, halo_for
from pdfem_mpi.peridynamics.points import Points

#: Bits of a term: a point may have ``2**(62 - TERM_BITS)`` bonds, and a sum is exact to 1e-13 of its largest term.
TERM_BITS = 46
#: A family tells no gradient where ``det M / (tr M / 3)^3`` of its second moments is below this: its points lie nearly
#: in a plane, as those of a fragment may (a full family has 1, one beside a flat crack 0.9).
FLAT = 1e-4


def bond_stresses(comm, points: Points, bonds: Bonds, table: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Stress (Kirchhoff's in finite kinematics) and strain-energy density at the owned points. Collective.

    Parameters
    ----------
    table : float64, shape (n_clusters, 9, 4)
        Of the forces' last evaluation, `BondForces.S`.

    Returns
    -------
    stress : float64, shape (n_owned, 8, 6), dimension force / length^2
        By cell and point; xx, yy, zz, xy, yz, zx.
    energy : float64, shape (n_owned, 8), dimension force / length^2
    """

    def add(rows, *numbers):
        add_stresses(*rows.arrays, table.reshape(-1), bonds.finite, *numbers)

    sums, quanta = _sum_up(comm, points, bonds, add, STRESSES, MAGNITUDES + MIXED_PRODUCTS + SCALAR)
    half = 0.5 / points.volume[: 8 * points.n_owned].reshape(-1, 8)
    return sums[..., :6] * quanta[0] * half[..., None], sums[..., 6] * quanta[1] * half


def displacement_gradients(comm, points: Points, bonds: Bonds, table: np.ndarray) -> np.ndarray:
    """``du_a / dx_b`` at the owned points by least squares over their families. Collective.

    Returns
    -------
    float64, shape (n_owned, 8, 3, 3), dimension 1
        NaN at points whose families lie in a plane or are gone.
    """

    def add(rows, *numbers):
        places = points.x, points.volume, points.cell_number
        add_gradients(*rows.arrays, table.reshape(-1), *places, bonds.finite, *numbers)

    parity = MAGNITUDES + MIXED_PRODUCTS + MIXED_PRODUCTS + MAGNITUDES + MIXED_PRODUCTS
    sums, quanta = _sum_up(comm, points, bonds, add, GRADIENTS, parity)
    xx, yy, zz, xy, yz, zx = range(6)
    moment = (sums * quanta[1])[..., 9:][..., [xx, xy, zx, xy, yy, yz, zx, yz, zz]].reshape(*sums.shape[:2], 3, 3)
    change = (sums * quanta[0])[..., [0, 3, 8, 6, 1, 4, 5, 7, 2]].reshape(moment.shape)
    return solve_families(change, moment)


def solve_families(change: np.ndarray, moment: np.ndarray) -> np.ndarray:
    """``change moment^-1`` for symmetric matrices, shape (..., 3, 3); NaN where a moment is that of a plane."""
    a, b, c = np.moveaxis(moment, -2, 0)
    adjugate = np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)], axis=-1)
    determinant = a[..., 0] * adjugate[..., 0, 0] + a[..., 1] * adjugate[..., 1, 0] + a[..., 2] * adjugate[..., 2, 0]
    mean = (moment[..., 0, 0] + moment[..., 1, 1] + moment[..., 2, 2]) / 3.0
    tells = determinant > FLAT * mean**3
    inverse = adjugate / np.where(tells, determinant, np.nan)[..., None, None]
    result = np.zeros_like(change)
    for k in range(3):  # written out: a product of batches may round otherwise in another batch
        result += change[..., :, k, None] * inverse[..., None, k, :]
    return result


def _sum_up(
    comm, points: Points, bonds: Bonds, add: Callable, width: int, parity: Parity
) -> tuple[np.ndarray, np.ndarray]:
    """Sum the terms of all bonds at the owned points, the same bits on any ranks. Collective.

    Parameters
    ----------
    add : callable
        ``add(rows, quanta, sums, top)``.
    width : int
        Sums at a point.

    Returns
    -------
    sums : int64, shape (n_owned, 8, width)
    quanta : float64, shape (2,)
    """
    top, none = np.zeros(2), np.zeros(0, np.int64)
    for rows in bonds.rows:
        add(rows, np.zeros(2), none, top)
    top = largest(comm, top)
    quanta = np.array([2.0 ** (math.frexp(size)[1] - TERM_BITS) if size > 0.0 else 1.0 for size in top.tolist()])
    sums = np.zeros(points.n_clusters * width * W, np.int64)
    for rows in bonds.rows:
        add(rows, quanta, sums, top)
    cells = sums.reshape(-1, 2, width, W)
    halo_for(points.halo, parity).scatter_reverse(cells)
    return cells[: points.n_owned].swapaxes(2, 3).reshape(-1, 8, width), quanta
