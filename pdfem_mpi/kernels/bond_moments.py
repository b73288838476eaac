"""Fitted bond factors: sums over the bonds for the ten moments of every point, and writing the factors.

With ``n`` the unit vector of a bond and ``xi = r n``, a point's bonds balance every uniform strain when ten moments
of the bond strengths ``k_ij = c exp(-r^2) w_i w_j g_ij`` have given values::

    sum_j k_ij t_a(n_ij) = b_a(i),        t = (xxx, xxy, xxz, xyy, xyz, xzz, yyy, yyz, yzz, zzz)

The factors of smallest weighted change from 1 are ``g_ij = 1 + (v_i - v_j) . t(xi) / r^4`` with ten multipliers a
point, each monomial counted as often as it occurs in the symmetric tensor (`MULTIPLICITY`).

**Table.** ``T[cluster][27][4]``: rows 0-2 positions, 3-12 multipliers, 13-22 sums as bit patterns, the rest unused; a
row's cluster starts at three times the offset of the sweeps' table. Rows hold the numbers of `families.fill_rows`;
while positive factors are sought, the sign bit of a stored number marks a bond whose factor is held at 0.
"""

import math

import numpy as np
from numba import njit, types

from pdfem_mpi.kernels.bond_response import AHEAD
from pdfem_mpi.kernels.monomials import N
from pdfem_mpi.kernels.simd import (
    W,
    above,
    both,
    fma,
    hmax,
    iadd,
    ihsum,
    isub,
    lanes,
    largest,
    load,
    magnitude,
    prefetch,
    root,
    splat,
    store,
)  # fmt: skip

#: Rows of the table.
ROWS = 27
#: Smallest squared length of a bond; slots without a bond may have none at all.
TINY = 1e-12

_options = {"cache": True, "nogil": True, "boundscheck": False, "error_model": "numpy"}


@njit(inline="always")
def _monomials(x, y, z):
    """The ten monomials of degree three."""
    xx = x * x
    yy = y * y
    zz = z * z
    return xx * x, xx * y, xx * z, x * yy, (x * y) * z, x * zz, yy * y, yy * z, y * zz, zz * z


@njit(inline="always")
def _difference(T, own, b, t):
    """``(v_i - v_j) . t``."""
    p = (splat(T[own + 3 * W]) - load(T, b + 3 * W)) * t[0]
    q = (splat(T[own + 4 * W]) - load(T, b + 4 * W)) * t[1]
    p = fma(splat(T[own + 5 * W]) - load(T, b + 5 * W), t[2], p)
    q = fma(splat(T[own + 6 * W]) - load(T, b + 6 * W), t[3], q)
    p = fma(splat(T[own + 7 * W]) - load(T, b + 7 * W), t[4], p)
    q = fma(splat(T[own + 8 * W]) - load(T, b + 8 * W), t[5], q)
    p = fma(splat(T[own + 9 * W]) - load(T, b + 9 * W), t[6], p)
    q = fma(splat(T[own + 10 * W]) - load(T, b + 10 * W), t[7], q)
    p = fma(splat(T[own + 11 * W]) - load(T, b + 11 * W), t[8], p)
    q = fma(splat(T[own + 12 * W]) - load(T, b + 12 * W), t[9], q)
    return p + q


@njit(inline="always")
def _stored(row_data, row, finite):
    """``k / r^3`` of the slots of a row (with its mark as a sign)."""
    if finite:
        prefetch(row_data, row * 2 * W + AHEAD)
        k = load(row_data, row * 2 * W)
        return (k + k) * load(row_data, row * 2 * W + W)
    prefetch(row_data, row * W + AHEAD)
    return load(row_data, row * W)


@njit(inline="always")
def _squared(x, y, z):
    return largest(fma(x, x, fma(y, y, z * z)), splat(TINY))


