"""Surface corrections of appendix A and by the virial stress: one sweep of the iteration for the correction vectors.

Each point has a vector ``g_c`` (A11), initially 1. A bond's factor is the ellipsoid (A8) at the mean of its two points'
vectors (A10). Loading the body by three uniaxial tensions (A1) gives each point three forces ``G_d``; the update
``g_c,d *= g_inf / G_d`` is repeated twenty times.

With ``gamma = (g_c(i) + g_c(j)) / 2``, the factor needs no unit vector::

    g_ij = r / sqrt(sum_d (xi_d / gamma_d)^2)                                   (A8)
    w_i G_d(i) = sum_j c exp(-r^2) g_ij w_i w_j |n_d| s_d,  s_d = (1 + nu) n_d^2 - nu    (A2)-(A4)

(A2 prints "2" for the interior value, which has no meaning; the sum above is its definition.)

**Virial.** Appendix A matches a first moment of the bonds, while stiffness is a third moment; on the Gauss lattice
the two differ by 6 %. With ``r n_d^2 / 2`` in place of ``|n_d|`` the same sum is a virial stress, ``w_i S_d(i) =
sum_j c exp(-r^2) g_ij w_i w_j (r n_d^2 / 2) s_d``, whose value in an infinite body is Young's modulus.
"""

import math

import numpy as np
from numba import njit, types

from pdfem_mpi.kernels.bond_response import AHEAD
from pdfem_mpi.kernels.simd import W, fma, iadd, ihsum, largest, load, magnitude, prefetch, root, splat, store

#: Sweeps of the iteration (appendix A: "approximately twenty iterations").
SWEEPS = 20
#: Force density per unit displacement gradient of a point in an infinite body, in units of ``k / l``:
#: ``9 (1 - nu) sqrt(pi) / 4``, the closed form of eq. (A5) without cutoff.
INFINITE_RESPONSE = 9 * (1 - 0.25) * math.sqrt(math.pi) / 4
_NU = 0.25


@njit(cache=True, nogil=True, boundscheck=False, error_model="numpy")
def add_responses(row_start, row_offset, row_data, T, TI, pattern, finite, virial):
    """Add ``w_i G_d(i)``, or the virial stress, of every bond of the rows to both of its points.

    Parameters
    ----------
    row_start, row_offset : int64 (n_points + 1,), uint32 (n_rows + 1,)
    row_data : float32, shape ((n_rows + 1) * (8 if finite else 4),)
        Stored numbers of `fill_rows` without correction (``g_ij = 1``).
    T, TI : float64, int64, shape (n_clusters * 36,)
        Rows 0-2 ``g_c``, rows 3-5 positions / l, rows 6-8 the sums as bit patterns (added to).
    pattern : float
        ``M = 1.5 * 2**52 * quantum``; a term is at most ``g_ij c exp(-r^2) w_i w_j``, times ``r / 2`` for the virial
        stress, and must stay below 2**51 quanta.
    finite : bool
        Layout of ``row_data``.
    virial : bool
        The measure: ``r n_d^2 / 2``, else ``|n_d|``.
    """
    M = splat(pattern)
    half = splat(0.5)
    tiny = splat(1e-300)
    more = splat(1 + _NU)
    stride = 2 * W if finite else W
    for i in range(row_start.size - 1):
        c = i // W
        own = c * 9 * W + (i - c * W)
        ax = splat(T[own])
        ay = splat(T[own + W])
        az = splat(T[own + 2 * W])
        sx = splat(0.0)
        sy = splat(0.0)
        sz = splat(0.0)
        for row in range(row_start[i], row_start[i + 1]):
            b = np.int64(row_offset[row])
            dx = magnitude(load(T, b + 3 * W) - splat(T[own + 3 * W]))
            dy = magnitude(load(T, b + 4 * W) - splat(T[own + 4 * W]))
            dz = magnitude(load(T, b + 5 * W) - splat(T[own + 5 * W]))
            qx = dx * dx
            qy = dy * dy
            qz = dz * dz
            r2 = largest(qx + qy + qz, tiny)
            gx = half * (load(T, b) + ax)
            gy = half * (load(T, b + W) + ay)
            gz = half * (load(T, b + 2 * W) + az)
            # sum_d (xi_d / gamma_d)^2 over the common denominator (gx gy gz)^2
            yz = gy * gz
            xz = gx * gz
            xy = gx * gy
            numerator = largest(fma(qx * yz, yz, fma(qy * xz, xz, (qz * xy) * xy)), tiny)
            prefetch(row_data, row * stride + AHEAD)
            k = load(row_data, row * stride)
            if finite:
                k = k + k  # c exp w w / r
            else:
                k = k * r2
            k = k * (xy * gz) * root(r2 / numerator)
            inverse = splat(1.0) / r2
            if virial:
                dx, dy, dz = half * qx, half * qy, half * qz
            px = fma(k * dx, fma(more * qx, inverse, splat(-_NU)), M)
            py = fma(k * dy, fma(more * qy, inverse, splat(-_NU)), M)
            pz = fma(k * dz, fma(more * qz, inverse, splat(-_NU)), M)
            sx = iadd(sx, px)
            sy = iadd(sy, py)
            sz = iadd(sz, pz)
            store(T, b + 6 * W, iadd(load(T, b + 6 * W), px))
            store(T, b + 7 * W, iadd(load(T, b + 7 * W), py))
            store(T, b + 8 * W, iadd(load(T, b + 8 * W), pz))
        TI[own + 6 * W] += ihsum(sx)
        TI[own + 7 * W] += ihsum(sy)
        TI[own + 8 * W] += ihsum(sz)


@njit(cache=True, nogil=True, boundscheck=False, error_model="numpy")
def update_factors(n_clusters, T, TI, volume, quantum, target):
    """Multiply the correction vectors by ``g_inf / G`` (A11); a direction without response keeps its factor.

    Parameters
    ----------
    n_clusters : int
        Owned clusters, which come first.
    T, TI : float64, int64, shape (n_clusters * 36,)
        Rows 0-2 are updated from the integer sums in rows 6-8.
    volume : float64, shape (n_clusters * 4,)
        Integration weights ``w_i``.
    quantum : float
    target : float64, shape (n_clusters,)
        ``g_inf``, or Young's modulus, of each cluster's own material, in model units: the fictitious body of
        appendix A is made of it.

    Returns
    -------
    float
        Largest ``|G / g_inf - 1|`` before the update.
    """
    worst = 0.0
    for c in range(n_clusters):
        for d in range(3):
            for k in range(W):
                response = quantum * TI[36 * c + W * (6 + d) + k] / volume[W * c + k]
                if response > 0:
                    worst = max(worst, abs(response / target[c] - 1))
                    T[36 * c + W * d + k] *= target[c] / response
    return worst


_f8, _i8 = types.float64[::1], types.int64[::1]
SIGNATURES = {
    add_responses: types.void(
        _i8, types.uint32[::1], types.float32[::1], _f8, _i8, types.float64, types.boolean, types.boolean
    ),
    update_factors: types.float64(types.int64, _f8, _i8, _f8, types.float64, _f8),
}
