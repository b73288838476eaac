"""Sums of eq. (5): the weights ``exp(-(|xi|/l)^2) w`` of the bonds that a point has."""

import math

import numpy as np
from numba import njit, types

from pdfem_mpi.kernels.simd import W


@njit(cache=True, nogil=True, boundscheck=False, error_model="numpy")
def add_bond_weights(row_start, row_offset, row_data, stride, cell_number, x, volume, quantum, sums):
    """Add ``exp(-r0^2) w`` of the other point to both points of every bond that stands in the rows.

    A bond of a point to its own mirror image counts once for the point: both of its ends are the point.

    Parameters
    ----------
    row_start, row_offset : int64 (n_points + 1,), uint32 (n_rows + 1,)
    row_data : float32, shape ((n_rows + 1) * stride,)
        The first four numbers of a row are 0 in slots without a bond: padding, and broken bonds.
    stride : int
        Stored numbers a row.
    cell_number : int64, shape (n_clusters / 2,)
        Number of each local cell; an image has that of its cell.
    x : float64, shape (n_clusters * 12,), dimension length / l
        Positions in cluster layout.
    volume : float64, shape (n_clusters * 4,), dimension length^3 / l^3
        Integration weights ``w``.
    quantum : float, dimension length^3 / l^3
        Power of two; each term is rounded to a multiple of it, so that sums are exact in any order.
    sums : int64, shape (n_clusters * 4,)
        Added to, in quanta.
    """
    for i in range(row_start.size - 1):
        own = 12 * (i // W) + i % W
        for row in range(row_start[i], row_start[i + 1]):
            c = np.int64(row_offset[row]) // (9 * W)
            for k in range(W):
                if row_data[row * stride + k] == 0.0:
                    continue
                r2 = 0.0
                for d in range(3):
                    r2 += (x[12 * c + W * d + k] - x[own + W * d]) ** 2
                weight = math.exp(-r2) / quantum
                sums[i] += np.int64(np.rint(weight * volume[W * c + k]))
                if cell_number[c // 2] != cell_number[i // (2 * W)] or (W * c + k - i) % (2 * W):
                    sums[W * c + k] += np.int64(np.rint(weight * volume[i]))


_f8, _i8 = types.float64[::1], types.int64[::1]
SIGNATURES = {
    add_bond_weights: types.void(
        _i8, types.uint32[::1], types.float32[::1], types.int64, _i8, _f8, _f8, types.float64, _i8
    ),
}
