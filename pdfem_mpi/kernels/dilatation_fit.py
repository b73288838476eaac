"""Fitted weights of the dilatation: sums over the bonds for the nine equations of every point, and writing the weights.

Each bond has two weights, ``a_i`` in the dilatation of its first point and ``a_j`` in that of the other (see
`peridynamics.fit.dilatation`). With ``n`` the unit vector of a bond, ``xi = r n`` and ``k`` its force per stretch::

    sum_j k_ij a_i r n n    six equations of a point      sum_j k_ij (a_i + a_j) n    three

The weights of smallest change from 1 have nine multipliers a point, a symmetric tensor ``P`` and a vector ``v``::

    a_i = 1 + [xi . P_i . xi + xi . (v_i - v_j)] / r,        a_j = 1 + [xi . P_j . xi + xi . (v_i - v_j)] / r

**Table.** As that of `bond_moments`: rows 0-2 positions, 3-8 ``P`` (xx, yy, zz, and sqrt(2) times yz, zx, xy), 9-11
``v``, 12-20 sums. Rows of weights hold four ``a_i`` and four ``a_j``.
"""

import math

import numpy as np
from numba import njit, types

from pdfem_mpi.kernels.bond_response import AHEAD
from pdfem_mpi.kernels.simd import (
    W,
    above,
    both,
    fma,
    iadd,
    ihsum,
    isub,
    largest,
    load,
    magnitude,
    prefetch,
    root,
    splat,
    store,
)

#: Equations of a point, rows of the table, entries of a point's symmetric block.
N, ROWS, ENTRIES = 9, 27, 45
#: Smallest squared length of a bond; slots without a bond may have none at all.
TINY = 1e-12
_ROOT = math.sqrt(2.0)

_options = {"cache": True, "nogil": True, "boundscheck": False, "error_model": "numpy"}


@njit(inline="always")
def _stored(row_data, row, finite):
    """``k / r^3`` of the slots of a row."""
    if finite:
        prefetch(row_data, row * 2 * W + AHEAD)
        k = load(row_data, row * 2 * W)
        return (k + k) * load(row_data, row * 2 * W + W)
    prefetch(row_data, row * W + AHEAD)
    return load(row_data, row * W)


@njit(inline="always")
def _quadratic(T, place, wide, q):
    """``xi . P . xi`` of a point (wide: of the four of a cluster)."""
    s = splat(0.0)
    for a in range(6):
        p = load(T, place + (3 + a) * W) if wide else splat(T[place + (3 + a) * W])
        s = fma(p, q[a], s)
    return s


@njit(**_options)
def add_divergences(row_start, row_offset, row_data, T, TI, pattern, finite, weights, products, nearest):
    """Add the nine sums of every bond to both of its points: those of the weights, or their change with multipliers.

    Parameters
    ----------
    row_start, row_offset, row_data
        Rows as in the sweeps.
    T, TI : float64, int64, shape (n_clusters * 108,)
    pattern : float
        ``M`` of the quantum.
    finite : bool
    weights : float32, shape ((n_rows + 1) * 8,)
    products : bool
        The change with the multipliers of the table, and not the sums of ``weights``.
    nearest : float, dimension length^2
        Of the change: bonds whose squared length is below take no part.
    """
    M = splat(pattern)
    zero = splat(0.0)
    two = splat(_ROOT)
    for i in range(row_start.size - 1):
        c = i // W
        own = c * ROWS * W + (i - c * W)
        s0, s1, s2, s3, s4, s5, s6, s7, s8 = zero, zero, zero, zero, zero, zero, zero, zero, zero
        for row in range(row_start[i], row_start[i + 1]):
            b = 3 * np.int64(row_offset[row])
            x = load(T, b) - splat(T[own])
            y = load(T, b + W) - splat(T[own + W])
            z = load(T, b + 2 * W) - splat(T[own + 2 * W])
            r2 = largest(fma(x, x, fma(y, y, z * z)), splat(TINY))
            q = (x * x, y * y, z * z, two * (y * z), two * (z * x), two * (x * y))
            k = _stored(row_data, row, finite)
            if products:
                k = both(magnitude(k), above(r2, splat(nearest))) * root(r2)
                along = x * (splat(T[own + 9 * W]) - load(T, b + 9 * W))
                along = fma(y, splat(T[own + 10 * W]) - load(T, b + 10 * W), along)
                along = fma(z, splat(T[own + 11 * W]) - load(T, b + 11 * W), along)
                here = k * (_quadratic(T, own, False, q) + along)
                there = k * (_quadratic(T, b, True, q) + along)
            else:
                here = k * r2 * load(weights, row * 2 * W)
                there = k * r2 * load(weights, row * 2 * W + W)
            total = here + there
            s0 = iadd(s0, fma(here, q[0], M))
            s1 = iadd(s1, fma(here, q[1], M))
            s2 = iadd(s2, fma(here, q[2], M))
            s3 = iadd(s3, fma(here, q[3], M))
            s4 = iadd(s4, fma(here, q[4], M))
            s5 = iadd(s5, fma(here, q[5], M))
            px = fma(total, x, M)
            py = fma(total, y, M)
            pz = fma(total, z, M)
            s6 = iadd(s6, px)
            s7 = iadd(s7, py)
            s8 = iadd(s8, pz)
            for a in range(6):
                store(T, b + (12 + a) * W, iadd(load(T, b + (12 + a) * W), fma(there, q[a], M)))
            store(T, b + 18 * W, isub(load(T, b + 18 * W), px))
            store(T, b + 19 * W, isub(load(T, b + 19 * W), py))
            store(T, b + 20 * W, isub(load(T, b + 20 * W), pz))
        TI[own + 12 * W] += ihsum(s0)
        TI[own + 13 * W] += ihsum(s1)
        TI[own + 14 * W] += ihsum(s2)
        TI[own + 15 * W] += ihsum(s3)
        TI[own + 16 * W] += ihsum(s4)
        TI[own + 17 * W] += ihsum(s5)
        TI[own + 18 * W] += ihsum(s6)
        TI[own + 19 * W] += ihsum(s7)
        TI[own + 20 * W] += ihsum(s8)


