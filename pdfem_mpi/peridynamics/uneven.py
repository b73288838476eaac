"""Where a surface correction that did not converge leaves the response furthest from that inside of a body."""

from __future__ import annotations

import numpy as np

from pdfem_mpi.body.materials import MaterialTable
from pdfem_mpi.kernels import correction_sweeps
from pdfem_mpi.kernels.simd import W
from pdfem_mpi.peridynamics.bonds import BULK_MODULUS, Bonds
from pdfem_mpi.peridynamics.images import MAGNITUDES
from pdfem_mpi.peridynamics.points import Points, sums_table

#: ``|G / g_inf - 1|`` above which a correction counts as not converged. Bodies of cubes and graded cells stay below
#: 0.2, those of the decks in jobs/ below 0.11; distorted cells of thin bodies and of several materials reach 0.3 to 6.
CONVERGED = 0.25


def most_uneven_point(comm, points: Points, materials: MaterialTable, bonds: Bonds, virial: bool) -> np.ndarray:
    """The point whose response, or virial stress, differs most from that inside of a body. Collective.

    Parameters
    ----------
    bonds : Bonds
        With their corrections, whole: before cracks.
    virial : bool
        The measure of the correction.

    Returns
    -------
    float64, shape (3,), dimension length
        The same on any number of ranks.
    """
    T, integers = sums_table(points)
    T[:, 0:3] = 1.0  # the stored bonds have their factors
    bound = bonds.strongest * (max(1.0, 0.5 * bonds.cutoff) if virial else 1.0)
    _, quantum, _ = bonds.sum_over(correction_sweeps.add_responses, T, bound, points, MAGNITUDES, virial)
    owned = 2 * points.n_owned
    response = quantum * integers.reshape(-1, 9, W)[:owned, 6:9] / points.volume.reshape(-1, 1, W)[:owned]
    infinite = 1.0 if virial else correction_sweeps.INFINITE_RESPONSE * BULK_MODULUS
    target = np.repeat(infinite * materials.own_bond_modulus[points.material[: points.n_owned]], 2)
    off = np.abs(response / target[:, None, None] - 1.0).max(axis=1).reshape(-1)
    found = None
    if off.size:
        ids = 8 * points.cell_number[: points.n_owned, None] + np.arange(8)
        own = np.lexsort((ids.reshape(-1), -off))[0]  # of mirror twins the one with the lowest id
        found = -off[own], ids.flat[own], points.x.reshape(-1, 3, W)[own // W, :, own % W].tolist()
    return np.array(min(each for each in comm.allgather(found) if each)[-1])
