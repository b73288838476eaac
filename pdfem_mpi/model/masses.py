"""Fictitious masses of the unknowns (eqs 11, 22), for relaxation with a time step of 1."""

from __future__ import annotations

import numpy as np

from pdfem_mpi.finite_elements.nodes import assemble
from pdfem_mpi.kernels.hex8 import SHAPE_AT_GAUSS
from pdfem_mpi.kernels.simd import W
from pdfem_mpi.peridynamics.bonds import fictitious_masses
from pdfem_mpi.peridynamics.stable_masses import stable_densities


def make_masses(comm, points, bonds, nodes, elements, overlap, stable) -> tuple[np.ndarray, int]:
    """Fictitious masses of the unknowns, and how many points have more than eq. (11) gives them. Collective.

    A node of the overlap carries the lumped densities of its points, ``sum_p N_I(x_p) lambda_p w_p``: by Gershgorin
    this bounds the stiffness N^T K N that it feels, as (22) does for the elements that have an internal force.

    Parameters
    ----------
    points, bonds, nodes, elements, overlap : or None
        Parts of a `Model`.
    stable : bool
        With the densities of `stable_densities`; where nothing relaxes they are left out, and so is their time.
    """
    parts, raised = [], 0
    if points:
        densities = fictitious_masses(comm, points, bonds)
        if stable:
            found = stable_densities(comm, points, bonds, densities)
            densities, raised = found.values, found.raised
        parts.append(np.repeat(densities.reshape(-1, 1, W)[: 2 * points.n_free], 3, axis=1).reshape(-1))
    if nodes:
        contributions = list(elements.masses()) if elements else []
        if overlap:
            lumped = _lumped(densities.reshape(-1, 8)[points.n_free : points.n_owned])
            contributions.append((overlap.connectivity, np.repeat(lumped[:, :, None], 3, axis=2)))
        parts.append(assemble(comm, nodes, lambda: contributions, 3).reshape(-1))
    return np.concatenate(parts), raised


def _lumped(density: np.ndarray) -> np.ndarray:
    """What the densities of the points of cells give to the cells' nodes, both float64, shape (n_cells, 8)."""
    lumped = np.zeros((len(density), 8))
    for p in range(8):
        lumped += SHAPE_AT_GAUSS[p] * density[:, p, None]
    return lumped