@njit(inline="always")
def _scatter(T, b, s, t, M, own, symmetric):
    """Add ``s t`` to the sums of the point, and add it to those of the row's cluster or take it from them."""
    p0 = fma(s, t[0], M)
    p1 = fma(s, t[1], M)
    p2 = fma(s, t[2], M)
    p3 = fma(s, t[3], M)
    p4 = fma(s, t[4], M)
    p5 = fma(s, t[5], M)
    p6 = fma(s, t[6], M)
    p7 = fma(s, t[7], M)
    p8 = fma(s, t[8], M)
    p9 = fma(s, t[9], M)
    if symmetric:
        store(T, b + 13 * W, iadd(load(T, b + 13 * W), p0))
        store(T, b + 14 * W, iadd(load(T, b + 14 * W), p1))
        store(T, b + 15 * W, iadd(load(T, b + 15 * W), p2))
        store(T, b + 16 * W, iadd(load(T, b + 16 * W), p3))
        store(T, b + 17 * W, iadd(load(T, b + 17 * W), p4))
        store(T, b + 18 * W, iadd(load(T, b + 18 * W), p5))
        store(T, b + 19 * W, iadd(load(T, b + 19 * W), p6))
        store(T, b + 20 * W, iadd(load(T, b + 20 * W), p7))
        store(T, b + 21 * W, iadd(load(T, b + 21 * W), p8))
        store(T, b + 22 * W, iadd(load(T, b + 22 * W), p9))
    else:
        store(T, b + 13 * W, isub(load(T, b + 13 * W), p0))
        store(T, b + 14 * W, isub(load(T, b + 14 * W), p1))
        store(T, b + 15 * W, isub(load(T, b + 15 * W), p2))
        store(T, b + 16 * W, isub(load(T, b + 16 * W), p3))
        store(T, b + 17 * W, isub(load(T, b + 17 * W), p4))
        store(T, b + 18 * W, isub(load(T, b + 18 * W), p5))
        store(T, b + 19 * W, isub(load(T, b + 19 * W), p6))
        store(T, b + 20 * W, isub(load(T, b + 20 * W), p7))
        store(T, b + 21 * W, isub(load(T, b + 21 * W), p8))
        store(T, b + 22 * W, isub(load(T, b + 22 * W), p9))
    return (
        iadd(own[0], p0),
        iadd(own[1], p1),
        iadd(own[2], p2),
        iadd(own[3], p3),
        iadd(own[4], p4),
        iadd(own[5], p5),
        iadd(own[6], p6),
        iadd(own[7], p7),
        iadd(own[8], p8),
        iadd(own[9], p9),
    )


@njit(inline="always")
def _add_own(TI, own, sums):
    """Add the lanes of a point's ten sums to the table."""
    TI[own + 13 * W] += ihsum(sums[0])
    TI[own + 14 * W] += ihsum(sums[1])
    TI[own + 15 * W] += ihsum(sums[2])
    TI[own + 16 * W] += ihsum(sums[3])
    TI[own + 17 * W] += ihsum(sums[4])
    TI[own + 18 * W] += ihsum(sums[5])
    TI[own + 19 * W] += ihsum(sums[6])
    TI[own + 20 * W] += ihsum(sums[7])
    TI[own + 21 * W] += ihsum(sums[8])
    TI[own + 22 * W] += ihsum(sums[9])


@njit(**_options)
def add_normal_products(row_start, row_offset, row_data, T, TI, pattern, finite, held, nearest):
    """Add ``sum_j kappa_ij [(v_i - v_j) . t(xi)] t(xi)``, ``kappa = k / r^7``, of every bond to both of its points.

    Parameters
    ----------
    row_start, row_offset : int64 (n_points + 1,), uint32 (n_rows + 1,)
    row_data : float32, shape ((n_rows + 1) * (8 if finite else 4),)
        Their sizes are the weights of the bonds.
    T, TI : float64, int64, shape (n_clusters * 108,)
        Sums are added to.
    pattern : float
        ``M``; a term is at most ``k / r |v_i - v_j|`` in the norm that counts multiplicities.
    finite : bool
        Layout of ``row_data``.
    held : float
        Weight of bonds whose stored numbers are negative, relative to that of others.
    nearest : float, dimension length^2
        Bonds whose squared length is below take no part.
    """
    M = splat(pattern)
    zero = splat(0.0)
    for i in range(row_start.size - 1):
        c = i // W
        own = c * ROWS * W + (i - c * W)
        sums = (zero, zero, zero, zero, zero, zero, zero, zero, zero, zero)
        for row in range(row_start[i], row_start[i + 1]):
            b = 3 * np.int64(row_offset[row])
            x = load(T, b) - splat(T[own])
            y = load(T, b + W) - splat(T[own + W])
            z = load(T, b + 2 * W) - splat(T[own + 2 * W])
            r2 = _squared(x, y, z)
            t = _monomials(x, y, z)
            k = _stored(row_data, row, finite)
            k = both(largest(k, splat(-held) * k), above(r2, splat(nearest)))
            s = _difference(T, own, b, t) * (k / (r2 * r2))
            sums = _scatter(T, b, s, t, M, sums, False)
        _add_own(TI, own, sums)


