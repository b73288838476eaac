"""Displacements into the table of the points, and forces out of it; the table is that of `bond_forces`."""

import numpy as np
from numba import njit, types

from pdfem_mpi.kernels.simd import W, load, splat, store

_options = {"cache": True, "nogil": True, "boundscheck": False, "error_model": "numpy"}


@njit(**_options)
def load_displacements(u, x, S, n_clusters, finite):
    """Write ``u`` into rows 0-2 of the first clusters and, for finite kinematics, ``z = 2 x + u`` into rows 3-5.

    Parameters
    ----------
    u : float64, shape (n_clusters * 12,), dimension length
        Cluster layout.
    x : float64, shape (>= n_clusters * 12,), dimension length
    S : float64, shape (>= n_clusters * 36,)
    """
    two = splat(2.0)
    for c in range(n_clusters):
        for k in range(0, 3 * W, W):
            v = load(u, 12 * c + k)
            store(S, 36 * c + k, v)
            if finite:
                store(S, 36 * c + 12 + k, two * load(x, 12 * c + k) + v)


@njit(**_options)
def complete_z(first, last, x, S):
    """``z = 2 x + u`` for the clusters ``first:last`` whose ``u`` came from elsewhere (overlap, ghosts)."""
    two = splat(2.0)
    for c in range(first, last):
        for k in range(0, 3 * W, W):
            store(S, 36 * c + 12 + k, two * load(x, 12 * c + k) + load(S, 36 * c + k))


@njit(**_options)
def start_evaluation(u, x, S, SI, finite, excess, pattern_bits):
    """`load_displacements` of free clusters, and start the forces of all so that they become multiples of the quantum.

    A row adds ``bits(M)`` four times to its point and takes it once from each point of its cluster; the start value
    takes these patterns back. One pass: what the two write of a cluster stands side by side in memory.

    Parameters
    ----------
    u : float64, shape (n_free_clusters * 12,), dimension length
    x, S, finite
        As of `load_displacements`.
    SI : int64, shape (n_clusters * 36,)
        The table as integers; rows 6-8 are overwritten.
    excess : int64, shape (n_clusters * 4,)
        Patterns added minus patterns taken, by point.
    pattern_bits : int
        ``bits(M)``.
    """
    two = splat(2.0)
    for c in range(excess.size // W):
        if 12 * c < u.size:
            for k in range(0, 3 * W, W):
                v = load(u, 12 * c + k)
                store(S, 36 * c + k, v)
                if finite:
                    store(S, 36 * c + 12 + k, two * load(x, 12 * c + k) + v)
        for k in range(W):
            start = np.int64(-excess[W * c + k]) * pattern_bits
            SI[36 * c + 6 * W + k] = start
            SI[36 * c + 7 * W + k] = start
            SI[36 * c + 8 * W + k] = start


@njit(**_options)
def read_forces(SI, quantum, external, force):
    """Residual force of the first clusters, ``external + quantum * integers`` (eq. 14, times the volumes).

    Parameters
    ----------
    SI : int64, shape (n_clusters * 36,)
    quantum : float, dimension force
    external, force : float64, shape (n_free_clusters * 12,), dimension force
        Cluster layout; ``force`` is overwritten.
    """
    for c in range(force.size // 12):
        for k in range(3 * W):
            force[12 * c + k] = external[12 * c + k] + quantum * SI[36 * c + 24 + k]


_f8, _i8, _int = types.float64[::1], types.int64[::1], types.int64
SIGNATURES = {
    load_displacements: types.void(_f8, _f8, _f8, _int, types.boolean),
    complete_z: types.void(_int, _int, _f8, _f8),
    start_evaluation: types.void(_f8, _f8, _f8, _i8, types.boolean, _i8, _int),
    read_forces: types.void(_i8, types.float64, _f8, _f8),
}
