"""How far finite elements have turned: they are linear (eq. 15), and a rotation strains them by 1 - cos."""

from __future__ import annotations

import math

import numpy as np

from pdfem_mpi.body.discretization import Discretization
from pdfem_mpi.kernels.hex8 import shape_gradients

#: Rotations from here on are told: 5 degrees strain an element by 0.4 %.
TOLD = math.radians(5.0)


def largest_rotation(discretization: Discretization, u_nodes: np.ndarray) -> float:
    """Largest rotation of an element about its middle, in radians, from the skew part of its deformation gradient.

    Parameters
    ----------
    discretization : Discretization
    u_nodes : float64, shape (n_nodes, 3), dimension length
        Displacements of the nodes that carry unknowns, in the deck's units.

    Returns
    -------
    float
        That of a rigid rotation exactly; 0 without elements.
    """
    mesh, cells = discretization.mesh, np.flatnonzero(discretization.has_stiffness)
    if not len(cells):
        return 0.0
    by_place = shape_gradients(np.zeros((1, 3)))[0]
    corners, u = mesh.nodes[mesh.cells[cells]], u_nodes[discretization.node_number[mesh.cells[cells]]]
    jacobian = (corners[:, :, :, None] * by_place[None, :, None, :]).sum(axis=1)  # d x_d / d r_k
    along = (u[:, :, :, None] * by_place[None, :, None, :]).sum(axis=1)  # d u_d / d r_k
    place = along @ np.linalg.inv(jacobian) + np.eye(3)  # deformation gradient
    pairs = (((d + 2) % 3, (d + 1) % 3) for d in range(3))
    skew = 0.5 * np.stack([place[:, a, b] - place[:, b, a] for a, b in pairs], axis=1)
    stretch = 0.5 * (np.trace(place, axis1=1, axis2=2) - 1.0)
    angle = np.arctan2(np.sqrt((skew**2).sum(axis=1)), stretch)
    return float(angle.max())


def describe_rotation(angle: float) -> str:
    """A warning about elements that turned by ``angle`` radians."""
    return (
        f"warning: finite elements have turned by up to {math.degrees(angle):.3g} degrees. They are linear (eq. 15), "
        f"and such a rotation strains them by {100.0 * (1.0 - math.cos(angle)):.2g} %: describe what turns by "
        "peridynamics, or load less."
    )
