"""The preconditioner's cycle between its sweeps, node by node: each step in one pass over the nodes.

Blocks are symmetric 3x3 matrices, one a node, with the entries xx, yy, zz, xy, yz, zx.
"""

import numpy as np
from numba import njit, types

_options = {"cache": True, "nogil": True, "boundscheck": False, "error_model": "numpy"}


@njit(inline="always", **_options)
def _product(b, x, y, z):
    return b[0] * x + b[3] * y + b[5] * z, b[3] * x + b[1] * y + b[4] * z, b[5] * x + b[4] * y + b[2] * z


@njit(**_options)
def start_cycle(sums, quantum, fixed, blocks, omega, right, x):
    """Make the right-hand side of the sums, and the first smoothing from 0 on: ``x = omega B right``.

    Parameters
    ----------
    sums : int64, shape (>= n_nodes, 3), dimension force / quantum
    quantum : float, dimension force
    fixed : bool, shape (3 n_nodes,)
        Where the right-hand side is 0.
    blocks : float64, shape (n_nodes, 6), dimension length / force
    omega : float
    right, x : float64, shape (3 n_nodes,), dimensions force and length
        Overwritten.
    """
    for t in range(blocks.shape[0]):
        for d in range(3):
            right[3 * t + d] = 0.0 if fixed[3 * t + d] else sums[t, d] * quantum
        u, v, w = _product(blocks[t], right[3 * t], right[3 * t + 1], right[3 * t + 2])
        x[3 * t] = 0.0 + omega * u
        x[3 * t + 1] = 0.0 + omega * v
        x[3 * t + 2] = 0.0 + omega * w


@njit(**_options)
def finish_cycle(blocks, omega, residual, x, scale, correction):
    """The last smoothing, scaled: ``correction = (x + omega B residual) scale``.

    Parameters
    ----------
    blocks, omega
        As in `start_cycle`.
    residual, x : float64, shape (3 n_nodes,), dimensions force and length
    scale : float
    correction : float64, shape (>= n_nodes, 3), dimension length
        The first rows are overwritten.
    """
    for t in range(blocks.shape[0]):
        u, v, w = _product(blocks[t], residual[3 * t], residual[3 * t + 1], residual[3 * t + 2])
        correction[t, 0] = (x[3 * t] + omega * u) * scale
        correction[t, 1] = (x[3 * t + 1] + omega * v) * scale
        correction[t, 2] = (x[3 * t + 2] + omega * w) * scale


@njit(**_options)
def correct_nodes(places, correction, blocks, omega, r, z):
    """Corrections of some of the nodes, and their own blocks beside them: ``z = correction + omega B r``.

    Parameters
    ----------
    places : int32, shape (n,)
    correction : float64, shape (n_nodes, 3), dimension length
    blocks : float64, shape (n, 6), dimension length / force
    omega : float
    r, z : float64, shape (n, 3), dimensions force and length
        ``z`` is overwritten.
    """
    for t in range(places.size):
        n = np.uint64(places[t])
        u, v, w = _product(blocks[t], r[t, 0], r[t, 1], r[t, 2])
        z[t, 0] = correction[n, 0] + omega * u
        z[t, 1] = correction[n, 1] + omega * v
        z[t, 2] = correction[n, 2] + omega * w


_f8, _table, _real = types.float64[::1], types.float64[:, ::1], types.float64
_places, _sums = types.int32[::1], types.int64[:, ::1]
SIGNATURES = {
    start_cycle: types.void(_sums, _real, types.boolean[::1], _table, _real, _f8, _f8),
    finish_cycle: types.void(_table, _real, _f8, _f8, _real, _table),
    correct_nodes: types.void(_places, _table, _table, _real, _table, _table),
}
