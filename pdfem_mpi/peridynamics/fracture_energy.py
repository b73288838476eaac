"""The fracture energy that the bonds of a body have: what a plane through it cuts, and not what the bulk has.

Bonds end at surfaces, so that thin bodies have less than the bulk's ``G_c``; surface corrections give some of it back.
"""

from __future__ import annotations

import numpy as np

from pdfem_mpi.body.share import Share
from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.kernels.hex8 import gauss_volumes
from pdfem_mpi.kernels.plane_crossings import NO_LABEL, add_crossings
from pdfem_mpi.parallel.comm import sum_integers
from pdfem_mpi.peridynamics.bonds import Bonds, total_bonds
from pdfem_mpi.peridynamics.points import Points


def energy_of_own_bonds(comm, scene: Scene, share: Share, points: Points, bonds: Bonds) -> np.ndarray:
    """Energy at unit stretch of the bonds that a plane cuts, per area, mean over the places of the plane. Collective.

    Of the cells of each material that may fail and do not follow element nodes; bonds to other cells count by a half.

    Returns
    -------
    float64, shape (n_materials, 3), dimension force / length
        For planes normal to x, y, z; NaN for materials without such cells. Times the square of the critical stretch it
        is a fracture energy.
    """
    may = np.array([region.may_fail is not False for region in scene.regions])[share.region]
    counts = share.is_peridynamic & ~share.is_overlap & may
    if share.found:
        counts &= share.found.is_turned
    n = len(share.materials.names)
    label = np.where(counts, share.material, NO_LABEL).astype(np.uint8)
    sums = np.zeros((n, 3), np.int64)
    # two halves of energy times length of the strongest and longest bond, for all of them
    most = 0.5 * bonds.strongest * bonds.cutoff**2 * max(total_bonds(comm, bonds), 1)
    quantum = most * 2.0**-61
    labels = np.repeat(label[share.subdomain.point_cells], 2)
    for rows in bonds.rows:
        add_crossings(*rows.arrays, points.x, labels, bonds.finite, quantum, sums)
    chosen = np.flatnonzero(counts & share.is_owned)
    volumes = gauss_volumes(share.nodes[share.mesh.cells[chosen]]).sum(axis=1)
    material = share.material[chosen]
    volume = share.exact_sums(np.where(material == k, volumes, 0.0) for k in range(n))
    with np.errstate(invalid="ignore"):
        return sum_integers(comm, sums.reshape(-1)).reshape(n, 3) * quantum / volume[:, None]
