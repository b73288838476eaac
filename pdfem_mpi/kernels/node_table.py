"""Displacements of nodes into the table of a sweep over elements, and forces out of it."""

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


_table = types.float64[:, ::1]
SIGNATURES = {read_nodes: types.void(types.int64[:, ::1], types.float64, _table, _table)}