@njit(**_options)
def add_divergence_blocks(row_start, row_offset, row_data, x, quantum, finite, nearest, sums):
    """Add the diagonal blocks of the change with the multipliers, upper triangles row by row, of every bond.

    Parameters
    ----------
    row_start, row_offset, row_data, finite, nearest
        As of `add_divergences`.
    x : float64, shape (n_clusters * 12,), dimension length
    quantum : float
        Terms are rounded to multiples of it.
    sums : int64, shape (n_clusters * 180,)
        ``[cluster][entry][lane]``; added to.
    """
    stride = 2 * W if finite else W
    u = np.empty(N)
    for i in range(row_start.size - 1):
        for row in range(row_start[i], row_start[i + 1]):
            for lane in range(W):
                k = np.float64(row_data[row * stride + lane])
                if k == 0.0:
                    continue
                if finite:
                    k = 2.0 * k * np.float64(row_data[row * stride + W + lane])
                j = np.int64(row_offset[row]) // 9 + lane
                r2 = 0.0
                for d in range(3):
                    u[6 + d] = x[12 * (j // W) + W * d + j % W] - x[12 * (i // W) + W * d + i % W]
                    u[d] = u[6 + d] * u[6 + d]
                    r2 += u[d]
                if r2 <= nearest:
                    continue
                u[3], u[4], u[5] = _ROOT * u[7] * u[8], _ROOT * u[8] * u[6], _ROOT * u[6] * u[7]
                k = abs(k) * math.sqrt(r2) / quantum
                entry = 0
                for a in range(N):
                    for b in range(a, N):
                        term = np.int64(np.rint(k * (u[a] * u[b])))
                        vectors = (a >= 6) + (b >= 6)
                        here = 2 * term if vectors == 2 else term
                        there = -term if vectors == 1 else here
                        sums[180 * (i // W) + W * entry + i % W] += here
                        sums[180 * (j // W) + W * entry + j % W] += there
                        entry += 1


@njit(**_options)
def write_weights(row_start, row_offset, row_data, T, finite, nearest, weights):
    """Add the change that the multipliers of the table make to the weights of bonds longer than ``sqrt(nearest)``.

    Parameters are those of `add_divergences`.

    Returns
    -------
    float
        The largest magnitude of a weight.
    """
    stride = 2 * W if finite else W
    q = np.empty(6)
    top = 0.0
    for i in range(row_start.size - 1):
        c = i // W
        own = c * ROWS * W + (i - c * W)
        for row in range(row_start[i], row_start[i + 1]):
            for lane in range(W):
                if row_data[row * stride + lane] == 0:
                    continue
                b = 3 * np.int64(row_offset[row]) + lane
                x = T[b] - T[own]
                y = T[b + W] - T[own + W]
                z = T[b + 2 * W] - T[own + 2 * W]
                r2 = x * x + (y * y + z * z)
                place = row * 2 * W + lane
                if r2 > nearest:
                    q[0], q[1], q[2] = x * x, y * y, z * z
                    q[3], q[4], q[5] = _ROOT * y * z, _ROOT * z * x, _ROOT * x * y
                    along = x * (T[own + 9 * W] - T[b + 9 * W]) + y * (T[own + 10 * W] - T[b + 10 * W])
                    along += z * (T[own + 11 * W] - T[b + 11 * W])
                    here = along
                    there = along
                    for a in range(6):
                        here += T[own + (3 + a) * W] * q[a]
                        there += T[b + (3 + a) * W] * q[a]
                    r = math.copysign(math.sqrt(r2), row_data[row * stride + lane])
                    weights[place] += here / r
                    weights[place + W] += there / r
                top = max(top, abs(np.float64(weights[place])), abs(np.float64(weights[place + W])))
    return top


_f8, _i8, _real, _flag = types.float64[::1], types.int64[::1], types.float64, types.boolean
_f4 = types.float32[::1]
_rows = (_i8, types.uint32[::1], _f4)
SIGNATURES = {
    add_divergences: types.void(*_rows, _f8, _i8, _real, _flag, _f4, _flag, _real),
    add_divergence_blocks: types.void(*_rows, _f8, _real, _flag, _real, _i8),
    write_weights: _real(*_rows, _f8, _flag, _real, _f4),
}