@njit(**_options)
def add_moments(row_start, row_offset, row_data, T, TI, pattern, finite, bounded, peak):
    """Add the ten moments ``sum_j k_ij g_ij t(n_ij)`` with ``g_ij = 1 + (v_i - v_j) . t(xi) / r^4``.

    Parameters are those of `add_normal_products`, and

    Parameters
    ----------
    pattern : float
        ``M``; a term is at most ``k g``.
    bounded : bool
        Factors below 0 are 0, and their bonds marked: the sign bits of ``row_data`` are overwritten.
    peak : float64, shape (1,)
        Raised to the largest ``|k g|``.
    """
    M = splat(pattern)
    zero = splat(0.0)
    top = splat(peak[0])
    stride = 2 * W if finite else W
    for i in range(row_start.size - 1):
        c = i // W
        own = c * ROWS * W + (i - c * W)
        sums = (zero, zero, zero, zero, zero, zero, zero, zero, zero, zero)
        for row in range(row_start[i], row_start[i + 1]):
            b = 3 * np.int64(row_offset[row])
            x = load(T, b) - splat(T[own])
            y = load(T, b + W) - splat(T[own + W])
            z = load(T, b + 2 * W) - splat(T[own + 2 * W])
            r2 = _squared(x, y, z)
            t = _monomials(x, y, z)
            g = splat(1.0) + _difference(T, own, b, t) / (r2 * r2)
            if bounded:
                below = lanes(g)
                g = largest(g, zero)
                for lane in range(W):
                    k1 = abs(row_data[row * stride + lane])
                    row_data[row * stride + lane] = -k1 if (below >> lane) & 1 else k1
            k = _stored(row_data, row, finite)
            s = (magnitude(k) if bounded else k) * g
            top = largest(magnitude(s) * (r2 * root(r2)), top)
            sums = _scatter(T, b, s, t, M, sums, False)
        _add_own(TI, own, sums)
    peak[0] = hmax(top)


@njit(**_options)
def add_blocks(row_start, row_offset, row_data, T, TI, pattern, finite, held, nearest, part):
    """Add part of the 28 sums ``sum_j kappa_ij x^a y^b z^c``, ``a + b + c = 6``, to both points of every bond.

    They fill the diagonal blocks of the operator of `add_normal_products`, whose parameters these are.

    Parameters
    ----------
    part : int
        0: those with ``x^3``; 1: the others with ``y^3``, after ``x^2 y^2 z^2``; 2: the others with ``z^3``. The sums
        stand in the rows of ``t`` that makes them with ``x^3``, ``y^3`` or ``z^3``.
    pattern : float
        ``M``; a term is at most ``k / r``.
    """
    M = splat(pattern)
    zero = splat(0.0)
    for i in range(row_start.size - 1):
        c = i // W
        own = c * ROWS * W + (i - c * W)
        sums = (zero, zero, zero, zero, zero, zero, zero, zero, zero, zero)
        for row in range(row_start[i], row_start[i + 1]):
            b = 3 * np.int64(row_offset[row])
            x = load(T, b) - splat(T[own])
            y = load(T, b + W) - splat(T[own + W])
            z = load(T, b + 2 * W) - splat(T[own + 2 * W])
            r2 = _squared(x, y, z)
            t = _monomials(x, y, z)
            k = _stored(row_data, row, finite)
            k = both(largest(k, splat(-held) * k), above(r2, splat(nearest)))
            s = k / (r2 * r2)
            if part == 0:
                u = (t[0] * t[0], t[0] * t[1], t[0] * t[2], t[0] * t[3], t[0] * t[4],
                     t[0] * t[5], t[0] * t[6], t[0] * t[7], t[0] * t[8], t[0] * t[9])  # fmt: skip
            elif part == 1:
                u = (t[4] * t[4], t[6] * t[1], t[6] * t[2], t[6] * t[3], t[6] * t[4],
                     t[6] * t[5], t[6] * t[6], t[6] * t[7], t[6] * t[8], t[6] * t[9])  # fmt: skip
            else:
                u = (zero, t[9] * t[1], t[9] * t[2], t[9] * t[3], t[9] * t[4],
                     t[9] * t[5], zero, t[9] * t[7], t[9] * t[8], t[9] * t[9])  # fmt: skip
            sums = _scatter(T, b, s, u, M, sums, True)
        _add_own(TI, own, sums)


