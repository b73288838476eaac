"""Overlap of the two descriptions: displacements of its points (25) and the lumped force (26).

Differences to node 0 of the cell are interpolated, and node 0 gets what the seven other nodes leave of a
force: a translation of the nodes is the same translation of all points, and no force is lost.
"""

import numpy as np
from numba import njit, types

from pdfem_mpi.kernels.hex8 import SHAPE_AT_GAUSS


@njit(cache=True, nogil=True, boundscheck=False, error_model="numpy")
def interpolate(points, first_cell, connectivity, u_nodes):
    """Set the displacements of the overlap points, ``u_p = sum_I N_I(x_p) u_I`` (25).

    Parameters
    ----------
    points : float64, shape (2 n_cells, 9, 4), rows 0-2 of dimension length
        The points' table, two clusters of four a cell; rows 0-2 of the overlap cells are overwritten.
    first_cell : int
        First overlap cell; the others follow.
    connectivity : int32, shape (n_overlap, 8)
        Local nodes of the overlap cells, in range and not negative.
    u_nodes : float64, shape (n_nodes, 3), dimension length
        Displacements; ghost rows up to date (``scatter_forward``).
    """
    for cell in range(len(connectivity)):
        n0 = np.uint64(connectivity[cell, 0])
        for p in range(8):
            cluster = 2 * (first_cell + cell) + p // 4
            for c in range(3):
                u = 0.0
                for a in range(1, 8):
                    n = np.uint64(connectivity[cell, a])
                    u += SHAPE_AT_GAUSS[p, a] * (u_nodes[n, c] - u_nodes[n0, c])
                points[cluster, c, p % 4] = u_nodes[n0, c] + u


@njit(cache=True, nogil=True, boundscheck=False, error_model="numpy")
def lump(force_nodes, points, first_cell, connectivity, ratio):
    """Add the peridynamic forces of the overlap to its nodes, ``f_I = sum_p N_I(x_p) F_p`` (26).

    The paper's ``rho g`` is read as the peridynamic force density, and ``F_p`` is that times the point's
    volume: the exact adjoint of (25), so that the coupling conserves energy. Each term is rounded by itself.

    Parameters
    ----------
    force_nodes : int64, shape (n_nodes, 3), dimension force / node quantum
        Added to. Rows of ghost nodes are completed by ``scatter_reverse``.
    points : int64, shape (2 n_cells, 9, 4), rows 6-8 of dimension force / point quantum
        The points' table, seen as integers; rows 6-8 are the complete forces F_p.
    first_cell : int
        First overlap cell; the others follow.
    connectivity : int32, shape (n_overlap, 8)
        Local nodes of the overlap cells, in range and not negative.
    ratio : float, dimension 1
        Point quantum / node quantum, with ``|F_p| ratio < 2**63``.
    """
    for cell in range(len(connectivity)):
        n0 = np.uint64(connectivity[cell, 0])
        for p in range(8):
            cluster = 2 * (first_cell + cell) + p // 4
            for c in range(3):
                force = points[cluster, 6 + c, p % 4] * ratio
                rest = np.int64(np.rint(force))
                for a in range(1, 8):
                    n = np.uint64(connectivity[cell, a])
                    share = np.int64(np.rint(SHAPE_AT_GAUSS[p, a] * force))
                    force_nodes[n, c] += share
                    rest -= share
                force_nodes[n0, c] += rest


SIGNATURES = {
    interpolate: types.void(types.float64[:, :, ::1], types.int64, types.int32[:, ::1], types.float64[:, ::1]),
    lump: types.void(types.int64[:, ::1], types.int64[:, :, ::1], types.int64, types.int32[:, ::1], types.float64),
}
