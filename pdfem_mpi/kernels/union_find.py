"""Connected components by union and find: vertices joined by surviving bonds and by shared cells.

A vertex points to its parent, a root to itself; the smaller index becomes the parent, paths are halved on the way.
"""

import numpy as np
from numba import njit, types

from pdfem_mpi.kernels.simd import W

_options = {"cache": True, "nogil": True, "boundscheck": False, "error_model": "numpy"}


@njit(**_options)
def root_of(parent, vertex):
    """The root of a vertex."""
    while parent[vertex] != vertex:
        parent[vertex] = parent[parent[vertex]]
        vertex = parent[vertex]
    return vertex


@njit(**_options)
def join(parent, a, b):
    """Make one component of those of two vertices."""
    a, b = root_of(parent, a), root_of(parent, b)
    if a < b:
        parent[b] = a
    else:
        parent[a] = b


@njit(**_options)
def join_bonds(row_start, row_offset, row_data, stride, parent, bonded):
    """Join the two points of every surviving bond.

    Parameters
    ----------
    row_start, row_offset, row_data
        Rows as in the sweeps.
    stride : int
        Stored numbers a row.
    parent : int64, shape (n_vertices,)
        Points first, by cluster and lane; overwritten.
    bonded : int64, shape (n_points,)
        Set to 1 at both points.
    """
    for i in range(row_start.size - 1):
        for row in range(row_start[i], row_start[i + 1]):
            first = np.int64(row_offset[row]) // 9
            for lane in range(W):
                if row_data[row * stride + lane] != 0.0:
                    bonded[i] = 1
                    bonded[first + lane] = 1
                    if parent[first + lane] != parent[i]:
                        join(parent, i, first + lane)


@njit(**_options)
def join_rows(rows, parent):
    """Join the vertices of each row; those below 0 are left out.

    Parameters
    ----------
    rows : int64, shape (n, k)
    parent : int64, shape (n_vertices,)
        Overwritten.
    """
    for row in rows:
        first = np.int64(-1)  # not the literal, for which numba would compile `join` once more
        for vertex in row:
            if vertex >= 0:
                if first >= 0:
                    join(parent, first, vertex)
                first = vertex


@njit(**_options)
def spread_smallest(parent, label):
    """Give every vertex the smallest label of its component; int64 arrays of shape (n_vertices,)."""
    for vertex in range(parent.size):
        root = root_of(parent, vertex)
        label[root] = min(label[root], label[vertex])
    for vertex in range(parent.size):
        label[vertex] = label[root_of(parent, vertex)]


_i8, _int = types.int64[::1], types.int64
SIGNATURES = {
    join_bonds: types.void(_i8, types.uint32[::1], types.float32[::1], _int, _i8, _i8),
    join_rows: types.void(types.int64[:, ::1], _i8),
    spread_smallest: types.void(_i8, _i8),
}
