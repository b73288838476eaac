"""Sums of eq. (5): the weights ``exp(-(|xi|/l)^2) w`` of the bonds that a point has."""

import math

import numpy as np
from numba import njit, types

from pdfem_mpi.kernels.simd import W

_options = {"cache": True, "nogil": True, "boundscheck": False, "error_model": "numpy"}


@njit(**_options)
def _weight(i, j, x):
    r2 = 0.0
    for d in range(3):
        r2 += (x[12 * (j // W) + W * d + j % W] - x[12 * (i // W) + W * d + i % W]) ** 2
    return math.exp(-r2)


@njit(**_options)
def add_pair(i, j, cell_number, x, volume, quantum, sums):
    """Add the weights of one bond to its local points ``i`` and ``j``; the rest as of `add_bond_weights`."""
    weight = _weight(i, j, x) / quantum
    sums[i] += np.int64(np.rint(weight * volume[j]))
    if cell_number[j // (2 * W)] != cell_number[i // (2 * W)] or (j - i) % (2 * W):
        sums[j] += np.int64(np.rint(weight * volume[i]))


@njit(**_options)
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
        for row in range(row_start[i], row_start[i + 1]):
            c = np.int64(row_offset[row]) // (9 * W)
            for k in range(W):
                if row_data[row * stride + k] != 0.0:
                    add_pair(i, W * c + k, cell_number, x, volume, quantum, sums)


@njit(**_options)
def add_listed_weights(pairs, cell_number, x, volume, quantum, sums):
    """Add the weights of listed bonds, as `add_bond_weights` does of those in the rows.

    Parameters
    ----------
    pairs : int64, shape (n, 2)
        Local points, each bond once.
    """
    for t in range(pairs.shape[0]):
        add_pair(pairs[t, 0], pairs[t, 1], cell_number, x, volume, quantum, sums)


@njit(**_options)
def add_shared_weights(pairs, share, cell_number, x, volume, quantum, sums):
    """Add a share, float64, shape (n,), of the weights of listed bonds, as `add_listed_weights` adds them all."""
    for t in range(pairs.shape[0]):
        i, j = pairs[t, 0], pairs[t, 1]
        weight = share[t] * (_weight(i, j, x) / quantum)
        sums[i] += np.int64(np.rint(weight * volume[j]))
        if cell_number[j // (2 * W)] != cell_number[i // (2 * W)] or (j - i) % (2 * W):
            sums[j] += np.int64(np.rint(weight * volume[i]))


_f8, _i8, _int = types.float64[::1], types.int64[::1], types.int64
SIGNATURES = {
    add_shared_weights: types.void(types.int64[:, ::1], _f8, _i8, _f8, _f8, types.float64, _i8),
    add_listed_weights: types.void(types.int64[:, ::1], _i8, _f8, _f8, types.float64, _i8),
    add_bond_weights: types.void(
        _i8, types.uint32[::1], types.float32[::1], types.int64, _i8, _f8, _f8, types.float64, _i8
    ),
}