@njit(**_options)
def write_factors(row_start, row_offset, row_data, T, finite, bounded, nearest, extremes):
    """Multiply the stored numbers by the factors ``1 + (v_i - v_j) . t(xi) / r^4``, and drop the marks.

    Parameters are those of `add_moments`, and

    Parameters
    ----------
    nearest : float, dimension length^2
        Shorter bonds keep their numbers.
    extremes : float64, shape (4,)
        Raised to the largest ``|k|`` and ``|k| / (2 r)`` written, the largest factor, and the negative of the smallest.

    Returns
    -------
    int
        Number of bonds whose factor is 0.
    """
    stride = 2 * W if finite else W
    v = np.empty(N)
    held = 0
    for i in range(row_start.size - 1):
        c = i // W
        own = c * ROWS * W + (i - c * W)
        for row in range(row_start[i], row_start[i + 1]):
            for lane in range(W):
                place = row * stride + lane
                if row_data[place] == 0:
                    continue
                b = 3 * np.int64(row_offset[row]) + lane
                x = T[b] - T[own]
                y = T[b + W] - T[own + W]
                z = T[b + 2 * W] - T[own + 2 * W]
                r2 = x * x + (y * y + z * z)
                for a in range(N):
                    v[a] = T[own + (3 + a) * W] - T[b + (3 + a) * W]
                dot = (v[0] * x * x + v[1] * x * y + v[2] * x * z + v[3] * y * y + v[4] * y * z + v[5] * z * z) * x
                dot += (v[6] * y * y + v[7] * y * z + v[8] * z * z) * y + v[9] * z * z * z
                sign = -1.0 if row_data[place] < 0 and not bounded else 1.0
                g = 1.0 + sign * dot / (r2 * r2) if r2 > nearest else 1.0
                if bounded and g <= 0.0:
                    g = 0.0
                    held += 1
                row_data[place] = sign * abs(row_data[place]) * g
                k = 2.0 * row_data[place] * row_data[place + W] if finite else 1.0 * row_data[place]
                strength = abs(k) * r2 * math.sqrt(r2)
                extremes[0] = max(extremes[0], strength)
                extremes[1] = max(extremes[1], 0.5 * strength / math.sqrt(r2))
                extremes[2] = max(extremes[2], g)
                extremes[3] = max(extremes[3], -g)
    return held


_f8, _i8, _real, _flag = types.float64[::1], types.int64[::1], types.float64, types.boolean
_rows = (_i8, types.uint32[::1], types.float32[::1])
SIGNATURES = {
    add_normal_products: types.void(*_rows, _f8, _i8, _real, _flag, _real, _real),
    add_moments: types.void(*_rows, _f8, _i8, _real, _flag, _flag, _f8),
    add_blocks: types.void(*_rows, _f8, _i8, _real, _flag, _real, _real, types.int64),
    write_factors: types.int64(*_rows, _f8, _flag, _flag, _real, _f8),
}
