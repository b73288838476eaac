"""Solve with Cholesky's factors that are kept front by front, see `dissection.Factor`."""

import numpy as np
from numba import njit, types

_options = {"cache": True, "nogil": True, "boundscheck": False, "error_model": "numpy"}


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
SIGNATURES = {solve_fronts: types.void(_i8, _i8, _i8, _i8, types.float32[::1], _f8)}
