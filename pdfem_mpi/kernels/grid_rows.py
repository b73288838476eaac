"""Residuals on a level of the coarse grid, from rows of 3x3 blocks in single precision.

A row belongs to a grid node: a block for each of the nodes around it, in the order of the grid. A block's columns stand
one after the other, each filled up to four entries, so that the three components of the row are one value::

    blocks[16 bytes * (3 * block + column)] = (xx, yx, zx, 0) ...
"""

import numpy as np
from numba import njit, types

from pdfem_mpi.kernels.simd import W, fnma, load, prefetch, splat, store

_options = {"cache": True, "nogil": True, "boundscheck": False, "error_model": "numpy"}
#: Entries of a block; entries ahead of the one at work that are asked for.
BLOCK = 3 * W
_AHEAD = 32 * BLOCK


@njit(**_options)
def grid_residual(start, column, blocks, x, right, residual):
    """``residual = right - A x``; the terms of a column of the blocks are taken off in their order, columns together.

    Parameters
    ----------
    start : int32, shape (n_rows + 1,)
        First block of each row.
    column : int32, shape (n_blocks,)
        Node of each block.
    blocks : float32, shape (n_blocks * 12,), dimension force / length
    x : float64, shape (>= n_nodes * 3,), dimension length
    right, residual : float64, shapes (n_rows * 3,) and (n_rows * 3,), dimension force
        The second is overwritten; it may be the first.
    """
    row = np.zeros(W)
    for t in range(start.size - 1):
        row[0], row[1], row[2] = right[3 * t], right[3 * t + 1], right[3 * t + 2]
        sx = load(row, 0)
        sy = splat(0.0)  # three sums, so that none waits for the one before
        sz = splat(0.0)
        for block in range(start[t], start[t + 1]):
            n, at = np.uint64(3 * column[block]), block * BLOCK
            prefetch(blocks, at + _AHEAD)
            sx = fnma(load(blocks, at), splat(x[n]), sx)
            sy = fnma(load(blocks, at + W), splat(x[n + np.uint64(1)]), sy)
            sz = fnma(load(blocks, at + 2 * W), splat(x[n + np.uint64(2)]), sz)
        store(row, 0, sx + (sy + sz))
        residual[3 * t], residual[3 * t + 1], residual[3 * t + 2] = row[0], row[1], row[2]


_f8, _i4 = types.float64[::1], types.int32[::1]
SIGNATURES = {grid_residual: types.void(_i4, _i4, types.float32[::1], _f8, _f8, _f8)}
