"""Dilatations of the peridynamic points beside the sweeps that sum them (`dilatation_sweeps`): their start and end."""

import math

import numpy as np
from numba import njit, types

from pdfem_mpi.kernels.simd import W

_options = {"cache": True, "nogil": True, "boundscheck": False, "error_model": "numpy"}


@njit(**_options)
def start_dilatations(DI, rows_of_point, rows_at_cluster, pattern_bits):
    """Start the sums so that after the sweeps they are multiples of the quantum.

    Parameters
    ----------
    DI : int64, shape (n_clusters * 4,)
        Overwritten.
    rows_of_point, rows_at_cluster : int32, shapes (n_clusters * 4,), (n_clusters,)
        A point's sum receives four terms for each row of its own, and one for each row at its cluster.
    pattern_bits : int
        ``bits(M)``.
    """
    for i in range(DI.size):
        terms = W * np.int64(rows_of_point[i]) + np.int64(rows_at_cluster[i // W])
        DI[i] = -terms * pattern_bits


@njit(**_options)
def make_pressures(D, DI, n_owned, quantum, material, factor, volume):
    """``q_i``, what the forces of a point's bonds have in common, in the place of the sums of the owned points.

    Parameters
    ----------
    D, DI : float64, int64, shape (n_clusters * 4,)
        Views of the sums, overwritten by ``q``.
    n_owned : int
        Owned clusters.
    quantum : float
        Of the sums.
    material : int16, shape (n_clusters,)
    factor : float64, shape (n_materials,)
        ``M / (10 mu)^2`` of each material.
    volume : float64, shape (n_clusters * 4,)

    Returns
    -------
    float
        The largest ``|q|``.
    """
    top = 0.0
    for c in range(n_owned):
        for i in range(W * c, W * c + W):
            D[i] = factor[material[c]] * (quantum * DI[i]) / volume[i]
            top = max(top, abs(D[i]))
    return top


@njit(**_options)
def listed_terms(pairs, strengths, S, finite):
    """``k e`` of listed bonds at the displacements of the table, which need not stand in the rows any more.

    Parameters
    ----------
    pairs, strengths : int64, float32, shape (n, 2)
        Local points, and stored numbers.
    S : float64, shape (n_clusters * 36,)
    finite : bool

    Returns
    -------
    float64, shape (n,), dimension force length
        The same bits from either end of a bond.
    """
    terms = np.empty(pairs.shape[0])
    for t in range(pairs.shape[0]):
        i = 36 * (pairs[t, 0] // W) + pairs[t, 0] % W
        j = 36 * (pairs[t, 1] // W) + pairs[t, 1] % W
        x, y, z = S[j + 3 * W] - S[i + 3 * W], S[j + 4 * W] - S[i + 4 * W], S[j + 5 * W] - S[i + 5 * W]
        work = (S[j] - S[i]) * x + (S[j + W] - S[i + W]) * y + (S[j + 2 * W] - S[i + 2 * W]) * z
        k = np.float64(strengths[t, 0])
        if finite:
            terms[t] = 2.0 * k * work / (1.0 + math.sqrt(max(1.0 + work * np.float64(strengths[t, 1]), 0.0)))
        else:
            terms[t] = k * work * (x * x + y * y + z * z)
    return terms


_f8, _i8, _int, _i2 = types.float64[::1], types.int64[::1], types.int64, types.int16[::1]
SIGNATURES = {
    start_dilatations: types.void(_i8, types.int32[::1], types.int32[::1], _int),
    listed_terms: _f8(types.int64[:, ::1], types.float32[:, ::1], _f8, types.boolean),
    make_pressures: types.float64(_f8, _i8, _int, types.float64, _i2, _f8, _f8),
}
