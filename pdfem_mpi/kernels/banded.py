"""Cholesky's factors of a banded matrix, and solutions with them, in a written order of operations.

**Storage.** Columns stand in groups of four. Group ``g`` has a *corner*, the 4 x 4 block of the columns' own rows, and
a *panel*, the rows from ``4 g + 4`` on, each column's entries together::

    corners[g][row][column]        panels[g][column][row - 4 g - 4]        rows up to reach, a multiple of four

so that four rows are one value, and a group is eliminated by four fused multiply-adds for each four entries behind it.
The panels of the finished factor are kept in single precision: they precondition, and half of the bytes are half of
the time of a solve. Arithmetic is in double precision throughout.
"""

import math

import numpy as np
from numba import njit, types

from pdfem_mpi.kernels.simd import W, fma, fnma, hsum, load, prefetch, splat, store

#: Groups that are eliminated together, at least, before they are rounded to single precision.
TOGETHER = 64

_options = {"cache": True, "nogil": True, "boundscheck": False, "error_model": "numpy"}


@njit(**_options)
def factorise_band(corners, panels, reach, n_eliminated):
    """Overwrite the lower triangle of a positive matrix by its factor ``L``; the diagonal is inverted.

    Parameters
    ----------
    corners : float64, shape (n_groups * 16,)
        What stands above the diagonal is not read.
    panels : float64, shape (n_groups * 4 * reach,)
    reach : int
        Rows of a panel.
    n_eliminated : int
        So many of the groups become columns of the factor; what they take from those behind is taken.

    Returns
    -------
    int
        The first column whose pivot is not positive, or -1.
    """
    n_groups = corners.size // (W * W)
    for g in range(n_eliminated):
        c, p = g * W * W, g * W * reach
        for a in range(W):
            pivot = corners[c + W * a + a]
            for k in range(a):
                pivot -= corners[c + W * a + k] * corners[c + W * a + k]
            if not pivot > 0.0:
                return W * g + a
            inverse = 1.0 / math.sqrt(pivot)
            corners[c + W * a + a] = inverse
            for b in range(a + 1, W):
                entry = corners[c + W * b + a]
                for k in range(a):
                    entry -= corners[c + W * b + k] * corners[c + W * a + k]
                corners[c + W * b + a] = entry * inverse
        for a in range(W):
            inverse = splat(corners[c + W * a + a])
            for r in range(0, reach, W):
                x = load(panels, p + a * reach + r)
                for k in range(a):
                    x = fnma(splat(corners[c + W * a + k]), load(panels, p + k * reach + r), x)
                store(panels, p + a * reach + r, x * inverse)
        for behind in range(min(reach // W, n_groups - 1 - g)):
            # rows W * behind .. + 3 of the panel are the columns of the group behind
            top = W * behind
            other = (g + 1 + behind) * W * W
            for a in range(W):
                for b in range(a, W):
                    entry = corners[other + W * b + a]
                    for k in range(W):
                        row = p + k * reach + top
                        entry -= panels[row + a] * panels[row + b]
                    corners[other + W * b + a] = entry
            q = (g + 1 + behind) * W * reach
            for a in range(0, W, 2):
                left = p + top + a
                x0 = splat(panels[left])
                x1 = splat(panels[left + reach])
                x2 = splat(panels[left + 2 * reach])
                x3 = splat(panels[left + 3 * reach])
                y0 = splat(panels[left + 1])
                y1 = splat(panels[left + reach + 1])
                y2 = splat(panels[left + 2 * reach + 1])
                y3 = splat(panels[left + 3 * reach + 1])
                first = q + a * reach
                second = first + reach
                for r in range(W * (behind + 1), reach, W):
                    row = p + r
                    at = r - top - W
                    z0 = load(panels, row)
                    z1 = load(panels, row + reach)
                    z2 = load(panels, row + 2 * reach)
                    z3 = load(panels, row + 3 * reach)
                    x = load(panels, first + at)
                    y = load(panels, second + at)
                    x = fnma(x3, z3, fnma(x2, z2, fnma(x1, z1, fnma(x0, z0, x))))
                    y = fnma(y3, z3, fnma(y2, z2, fnma(y1, z1, fnma(y0, z0, y))))
                    store(panels, first + at, x)
                    store(panels, second + at, y)
    return -1


@njit(**_options)
def solve_band(corners, panels, reach, x):
    """``x := (L L^t)^-1 x``.

    Parameters
    ----------
    corners : float64, shape (n_groups * 16,)
    panels : float32, shape (n_groups * 4 * reach,)
    reach : int
    x : float64, shape (n_groups * 4 + reach,)
        Overwritten; 0 behind the unknowns.
    """
    n_groups = corners.size // (W * W)
    for g in range(n_groups):
        c, p, row = g * W * W, g * W * reach, g * W
        for a in range(W):
            value = x[row + a]
            for k in range(a):
                value -= corners[c + W * a + k] * x[row + k]
            x[row + a] = value * corners[c + W * a + a]
        x0 = splat(x[row])
        x1 = splat(x[row + 1])
        x2 = splat(x[row + 2])
        x3 = splat(x[row + 3])
        row += W
        for r in range(0, reach, W):
            at = p + r
            prefetch(panels, at + 4 * reach)
            prefetch(panels, at + 5 * reach)
            prefetch(panels, at + 6 * reach)
            prefetch(panels, at + 7 * reach)
            y = fnma(x0, load(panels, at), load(x, row + r))
            y = fnma(x1, load(panels, at + reach), y)
            y = fnma(x2, load(panels, at + 2 * reach), y)
            y = fnma(x3, load(panels, at + 3 * reach), y)
            store(x, row + r, y)
    for g in range(n_groups - 1, -1, -1):
        c, p, row = g * W * W, g * W * reach, g * W
        s0 = splat(0.0)
        s1 = splat(0.0)
        s2 = splat(0.0)
        s3 = splat(0.0)
        for r in range(0, reach, W):
            at = p + r
            prefetch(panels, at - 4 * reach)
            prefetch(panels, at - 3 * reach)
            prefetch(panels, at - 2 * reach)
            prefetch(panels, at - reach)
            y = load(x, row + W + r)
            s0 = fma(load(panels, at), y, s0)
            s1 = fma(load(panels, at + reach), y, s1)
            s2 = fma(load(panels, at + 2 * reach), y, s2)
            s3 = fma(load(panels, at + 3 * reach), y, s3)
        x[row] -= hsum(s0)
        x[row + 1] -= hsum(s1)
        x[row + 2] -= hsum(s2)
        x[row + 3] -= hsum(s3)
        for a in range(W - 1, -1, -1):
            value = x[row + a]
            for k in range(a + 1, W):
                value -= corners[c + W * k + a] * x[row + k]
            x[row + a] = value * corners[c + W * a + a]


def factor_of_band(row, column, values, n):
    """Factor of a symmetric positive matrix of ``n`` unknowns, by its entries on and below the diagonal.

    Parameters
    ----------
    row, column : int64, shape (n_entries,)
        In the order of the elimination, each pair once, ``row >= column``.
    values : float64, shape (n_entries,)
    n : int

    Returns
    -------
    corners : float64, shape (n_groups * 16,)
    panels : float32, shape (n_groups * 4 * reach,)
    reach : int

    Raises
    ------
    ArithmeticError
        The matrix is not positive.
    """
    n_groups, group = -(-n // W), column // W
    behind = row - W * (group + 1)  # the row in the column's panel; negative in its corner
    reach = W * (int(behind.max(initial=-1)) // W + 1)
    corners = np.tile(np.eye(W), (n_groups, 1, 1))  # of columns that only fill the last group
    near, panels = behind < 0, np.empty((n_groups, W, reach), np.float32)
    corners[group[near], (row % W)[near], (column % W)[near]] = values[near]
    # a group changes no others than the next `ahead`: in double precision are those, and the ones eliminated together
    ahead = reach // W
    together = max(ahead, TOGETHER)
    window = np.zeros((together + ahead, W, reach))
    far = np.flatnonzero(~near)
    far = far[np.argsort(group[far], kind="stable")]
    for first in range(0, n_groups, together):
        kept = ahead if first else 0
        window[:kept] = window[together : together + kept]
        window[kept:] = 0.0
        new = far[slice(*np.searchsorted(group[far], [first + kept, first + len(window)]))]
        window[group[new] - first, (column % W)[new], behind[new]] = values[new]
        here = corners[first : first + len(window)].reshape(-1)
        if factorise_band(here, window.reshape(-1), reach, min(together, n_groups - first)) >= 0:
            raise ArithmeticError("a banded matrix is not positive")
        panels[first : first + together] = window[: n_groups - first][:together]
    return corners.reshape(-1), panels.reshape(-1), reach


def solution_of_band(corners, panels, reach, right):
    """Solution for one right-hand side, both of shape (n,), in the order of the elimination."""
    x = np.zeros(len(corners) // W + reach)
    x[: len(right)] = right
    solve_band(corners, panels, reach, x)
    return x[: len(right)]


_f8, _int = types.float64[::1], types.int64
SIGNATURES = {
    factorise_band: _int(_f8, _f8, _int, _int),
    solve_band: types.void(_f8, types.float32[::1], _int, _f8),
}
