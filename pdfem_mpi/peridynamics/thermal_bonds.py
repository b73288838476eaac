"""Forces of bonds that a change of temperature would lengthen, and that are held at their length."""

from __future__ import annotations

import numpy as np

from pdfem_mpi.kernels.bond_stresses import add_thermal_forces
from pdfem_mpi.peridynamics.bond_sums import sum_terms
from pdfem_mpi.peridynamics.bonds import Bonds
from pdfem_mpi.peridynamics.images import VECTOR
from pdfem_mpi.peridynamics.points import Points


def thermal_bond_forces(comm, points: Points, bonds: Bonds, expansion: np.ndarray) -> np.ndarray:
    """Forces on the owned points in linear kinematics, float64, shape (n_owned, 8, 3), by cell and point. Collective.

    Parameters
    ----------
    expansion : float64, shape (n_clusters * 4,), dimension 1
        Thermal strain of the local points.
    """

    def add(rows, *numbers):
        add_thermal_forces(*rows.arrays, points.x, expansion, *numbers)

    sums, quanta = sum_terms(comm, points, bonds, add, 3, VECTOR)
    return sums * quanta[0]
