"""Places near given ones: the nearest, and how many, by bins wider than the reach.

Squares of distances are summed along x, y, z: the same bits whatever bins there are, and so on every rank.
"""

import math

import numpy as np
from numba import njit, types

_options = {"cache": True, "nogil": True, "boundscheck": False, "error_model": "numpy"}


@njit(**_options)
def nearest_squares(x, places, lower, width, bins, start, reach2, found):
    """Square of the distance to the nearest of the places, infinite where none is within the reach.

    Parameters
    ----------
    x : float64, shape (n, 3), dimension length
    places : float64, shape (n_places, 3), dimension length
        Bin by bin, the last axis fastest.
    lower : float64, shape (3,), dimension length
        Of the bins.
    width : float, dimension length
        Of a bin, more than the reach.
    bins : int64, shape (3,)
    start : int64, shape (n_bins + 1,)
        First place of each bin.
    reach2 : float, dimension length^2
    found : float64, shape (n,), dimension length^2
        Overwritten.
    """
    around = np.empty((3, 2), np.int64)
    for row in range(found.size):
        least = math.inf
        _bins_around(x, row, lower, width, bins, around)
        for i in range(around[0, 0], around[0, 1]):
            for j in range(around[1, 0], around[1, 1]):
                line = (i * bins[1] + j) * bins[2]
                for k in range(start[line + around[2, 0]], start[line + around[2, 1]]):
                    least = min(least, _square(x, row, places, k))
        found[row] = least if least <= reach2 else math.inf


@njit(**_options)
def count_near(x, places, lower, width, bins, start, reach2, found):
    """How many of the places are within the reach; ``found``, int64, shape (n,), the rest as of `nearest_squares`."""
    around = np.empty((3, 2), np.int64)
    for row in range(found.size):
        n = 0
        _bins_around(x, row, lower, width, bins, around)
        for i in range(around[0, 0], around[0, 1]):
            for j in range(around[1, 0], around[1, 1]):
                line = (i * bins[1] + j) * bins[2]
                for k in range(start[line + around[2, 0]], start[line + around[2, 1]]):
                    n += _square(x, row, places, k) <= reach2
        found[row] = n


@njit(**_options)
def _bins_around(x, row, lower, width, bins, around):
    """The bins beside that of a place along each axis: the first, and the first behind them; none far from all."""
    for d in range(3):
        bin_ = np.floor((x[row, d] - lower[d]) / width)  # a float: far away its number would not fit into an integer
        around[d, 0] = int(min(max(bin_ - 1.0, 0.0), bins[d]))
        around[d, 1] = int(min(max(bin_ + 2.0, 0.0), bins[d]))


@njit(**_options)
def _square(x, row, places, k):
    square = 0.0
    for d in range(3):
        square += (x[row, d] - places[k, d]) ** 2
    return square


_table, _f8, _i8 = types.float64[:, ::1], types.float64[::1], types.int64[::1]
_near = _table, _table, _f8, types.float64, _i8, _i8, types.float64
SIGNATURES = {
    nearest_squares: types.void(*_near, _f8),
    count_near: types.void(*_near, _i8),
}
