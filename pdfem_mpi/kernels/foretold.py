"""Stretches of the bonds that there would be if all cells had points: what elements foretell of the next break.

Displacements stand at the eight points of every cell, interpolated where there are elements. Each number is a largest
of terms that depend on two points alone: the same bits in any order, and on any number of ranks.
"""


import numpy as np
from numba import njit, types

from pdfem_mpi.kernels.gap_cuts import leaves
from pdfem_mpi.kernels.simd import W

_options = {"cache": True, "nogil": True, "boundscheck": False, "error_model": "numpy"}


@njit(**_options)
def _stretch(S, i, j, cutoff2):
    """Stretch of the bond from point ``i`` to ``j`` in linear kinematics; 0 beyond the cutoff radius."""
    a = 9 * W * (i // W) + i % W
    b = 9 * W * (j // W) + j % W
    square, work = 0.0, 0.0
    for d in range(3):
        xi = S[b + W * (3 + d)] - S[a + W * (3 + d)]
        square += xi * xi
        work += xi * (S[b + W * d] - S[a + W * d])
    if square > cutoff2 or square == 0.0:
        return 0.0
    return work / square


@njit(**_options)
def within_cells(S, class_of, inverse, cutoff2, ratio):
    """Largest stretch over its limit between two points of each cell.

    Parameters
    ----------
    S : float64, shape (n_cells * 72,)
        Two clusters a cell: displacements in rows 0-2 and positions in rows 3-5 of nine.
    class_of : int64, shape (n_cells,)
    inverse : float64, shape (n_classes, n_classes)
        One over the critical stretch; 0 where bonds do not break.
    cutoff2 : float, dimension length^2
    ratio : float64, shape (n_cells,)
        Overwritten.
    """
    for cell in range(ratio.size):
        top = 0.0
        for p in range(8):
            for q in range(p):
                top = max(top, _stretch(S, 8 * cell + p, 8 * cell + q, cutoff2))
        ratio[cell] = top * inverse[class_of[cell], class_of[cell]]


@njit(**_options)
def between_cells(
    cells, start, others, S, class_of, inverse, cutoff2, cutoff, corners, planes, balls, lower, bin_size, bins,
    bin_start, bin_index, found, ratio,
):  # fmt: skip
    """Raise the ratio of some cells by the bonds of their points to those of other cells.

    Parameters
    ----------
    cells : int64, shape (n,)
    start, others : int64, shapes (n + 1,), (m,)
        Cells that have points near those of each.
    S, class_of, inverse, cutoff2
        As of `within_cells`.
    cutoff, corners, planes, balls, lower, bin_size, bins, bin_start, bin_index, found
        The body's surface, which no bond crosses, as of `gap_cuts.cut_gaps`. ``balls`` may be empty.
    ratio : float64, shape (n_cells,)
        Raised for the cells given.
    """
    p, q, heights = np.empty(3), np.empty(3), np.empty(found.size)
    for k in range(cells.size):
        cell = cells[k]
        top = ratio[cell]
        for m in range(start[k], start[k + 1]):
            other = others[m]
            limit = inverse[class_of[cell], class_of[other]]
            if limit == 0.0 or other == cell:
                continue
            for i in range(8 * cell, 8 * cell + 8):
                for j in range(8 * other, 8 * other + 8):
                    stretched = _stretch(S, i, j, cutoff2) * limit
                    if stretched <= top:
                        continue
                    if balls.size:
                        for d in range(3):
                            p[d] = S[9 * W * (i // W) + i % W + W * (3 + d)]
                            q[d] = S[9 * W * (j // W) + j % W + W * (3 + d)]
                        if leaves(
                            p, q, cutoff, corners, planes, balls, lower, bin_size, bins, bin_start, bin_index, found,
                            heights,
                        ):  # fmt: skip
                            continue
                    top = stretched
        ratio[cell] = top


_table = types.float64[::1]
_common = (_table, types.int64[::1], types.float64[:, ::1], types.float64)
SIGNATURES = {
    within_cells: types.void(*_common, _table),
    between_cells: types.void(
        types.int64[::1],
        types.int64[::1],
        types.int64[::1],
        *_common,
        types.float64,
        types.float64[:, ::1],
        types.float64[:, ::1],
        types.float64[:, ::1],
        _table,
        types.float64,
        types.int64[::1],
        types.int64[::1],
        types.int64[::1],
        types.int64[::1],
        _table,
    ),
}
