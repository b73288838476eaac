"""Fictitious densities of the points, eq. (11): sums over their bonds."""

import numpy as np
from numba import njit, types

from pdfem_mpi.kernels.simd import W, fma, iadd, ihsum, load, magnitude, root, splat, store

_options = {"cache": True, "nogil": True, "boundscheck": False, "error_model": "numpy"}


@njit(**_options)
def add_densities(row_start, row_offset, row_data, S, SI, pattern, finite):
    """Add each bond's share of the fictitious mass (eq. 11, with g_ij in it) to both points.

    Component d of a point receives ``1/2 c exp(-r0^2) g_ij w_i w_j |n_d| / r0`` from each of its bonds; the largest of
    the three sums is ``lambda_i w_i``.

    Parameters
    ----------
    row_start, row_offset, row_data
        Rows as in the sweeps.
    S, SI : float64, int64, shape (n_clusters * 36,)
        Positions in rows 3-5; patterns are added to rows 6-8.
    pattern : float
        ``M``; each term must stay below ``2**51`` quanta.
    finite : bool
    """
    M = splat(pattern)
    half = splat(0.5)
    stride = 2 * W if finite else W
    for i in range(row_start.size - 1):
        c = i // W
        own = c * 9 * W + (i - c * W)
        sx = splat(0.0)
        sy = splat(0.0)
        sz = splat(0.0)
        for row in range(row_start[i], row_start[i + 1]):
            b = np.int64(row_offset[row])
            dx = magnitude(load(S, b + 3 * W) - splat(S[own + 3 * W]))
            dy = magnitude(load(S, b + 4 * W) - splat(S[own + 4 * W]))
            dz = magnitude(load(S, b + 5 * W) - splat(S[own + 5 * W]))
            k = magnitude(load(row_data, row * stride))  # fitted factors may be negative
            if finite:
                k = k * root(load(row_data, row * stride + W))
            else:
                k = half * k * root(fma(dx, dx, fma(dy, dy, dz * dz)))
            px = fma(k, dx, M)
            py = fma(k, dy, M)
            pz = fma(k, dz, M)
            sx = iadd(sx, px)
            sy = iadd(sy, py)
            sz = iadd(sz, pz)
            store(S, b + 6 * W, iadd(load(S, b + 6 * W), px))
            store(S, b + 7 * W, iadd(load(S, b + 7 * W), py))
            store(S, b + 8 * W, iadd(load(S, b + 8 * W), pz))
        SI[own + 6 * W] += ihsum(sx)
        SI[own + 7 * W] += ihsum(sy)
        SI[own + 8 * W] += ihsum(sz)


_f8, _i8 = types.float64[::1], types.int64[::1]
SIGNATURES = {
    add_densities: types.void(_i8, types.uint32[::1], types.float32[::1], _f8, _i8, types.float64, types.boolean),
}
