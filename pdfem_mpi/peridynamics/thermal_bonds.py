"""Forces of bonds that a change of temperature would lengthen, and that are held at their length."""

from __future__ import annotations

import numpy as np

from pdfem_mpi.kernels.bond_stresses import add_thermal_dilatations, add_thermal_forces
from pdfem_mpi.kernels.simd import W
from pdfem_mpi.peridynamics.bond_sums import sum_terms
from pdfem_mpi.peridynamics.bonds import Bonds
from pdfem_mpi.peridynamics.images import SCALAR, VECTOR, halo_for
from pdfem_mpi.peridynamics.points import Points


def thermal_dilatations(comm, points: Points, bonds: Bonds, expansion: np.ndarray) -> np.ndarray:
    """``q`` of a thermal strain at all local points (see `volumetric_forces`), float64, shape (n_clusters * 4,).

    Empty for bonds without a volumetric part. Collective.

    Parameters
    ----------
    expansion : float64, shape (n_clusters * 4,), dimension 1
        Thermal strain of the local points.
    """
    law = bonds.volumetric
    if law is None:
        return np.empty(0)

    def add(rows, *numbers):
        add_thermal_dilatations(*rows.arrays, points.x, expansion, bonds.weights_of(rows), *numbers)

    sums, quanta = sum_terms(comm, points, bonds, add, 1, SCALAR)
    own = 8 * points.n_owned
    factor = np.repeat(law.factor[law.material[: 2 * points.n_owned]], W)
    q = np.zeros(points.n_clusters * W)
    q[:own] = factor * (sums.reshape(-1) * quanta[0]) / points.volume[:own]
    halo_for(points.halo, SCALAR).scatter_forward(q.reshape(-1, 2, 1, W))
    return q


def thermal_bond_forces(comm, points: Points, bonds: Bonds, expansion: np.ndarray, common: np.ndarray) -> np.ndarray:
    """Forces on the owned points in linear kinematics, float64, shape (n_owned, 8, 3), by cell and point. Collective.

    Parameters
    ----------
    expansion : float64, shape (n_clusters * 4,), dimension 1
        Thermal strain of the local points.
    common : float64, shape (n_clusters * 4,) or (0,)
        Of `thermal_dilatations`.
    """

    def add(rows, *numbers):
        add_thermal_forces(*rows.arrays, points.x, expansion, common, bonds.weights_of(rows), *numbers)

    sums, quanta = sum_terms(comm, points, bonds, add, 3, VECTOR)
    return sums * quanta[0]
