"""What a thermal strain that is held adds to the loads on the nodes of elements."""

from __future__ import annotations

import numpy as np

from pdfem_mpi.kernels.element_tables import lame_moduli
from pdfem_mpi.kernels.hex8 import gauss_gradients

#: Elements that are worked on together: their gradients take 1.5 kB each.
BATCH = 4096


def element_forces(
    corners: np.ndarray, youngs_modulus: np.ndarray, poissons_ratio: np.ndarray, strain: np.ndarray
) -> np.ndarray:
    """``sum_g w_g (3 lam + 2 mu) alpha dT grad N_a`` of each node, float64, shape (n, 8, 3), dimension force.

    Parameters
    ----------
    corners : float64, shape (n, 8, 3), dimension length
    youngs_modulus, poissons_ratio : float64, shape (n,)
    strain : float64, shape (n, 8), dimension 1
        ``alpha dT`` at the Gauss points.
    """
    lam, mu = lame_moduli(youngs_modulus, poissons_ratio)
    forces = np.zeros((len(corners), 8, 3))
    for start in range(0, len(corners), BATCH):
        batch = slice(start, start + BATCH)
        gradients, volumes = gauss_gradients(corners[batch])
        pressure = volumes * (3.0 * lam[batch] + 2.0 * mu[batch])[:, None] * strain[batch]
        for g in range(8):
            forces[batch] += pressure[:, g, None, None] * gradients[:, g]
    return forces
