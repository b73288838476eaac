"""Cells within a reach of each other, by bins as wide as that: where numbers are large, and what is around."""

import math

from numba import njit, types

_options = {"cache": True, "nogil": True, "boundscheck": False, "error_model": "numpy"}


@njit(**_options)
def raise_bins(bins, members, number, inside, around):
    """Largest number of the cells in each bin, and of those in it and the 26 bins around it.

    Parameters
    ----------
    bins : int64, shape (nx, ny, nz, 2)
        Where the cells of each bin begin and end in ``members``; the outermost bins are empty.
    members : int64, shape (n_cells,)
    number : float64, shape (n_cells,)
    inside, around : float64, shape (nx, ny, nz)
        Overwritten.
    """
    inside[:], around[:] = 0.0, 0.0
    nx, ny, nz = around.shape
    for i in range(1, nx - 1):
        for j in range(1, ny - 1):
            for k in range(1, nz - 1):
                top = 0.0
                for m in range(bins[i, j, k, 0], bins[i, j, k, 1]):
                    top = max(top, number[members[m]])
                inside[i, j, k] = top
                for a in range(i - 1, i + 2):
                    for b in range(j - 1, j + 2):
                        for c in range(k - 1, k + 2):
                            around[a, b, c] = max(around[a, b, c], top)


@njit(**_options)
def near_larger(
    bins, members, place, centre, reach2, number, more, inside, more_inside, around, more_around, limit, chosen
):
    """Which of the first cells have a limit below the sum of the largest numbers of both kinds within the reach.

    Parameters
    ----------
    bins, members, number, inside, around, more, more_inside, more_around
        As of `raise_bins`.
    place : int32, shape (n_cells, 3)
        Bin of each cell.
    centre : float64, shape (n_cells, 3), dimension length
    reach2 : float, dimension length^2
        Bins are as wide as the reach.
    limit : float64, shape (n,)
    chosen : bool, shape (n,)
        Overwritten.
    """
    for cell in range(limit.size):
        i, j, k = place[cell]
        chosen[cell] = limit[cell] < 0.0 or (
            around[i, j, k] + more_around[i, j, k] > limit[cell]
            and _largest_around(
                bins, members, place, centre, reach2, number, more, inside, more_inside, cell, limit[cell]
            )
            > limit[cell]
        )


@njit(**_options)
def _largest_around(bins, members, place, centre, reach2, number, more, inside, more_inside, cell, enough):
    """Sum of the largest numbers of both kinds within the reach of a cell; what was found first above ``enough``."""
    i, j, k = place[cell]
    top, most = number[cell], more[cell]
    for a in range(i - 1, i + 2):
        for b in range(j - 1, j + 2):
            for c in range(k - 1, k + 2):
                if inside[a, b, c] <= top and more_inside[a, b, c] <= most:
                    continue
                for m in range(bins[a, b, c, 0], bins[a, b, c, 1]):
                    other = members[m]
                    if (number[other] > top or more[other] > most) and are_near(centre, cell, other, reach2):
                        top, most = max(top, number[other]), max(most, more[other])
                        if top + most > enough:
                            return top + most
    return top + most


@njit(**_options)
def largest_near(
    bins, members, place, centre, reach2, number, more, inside, more_inside, around, more_around, enough, largest
):
    """Bound the sums of the largest numbers of both kinds within the reach of each of the first cells.

    Parameters
    ----------
    bins, members, place, centre, reach2, number, more, inside, more_inside, around, more_around
        As of `near_larger`.
    enough : float64, shape (n,)
        Below this the largest of the bins will do.
    largest : float64, shape (n,)
        Overwritten.
    """
    for cell in range(largest.size):
        i, j, k = place[cell]
        largest[cell] = around[i, j, k] + more_around[i, j, k]
        if largest[cell] <= enough[cell]:
            continue
        largest[cell] = _largest_around(
            bins, members, place, centre, reach2, number, more, inside, more_inside, cell, math.inf
        )


@njit(**_options)
def are_near(centre, one, other, reach2):
    """Whether the centres of two cells are within the reach."""
    square = 0.0
    for d in range(3):
        square += (centre[other, d] - centre[one, d]) ** 2
    return square <= reach2


@njit(**_options)
def mark_around(bins, members, place, centre, reach2, cells, marked):
    """Mark the cells within the reach of some; ``marked``, bool, shape (n_cells,), the rest as of `near_larger`."""
    for cell in cells:
        i, j, k = place[cell]
        for a in range(i - 1, i + 2):
            for b in range(j - 1, j + 2):
                for c in range(k - 1, k + 2):
                    for m in range(bins[a, b, c, 0], bins[a, b, c, 1]):
                        if are_near(centre, cell, members[m], reach2):
                            marked[members[m]] = True


_f8, _table, _grid = types.float64[::1], types.float64[:, ::1], types.float64[:, :, ::1]
_bins = types.int64[:, :, :, ::1], types.int64[::1]
PLACES = (*_bins, types.int32[:, ::1], _table, types.float64)
SIGNATURES = {
    raise_bins: types.void(*_bins, _f8, _grid, _grid),
    near_larger: types.void(*PLACES, _f8, _f8, _grid, _grid, _grid, _grid, _f8, types.boolean[::1]),
    largest_near: types.void(*PLACES, _f8, _f8, _grid, _grid, _grid, _grid, _f8, _f8),
    mark_around: types.void(*PLACES, types.int64[::1], types.boolean[::1]),
}
