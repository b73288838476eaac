"""Ten multipliers a point, or nine, to and from the nodes of a background grid of triquadratic elements."""

import math

import numpy as np
from numba import njit, types

from pdfem_mpi.kernels.simd import PATTERN, W

_options = {"cache": True, "nogil": True, "boundscheck": False, "error_model": "numpy"}


@njit(inline="always")
def _weights(x, p, lower, inverse_h, counts, weights):
    """Element of point p as its lowest node, and the triquadratic weights of its nodes by axis."""
    node = 0
    base = 3 * W * (p // W) + p % W
    for d in range(3):
        scaled = (x[base + W * d] - lower[d]) * inverse_h[d]
        cell = min(max(np.int64(math.floor(scaled)), 0), counts[d] - 1)
        xi = scaled - cell
        node = node * (2 * counts[d] + 1) + 2 * cell
        weights[d, 0] = (1.0 - xi) * (1.0 - 2.0 * xi)
        weights[d, 1] = 4.0 * xi * (1.0 - xi)
        weights[d, 2] = xi * (2.0 * xi - 1.0)
    return node


@njit(**_options)
def restrict_moments(n_points, x, lower, inverse_h, counts, number, r, quantum, coarse):
    """Add ``T^t r`` to the nodes of a background grid of triquadratic elements, each term rounded to the quantum.

    Parameters
    ----------
    n_points : int
    x : float64, shape (>= n_points * 3,), dimension length
        Cluster layout.
    lower, inverse_h : float64, shape (3,)
        Corner of the grid and elements per length.
    counts : int64, shape (3,)
        Elements along the axes.
    number : int64, shape (n_grid_nodes,)
        Numbers of the grid's nodes.
    r : float64, shape (n_points * size,)
    quantum : float
        Power of two; a term must stay below ``2**51`` quanta, a sum below ``2**62``.
    coarse : int64, shape (n_nodes, size)
        Added to.
    """
    # the bits of a number beside M, less those of M, count its quanta
    M = PATTERN * quantum
    N = coarse.shape[1]
    terms = np.full(N, M)
    bits = terms.view(np.int64)
    of_M = bits[0]
    weights = np.empty((3, 3))
    own = np.empty(N)
    for p in range(n_points):
        node = _weights(x, p, lower, inverse_h, counts, weights)
        base = N * W * (p // W) + p % W
        for d in range(N):
            own[d] = r[base + W * d]
        for a in range(3):
            for b in range(3):
                of_line = node + (a * (2 * counts[1] + 1) + b) * (2 * counts[2] + 1)
                weight = weights[0, a] * weights[1, b]
                for c in range(3):
                    to = number[of_line + c]
                    w = weight * weights[2, c]
                    for d in range(N):
                        terms[d] = w * own[d] + M
                    for d in range(N):
                        coarse[to, d] += bits[d] - of_M


@njit(**_options)
def interpolate_moments(n_points, x, lower, inverse_h, counts, number, coarse, z):
    """Add ``T coarse`` to ``z``; parameters as in `restrict_moments`, ``coarse`` float64."""
    N = coarse.shape[1]
    weights = np.empty((3, 3))
    own = np.empty(N)
    for p in range(n_points):
        node = _weights(x, p, lower, inverse_h, counts, weights)
        base = N * W * (p // W) + p % W
        own[:] = 0.0
        for a in range(3):
            for b in range(3):
                of_line = node + (a * (2 * counts[1] + 1) + b) * (2 * counts[2] + 1)
                weight = weights[0, a] * weights[1, b]
                for c in range(3):
                    of_node = number[of_line + c]
                    w = weight * weights[2, c]
                    for d in range(N):
                        own[d] += w * coarse[of_node, d]
        for d in range(N):
            z[base + W * d] += own[d]


_f8, _i8 = types.float64[::1], types.int64[::1]
_grid = (types.int64, _f8, _f8, _f8, _i8, _i8)
SIGNATURES = {
    restrict_moments: types.void(*_grid, _f8, types.float64, types.int64[:, ::1]),
    interpolate_moments: types.void(*_grid, types.float64[:, ::1], _f8),
}
