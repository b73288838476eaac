"""Stretches of the bonds that there would be if all cells had points: what elements foretell of the next break.

Displacements stand at the eight points of every cell, interpolated where there are elements. Each number is a largest
of terms that depend on two points alone: the same bits in any order, and on any number of ranks.
"""

import numpy as np
from numba import njit, types

from pdfem_mpi.kernels.cell_strains import ROWS
from pdfem_mpi.kernels.gap_cuts import leaves
from pdfem_mpi.kernels.hex8 import SHAPE_AT_GAUSS
from pdfem_mpi.kernels.near_cells import PLACES, are_near
from pdfem_mpi.kernels.simd import W, above, fma, lanes, load, splat

_options = {"cache": True, "nogil": True, "boundscheck": False, "error_model": "numpy"}


@njit(**_options)
def follow_nodes(cells, first, connectivity, u, S):
    """Displace the points of some cells with their nodes (25).

    Parameters
    ----------
    cells : int64, shape (n,)
        Cells from ``first`` on, whose nodes are the rows of ``connectivity``.
    connectivity : int32, shape (n_following, 8)
    u : float64, shape (n_nodes, 3), dimension length
    S : float64, shape (n_cells * 48,)
        Two clusters a cell: displacements in rows 0-2, which are overwritten, and positions in rows 3-5 of six.
    """
    for cell in cells:
        nodes = connectivity[cell - first]
        for c in range(3):
            origin = u[nodes[0], c]
            for p in range(8):
                moved = 0.0
                for a in range(1, 8):
                    moved += SHAPE_AT_GAUSS[p, a] * (u[nodes[a], c] - origin)
                S[ROWS * W * (2 * cell + p // W) + W * c + p % W] = origin + moved


@njit(**_options)
def raise_ratios(
    bins, members, place, centre, reach2, cells, S, class_of, inverse, cutoff2, cutoff, corners, planes, balls, lower,
    bin_size, n_bins, bin_start, bin_index, found, ratio,
):  # fmt: skip
    """Raise the ratios of some cells to the largest stretch over its limit of the bonds of their points.

    Parameters
    ----------
    bins, members, place, centre, reach2
        As of `near_cells.near_larger`.
    cells : int64, shape (n,)
    S : float64, shape (n_cells * 48,)
        As of `follow_nodes`, complete for the cells and those around them.
    class_of : int64, shape (n_cells,)
    inverse : float64, shape (n_classes, n_classes)
        One over the critical stretch; 0 where bonds do not break.
    cutoff2 : float, dimension length^2
    cutoff, corners, planes, balls, lower, bin_size, n_bins, bin_start, bin_index, found
        The body's surface, which no bond crosses, as of `gap_cuts.cut_gaps`. ``balls`` may be empty.
    ratio : float64, shape (n_cells,)
        Raised for the cells given.
    """
    far = splat(cutoff2)
    for cell in cells:
        top = ratio[cell]
        i, j, k = place[cell]
        for a in range(i - 1, i + 2):
            for b in range(j - 1, j + 2):
                for c in range(k - 1, k + 2):
                    for m in range(bins[a, b, c, 0], bins[a, b, c, 1]):
                        other = members[m]
                        limit = inverse[class_of[cell], class_of[other]]
                        if limit == 0.0 or not are_near(centre, cell, other, reach2):
                            continue
                        for q in range(2):
                            cluster = ROWS * W * (2 * other + q)
                            for p in range(8):
                                point = ROWS * W * (2 * cell + p // W) + p % W
                                square, work = _bonds(S, point, cluster)
                                larger = lanes(above(work * splat(limit), splat(top) * square))
                                if larger and larger & ~lanes(above(square, far)):
                                    top = _raised(
                                        S, point, cluster, limit, cutoff2, cutoff, corners, planes, balls, lower,
                                        bin_size, n_bins, bin_start, bin_index, found, top,
                                    )  # fmt: skip
        ratio[cell] = top


@njit(**_options)
def _raised(
    S, a, b, limit, cutoff2, cutoff, corners, planes, balls, lower, bin_size, n_bins, bin_start, bin_index, found, top
):  # fmt: skip
    """The largest of a ratio and those of the bonds from a point to the four of a cluster."""
    p, q, heights = np.empty(3), np.empty(3), np.empty(found.size)
    for k in range(W):
        square, work = 0.0, 0.0
        for d in range(3):
            xi = S[b + k + W * (3 + d)] - S[a + W * (3 + d)]
            square += xi * xi
            work += xi * (S[b + k + W * d] - S[a + W * d])
            p[d], q[d] = S[a + W * (3 + d)], S[b + k + W * (3 + d)]
        if square > cutoff2 or square == 0.0 or work / square * limit <= top:
            continue
        if not balls.size or not leaves(
            p, q, cutoff, corners, planes, balls, lower, bin_size, n_bins, bin_start, bin_index, found, heights
        ):  # fmt: skip
            top = work / square * limit
    return top


@njit(**_options)
def _bonds(S, a, b):
    """Squared lengths, and products with the changes, of the bonds from a point to those of a cluster."""
    gx = load(S, b + 3 * W) - splat(S[a + 3 * W])
    gy = load(S, b + 4 * W) - splat(S[a + 4 * W])
    gz = load(S, b + 5 * W) - splat(S[a + 5 * W])
    dx = load(S, b) - splat(S[a])
    dy = load(S, b + W) - splat(S[a + W])
    dz = load(S, b + 2 * W) - splat(S[a + 2 * W])
    return fma(gx, gx, fma(gy, gy, gz * gz)), fma(dx, gx, fma(dy, gy, dz * gz))


_i8, _f8, _table, _real = types.int64[::1], types.float64[::1], types.float64[:, ::1], types.float64
SIGNATURES = {
    follow_nodes: types.void(_i8, types.int64, types.int32[:, ::1], _table, _f8),
    raise_ratios: types.void(
        *PLACES, _i8, _f8, _i8, _table, _real, _real, _table, _table, _table, _f8, _real, *4 * (_i8,), _f8
    ),
}
