"""Cholesky's factors front by front, see `dissection.Factor`: eliminate a front, and solve with all of them."""

import math

import numpy as np
from numba import njit, types

from pdfem_mpi.kernels.simd import W, fma, fnma, load, splat, store

#: Columns that are eliminated before what stands behind them is changed.
PANEL = 32
#: Rows and columns of 0 behind a front, which whole lanes may read.
MARGIN = 2 * W

_options = {"cache": True, "nogil": True, "boundscheck": False, "error_model": "numpy"}


@njit(**_options)
def eliminate_front(entries, stride, n, m):
    """Eliminate the first ``m`` of ``n`` unknowns of a symmetric matrix; what is left of the others is their part.

    Parameters
    ----------
    entries : float64, shape ((n + MARGIN) * stride,)
        Entry of row r and column c at ``c * stride + r``, for ``r >= c`` only; 0 behind. Overwritten.
    stride : int
        At least ``n + MARGIN``.
    n, m : int

    Returns
    -------
    int
        The first column whose pivot is not positive, or -1.
    """
    for first in range(0, m, PANEL):
        last = min(first + PANEL, m)
        for c in range(first, last):
            column = c * stride
            for k in range(first, c):
                x = splat(entries[k * stride + c])
                for r in range(c, n, W):
                    store(entries, column + r, fnma(x, load(entries, k * stride + r), load(entries, column + r)))
            pivot = entries[column + c]
            if not pivot > 0.0:
                return c
            inverse = splat(1.0 / math.sqrt(pivot))
            for r in range(c, n, W):
                store(entries, column + r, inverse * load(entries, column + r))
        for j in range(last, n, 4):
            at = j * stride
            for r in range(j, n, 2 * W):
                a0 = a1 = a2 = a3 = splat(0.0)
                b0 = b1 = b2 = b3 = splat(0.0)
                for k in range(first, last):
                    row = k * stride
                    y, z = load(entries, row + r), load(entries, row + r + W)
                    x = splat(entries[row + j])
                    a0, b0 = fma(x, y, a0), fma(x, z, b0)
                    x = splat(entries[row + j + 1])
                    a1, b1 = fma(x, y, a1), fma(x, z, b1)
                    x = splat(entries[row + j + 2])
                    a2, b2 = fma(x, y, a2), fma(x, z, b2)
                    x = splat(entries[row + j + 3])
                    a3, b3 = fma(x, y, a3), fma(x, z, b3)
                here = at + r
                store(entries, here, load(entries, here) - a0)
                store(entries, here + W, load(entries, here + W) - b0)
                here += stride
                store(entries, here, load(entries, here) - a1)
                store(entries, here + W, load(entries, here + W) - b1)
                here += stride
                store(entries, here, load(entries, here) - a2)
                store(entries, here + W, load(entries, here + W) - b2)
                here += stride
                store(entries, here, load(entries, here) - a3)
                store(entries, here + W, load(entries, here + W) - b3)
    return -1


@njit(**_options)
def solve_fronts(start, n_own, rows, place, entries, x):
    """``x := (L L^t)^-1 x``.

    Parameters
    ----------
    start, n_own, rows, place : int64
    entries : float32
        Attributes of `dissection.Factor`.
    x : float64, shape (n_unknowns,)
        Overwritten.
    """
    n_fronts = n_own.size
    longest = 0
    for f in range(n_fronts):
        longest = max(longest, start[f + 1] - start[f])
    y = np.empty(longest)
    for f in range(n_fronts):
        first, n, m = start[f], start[f + 1] - start[f], n_own[f]
        for r in range(n):
            y[r] = x[rows[first + r]]
        at = place[f]
        for c in range(m):
            y[c] *= np.float64(entries[at])
            for r in range(1, n - c):
                y[c + r] -= np.float64(entries[at + r]) * y[c]
            at += n - c
        for r in range(n):
            x[rows[first + r]] = y[r]
    for f in range(n_fronts - 1, -1, -1):
        first, n, m = start[f], start[f + 1] - start[f], n_own[f]
        for r in range(n):
            y[r] = x[rows[first + r]]
        at = place[f + 1]
        for c in range(m - 1, -1, -1):
            at -= n - c
            length = n - c
            s0, s1, s2, s3 = 0.0, 0.0, 0.0, 0.0
            whole = 1 + 4 * ((length - 1) // 4)
            for r in range(1, whole, 4):
                s0 += np.float64(entries[at + r]) * y[c + r]
                s1 += np.float64(entries[at + r + 1]) * y[c + r + 1]
                s2 += np.float64(entries[at + r + 2]) * y[c + r + 2]
                s3 += np.float64(entries[at + r + 3]) * y[c + r + 3]
            for r in range(whole, length):
                s0 += np.float64(entries[at + r]) * y[c + r]
            y[c] = (y[c] - ((s0 + s1) + (s2 + s3))) * np.float64(entries[at])
        for r in range(m):
            x[rows[first + r]] = y[r]


_i8, _f8 = types.int64[::1], types.float64[::1]
SIGNATURES = {
    eliminate_front: types.int64(_f8, types.int64, types.int64, types.int64),
    solve_fronts: types.void(_i8, _i8, _i8, _i8, types.float32[::1], _f8),
}
