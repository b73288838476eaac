"""Surface correction: the vectors of appendix A, or those that make the virial stress that of an infinite body."""

from __future__ import annotations

import numpy as np

from pdfem_mpi.body.materials import MaterialTable
from pdfem_mpi.kernels import correction_sweeps
from pdfem_mpi.kernels.simd import W
from pdfem_mpi.parallel.comm import largest
from pdfem_mpi.peridynamics.bonds import BULK_MODULUS, Bonds
from pdfem_mpi.peridynamics.images import MAGNITUDES, halo_for
from pdfem_mpi.peridynamics.points import Points, sums_table


def appendix_a(
    comm, points: Points, materials: MaterialTable, bonds: Bonds, virial: bool = False
) -> tuple[np.ndarray, float]:
    """Iterate the correction vectors towards the response, or the virial stress, of an infinite body.

    Returns
    -------
    factor : float64, shape (n_clusters * 12,)
        Cluster layout, ghosts included.
    remaining : float
        Largest ``|G / g_inf - 1|`` before the last update, on all ranks.
    """
    T, integers = sums_table(points)
    T[:, 0:3] = 1.0
    blocks = T.reshape(-1, 2, 9, W)
    # of Young's modulus 1
    infinite_response = 1.0 if virial else correction_sweeps.INFINITE_RESPONSE * BULK_MODULUS
    target = np.repeat(infinite_response * materials.own_bond_modulus[points.material[: points.n_owned]], 2)
    halo = halo_for(points.halo, MAGNITUDES)
    remaining = 0.0
    longest = max(1.0, 0.5 * bonds.cutoff) if virial else 1.0
    for _ in range(correction_sweeps.SWEEPS):
        widest = float(largest(comm, np.array([T[:, 0:3].max(initial=0.0)]))[0])
        bound = bonds.strongest * widest * longest
        _, quantum, _ = bonds.sum_over(correction_sweeps.add_responses, T, bound, points, MAGNITUDES, virial)
        worst = correction_sweeps.update_factors(
            2 * points.n_owned, T.reshape(-1), integers, points.volume, quantum, target
        )
        remaining = float(largest(comm, np.array([worst]))[0])
        halo.scatter_forward(blocks[:, :, 0:3])
    return np.ascontiguousarray(T[:, 0:3]).reshape(-1), remaining
