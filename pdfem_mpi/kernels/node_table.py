"""Nodes beside the sweeps over elements: forces out of their table, and sums of what cells give to them."""

import numpy as np
from numba import njit, types

_options = {"cache": True, "nogil": True, "boundscheck": False, "error_model": "numpy"}


@njit(**_options)
def read_nodes(integers, quantum, external, force):
    """Residual force of the first nodes, ``external + quantum * integers``.

    Parameters
    ----------
    integers : int64, shape (>= n_nodes, 3), dimension force / quantum
    quantum : float, dimension force
    external, force : float64, shape (n_nodes, 3), dimension force
        ``force`` is overwritten.
    """
    for n in range(force.shape[0]):
        for d in range(3):
            force[n, d] = external[n, d] + quantum * integers[n, d]


@njit(**_options)
def add_rounded_rows(places, rows, quantum, sums):
    """Add rows of numbers to the sums of places, each number rounded to the quantum; a place may come many times.

    Parameters
    ----------
    places : int32, shape (n,)
    rows : float64, shape (n, width)
    quantum : float
        Power of two.
    sums : int64, shape (n_places, width)
        In quanta; added to.
    """
    inverse = 1.0 / quantum
    for t in range(places.size):
        n = np.uint64(places[t])
        for d in range(rows.shape[1]):
            sums[n, d] += np.int64(np.rint(rows[t, d] * inverse))


_table, _sums = types.float64[:, ::1], types.int64[:, ::1]
SIGNATURES = {
    read_nodes: types.void(_sums, types.float64, _table, _table),
    add_rounded_rows: types.void(types.int32[::1], _table, types.float64, _sums),
}
