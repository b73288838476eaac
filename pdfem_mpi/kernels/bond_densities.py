"""Sums over the bonds of the points that are made once: fictitious densities, eq. (11), and those of dilatations."""

import numpy as np
from numba import njit, types

from pdfem_mpi.kernels.bond_response import AHEAD
from pdfem_mpi.kernels.simd import W, fma, iadd, ihsum, load, magnitude, prefetch, root, splat, store

_options = {"cache": True, "nogil": True, "boundscheck": False, "error_model": "numpy"}


@njit(**_options)
def add_densities(row_start, row_offset, row_data, S, SI, pattern, finite, stiffening):
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
    stiffening : float64, shape (n_clusters * 4,) or (0,)
        ``h``: with a volumetric part bonds count ``1 + r0 (h_i + h_j)`` times.
    """
    M = splat(pattern)
    one = splat(1.0)
    stiffens = stiffening.size > 0
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
            prefetch(row_data, row * stride + AHEAD)
            k = magnitude(load(row_data, row * stride))  # fitted factors may be negative
            if finite:
                k = k * root(load(row_data, row * stride + W))
            else:
                k = half * k * root(fma(dx, dx, fma(dy, dy, dz * dz)))
            if stiffens:
                growth = root(fma(dx, dx, fma(dy, dy, dz * dz))) * (splat(stiffening[i]) + load(stiffening, b // 9))
                k = k * (one + growth)
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


@njit(**_options)
def add_family_sums(row_start, row_offset, row_data, S, SI, pattern, finite):
    """Add ``k`` and ``k r0`` of each bond to both of its points, in rows 6 and 7.

    ``k = c exp(-r0^2) g_ij w_i w_j``; of bonds of negative stiffness the magnitude counts. Parameters are those of
    `add_densities`.
    """
    M = splat(pattern)
    stride = 2 * W if finite else W
    for i in range(row_start.size - 1):
        c = i // W
        own = c * 9 * W + (i - c * W)
        first = splat(0.0)
        second = splat(0.0)
        third = splat(0.0)
        for row in range(row_start[i], row_start[i + 1]):
            b = np.int64(row_offset[row])
            dx = load(S, b + 3 * W) - splat(S[own + 3 * W])
            dy = load(S, b + 4 * W) - splat(S[own + 4 * W])
            dz = load(S, b + 5 * W) - splat(S[own + 5 * W])
            square = fma(dx, dx, fma(dy, dy, dz * dz))
            r = root(square)
            prefetch(row_data, row * stride + AHEAD)
            k = magnitude(load(row_data, row * stride)) * r
            k = k + k if finite else k * square
            p = k + M
            q = k * r + M
            first = iadd(first, p)
            second = iadd(second, q)
            third = iadd(third, M)
            store(S, b + 6 * W, iadd(load(S, b + 6 * W), p))
            store(S, b + 7 * W, iadd(load(S, b + 7 * W), q))
            store(S, b + 8 * W, iadd(load(S, b + 8 * W), M))
        SI[own + 6 * W] += ihsum(first)
        SI[own + 7 * W] += ihsum(second)
        SI[own + 8 * W] += ihsum(third)


_f8, _i8, _real, _flag = types.float64[::1], types.int64[::1], types.float64, types.boolean
_rows = (_i8, types.uint32[::1], types.float32[::1])
SIGNATURES = {
    add_densities: types.void(*_rows, _f8, _i8, _real, _flag, _f8),
    add_family_sums: types.void(*_rows, _f8, _i8, _real, _flag),
}
