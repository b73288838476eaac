"""Bonds whose straight line leaves the body: they would reach across what was taken out of a box of cells."""

import math

import numpy as np
from numba import njit, types

from pdfem_mpi.kernels.simd import W

#: Removed cells are this much smaller on all sides, in cells: a bond along their edges is not cut, however it rounds.
ROUND_OFF = 1e-6

_options = {"cache": True, "nogil": True, "boundscheck": False, "error_model": "numpy"}


@njit(**_options)
def cut_gaps(row_start, row_offset, row_data, x, scale, removed, sums, material, finite, counts):
    """Take out every bond whose straight line passes through a removed cell.

    Parameters
    ----------
    row_start, row_offset : int64 (n_points + 1,), uint32 (n_rows + 1,)
    row_data : float32, shape ((n_rows + 1) * (8 if finite else 4),)
        Stored numbers are set to 0 for bonds that are taken out.
    x : float64, shape (n_clusters * 12,), dimension length
        Positions in cluster layout.
    scale : float64, shape (2, 3), dimensions 1 / length and 1
        ``scale[0] x + scale[1]`` is a position in cells of the window, from its corner.
    removed : uint8, shape (nx, ny, nz)
        Cells of the window that are removed; it holds all points.
    sums : int32, shape (nx + 1, ny + 1, nz + 1)
        How many are, below each corner of the window's cells.
    material : int16, shape (n_clusters / 2,)
        Material of each local cell.
    finite : bool
        Layout of ``row_data``.
    counts : int64, shape (n_materials, n_materials)
        Bonds by materials; those taken out are subtracted.
    """
    stride = 2 * W if finite else W
    p, q = np.empty(3), np.empty(3)
    low, high = np.empty(3, np.int64), np.empty(3, np.int64)
    for i in range(row_start.size - 1):
        own = 12 * (i // W) + i % W
        for d in range(3):
            p[d] = scale[0, d] * x[own + W * d] + scale[1, d]
        for row in range(row_start[i], row_start[i + 1]):
            c = np.int64(row_offset[row]) // 3
            for k in range(W):
                if row_data[row * stride + k] == 0.0:
                    continue
                for d in range(3):
                    q[d] = scale[0, d] * x[c + W * d + k] + scale[1, d]
                    low[d] = math.floor(min(p[d], q[d]))
                    high[d] = math.floor(max(p[d], q[d])) + 1
                between = 0
                for a in range(2):
                    for b in range(2):
                        for e in range(2):
                            sign = 1 if (a + b + e) % 2 else -1
                            between += (
                                sign
                                * sums[high[0] if a else low[0], high[1] if b else low[1], high[2] if e else low[2]]
                            )
                if between and _passes(p, q, low, high, removed):
                    for s in range(0, stride, W):
                        row_data[row * stride + s + k] = 0.0
                    counts[material[i // (2 * W)], material[c // (24)]] -= 1


@njit(**_options)
def passes_through(p, q, removed, sums):
    """Whether the line from p to q, float64 (3,) in cells of the window, passes through a removed cell of it."""
    low, high = np.empty(3, np.int64), np.empty(3, np.int64)
    for d in range(3):
        low[d] = math.floor(min(p[d], q[d]))
        high[d] = math.floor(max(p[d], q[d])) + 1
    between = 0
    for a in range(2):
        for b in range(2):
            for e in range(2):
                sign = 1 if (a + b + e) % 2 else -1
                between += (
                    sign * sums[high[0] if a else low[0], high[1] if b else low[1], high[2] if e else low[2]]
                )
    return between != 0 and _passes(p, q, low, high, removed)


@njit(**_options)
def _passes(p, q, low, high, removed):
    """Whether the line from p to q passes through a removed cell of a range."""
    for a in range(low[0], high[0]):
        for b in range(low[1], high[1]):
            for e in range(low[2], high[2]):
                if removed[a, b, e] and _meets(p, q, a, b, e):
                    return True
    return False


@njit(**_options)
def _meets(p, q, a, b, e):
    """Whether the line from p to q meets the inside of one cell."""
    first, last = 0.0, 1.0
    for d in range(3):
        corner = a if d == 0 else (b if d == 1 else e)
        low, high = corner + ROUND_OFF, corner + 1.0 - ROUND_OFF
        way = q[d] - p[d]
        if abs(way) < ROUND_OFF:
            if p[d] < low or p[d] > high:
                return False
            continue
        one, two = (low - p[d]) / way, (high - p[d]) / way
        first = max(first, min(one, two))
        last = min(last, max(one, two))
    return first < last


SIGNATURES = {
    cut_gaps: types.void(
        types.int64[::1],
        types.uint32[::1],
        types.float32[::1],
        types.float64[::1],
        types.float64[:, ::1],
        types.uint8[:, :, ::1],
        types.int32[:, :, ::1],
        types.int16[::1],
        types.boolean,
        types.int64[:, ::1],
    ),
}
