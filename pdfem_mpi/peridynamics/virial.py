"""Stress, energy density and displacement gradient at the points, from the bonds that they have now.

``sigma_i = 1 / (2 w_i) sum_j f_ij (x) y_ij`` is the virial stress: half of the moment of a point's bonds, over its
volume. The gradient is that of least squares: ``sum_j w_j exp(-r0^2) (eta - H xi)^2`` is smallest. Broken bonds have a
part in neither.
"""

from __future__ import annotations

import numpy as np

from pdfem_mpi.kernels.bond_stresses import GRADIENTS, STRESSES, add_gradients, add_stresses
from pdfem_mpi.peridynamics.bond_forces import BondForces
from pdfem_mpi.peridynamics.bond_sums import sum_terms
from pdfem_mpi.peridynamics.bonds import Bonds
from pdfem_mpi.peridynamics.images import MAGNITUDES, MIXED_PRODUCTS, SCALAR
from pdfem_mpi.peridynamics.points import Points
from pdfem_mpi.peridynamics.softened import in_their_rows

#: A family tells no gradient where ``det M / (tr M / 3)^3`` of its second moments is below this: its points lie nearly
#: in a plane, as those of a fragment may (a full family has 1, one beside a flat crack 0.9).
FLAT = 1e-4


def bond_stresses(
    comm, forces: BondForces, expansion: np.ndarray | None = None, held: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Stress (Kirchhoff's in finite kinematics) and strain-energy density at the owned points. Collective.

    Parameters
    ----------
    forces : BondForces
        At their last evaluation; whatever else than their stretch bonds answer to is theirs to tell.
    expansion : float64, shape (n_clusters * 4,), optional
        Thermal strain of the local points, in linear kinematics.
    held : float64, shape (n_clusters * 4,) or (0,), optional
        What it gives the bonds of a point in common.

    Returns
    -------
    stress : float64, shape (n_owned, 8, 6), dimension force / length^2
        By cell and point; xx, yy, zz, xy, yz, zx.
    energy : float64, shape (n_owned, 8), dimension force / length^2
    """

    points, bonds = forces.points, forces.bonds
    strain = np.empty(0) if expansion is None else expansion
    common, of_points = forces.beyond_stretch(np.empty(0) if held is None else held)
    state = forces.S.reshape(-1), strain, common, bonds.finite

    def add(rows, *numbers):
        add_stresses(*rows.arrays, *state, bonds.weights_of(rows), *numbers)

    with in_their_rows(bonds, softened_still=True):
        sums, quanta = sum_terms(comm, points, bonds, add, STRESSES, MAGNITUDES + MIXED_PRODUCTS + SCALAR)
    half = 0.5 / points.volume[: 8 * points.n_owned].reshape(-1, 8)
    energy = sums[..., 6] * quanta[1] * half + of_points
    return sums[..., :6] * quanta[0] * half[..., None], energy


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
    with in_their_rows(bonds, softened_still=True):
        sums, quanta = sum_terms(comm, points, bonds, add, GRADIENTS, parity)
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
    tells = determinant > FLAT * (mean * mean * mean)
    inverse = adjugate / np.where(tells, determinant, np.nan)[..., None, None]
    result = np.zeros_like(change)
    for k in range(3):  # written out: a product of batches may round otherwise in another batch
        result += change[..., :, k, None] * inverse[..., None, k, :]
    return result
