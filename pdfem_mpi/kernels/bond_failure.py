"""Failure of bonds beside the sweeps: how near to breaking, energies, breaking a list, and stiffness noise.

Energies are those of eq. (2): ``1/2 c exp(-r0^2) g_ij w_i w_j s^2 r0``, which is ``K s^2 r0^2`` with the number stored
for finite kinematics and ``1/2 K' (eta . xi)^2`` with that for linear ones. Points are local indices, ``4 cluster +
lane``.
"""

import math

import numpy as np
from numba import njit, types

from pdfem_mpi.kernels.bond_response import AHEAD, V1, V2, V3, V4, V5, ask_ahead, u8
from pdfem_mpi.kernels.exact_sums import BLOCK, BLOCKS, add_terms, carry
from pdfem_mpi.kernels.simd import (
    W,
    above,
    both,
    fma,
    hmax,
    isub,
    lanes,
    largest,
    load,
    prefetch,
    root,
    splat,
    store,
)

_options = {"cache": True, "nogil": True, "boundscheck": False, "error_model": "numpy"}
#: What bounds a ratio is raised by more than it may be wrong by.
MORE = 1.0 + 2.0**-40
_golden, _mix_1, _mix_2 = np.uint64(0x9E3779B97F4A7C15), np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)


@njit(**_options)
def largest_ratio(row_start, row_offset, row_data, S, class_of, inverse, finite, nearest, most):
    """Largest stretch of an intact bond relative to its critical stretch.

    Parameters
    ----------
    row_start, row_offset, row_data
        Rows as in the sweeps.
    S : float64, shape (n_clusters * 36,)
        The point table of the sweeps.
    class_of : uint8, shape (n_clusters,)
    inverse : float64, shape (n_classes, n_classes)
        ``1 / s_0`` by the classes of the two points; 0 for bonds that do not break.
    finite : bool
    nearest : float, dimension length^2
        Only bonds whose squared length is above this count.
    most : float
        Larger ratios do not count.

    Returns
    -------
    float
        At least 0; the same bits from either end of a bond.
    """
    zero = splat(0.0)
    one = splat(1.0)
    least = splat(nearest)
    limit = splat(most)
    top = zero
    stride = 2 * W if finite else W
    for i in range(row_start.size - 1):
        c = i // W
        own = c * 9 * W + (i - c * W)
        ux = splat(S[own])
        uy = splat(S[own + W])
        uz = splat(S[own + 2 * W])
        zx = splat(S[own + 3 * W])
        zy = splat(S[own + 4 * W])
        zz = splat(S[own + 5 * W])
        for row in range(u8(row_start[i]), u8(row_start[i + 1])):
            b = u8(row_offset[row])
            o = u8(row) * u8(stride)
            ask_ahead(row_offset, row_data, u8(row), o)
            dx = load(S, b) - ux
            dy = load(S, b + V1) - uy
            dz = load(S, b + V2) - uz
            gx = load(S, b + V3) - zx
            gy = load(S, b + V4) - zy
            gz = load(S, b + V5) - zz
            work = fma(dx, gx, fma(dy, gy, dz * gz))
            intact = above(load(row_data, o), zero)
            factor = inverse[class_of[c], class_of[b // u8(9 * W)]]
            # a bound of the ratio decides whether its division is worth while: hardly ever
            if finite:
                shape = load(row_data, o + V1)
                e = work * shape
                longer = above(one, least * shape)
                candidate = above(e * splat(0.5 * MORE * factor), top)
            else:
                square = fma(gx, gx, fma(gy, gy, gz * gz))
                longer = above(square, least)
                candidate = above(work * splat(MORE * factor), top * square)
            counts = both(both(intact, longer), candidate)
            if lanes(counts) == 0:
                continue
            if finite:
                s = e / (one + root(largest(one + e, zero)))
            else:
                s = work / largest(square, splat(1e-300))  # an empty slot may have no length
            ratio = both(s, counts) * splat(factor)
            top = largest(both(ratio, above(limit, ratio)), top)
    return hmax(top)


@njit(**_options)
def add_energies(row_start, row_offset, row_data, S, finite, digits):
    """Add the energies of all bonds of the rows to an exact sum.

    Parameters
    ----------
    row_start, row_offset, row_data
        Rows as in the sweeps.
    S : float64, shape (n_clusters * 36,)
        The point table of the sweeps.
    finite : bool
    digits : int64, shape (exact_sums.SIZE,)
        Added to; energies of dimension force length.
    """
    terms = np.empty(BLOCK + W)
    one = splat(1.0)
    zero = splat(0.0)
    half = splat(0.5)
    stride = 2 * W if finite else W
    n = np.int64(0)  # not the literal, for which numba would compile `add_terms` once more
    blocks = 0
    for i in range(row_start.size - 1):
        c = i // W
        own = c * 9 * W + (i - c * W)
        for row in range(row_start[i], row_start[i + 1]):
            b = np.int64(row_offset[row])
            dx = load(S, b) - splat(S[own])
            dy = load(S, b + W) - splat(S[own + W])
            dz = load(S, b + 2 * W) - splat(S[own + 2 * W])
            gx = load(S, b + 3 * W) - splat(S[own + 3 * W])
            gy = load(S, b + 4 * W) - splat(S[own + 4 * W])
            gz = load(S, b + 5 * W) - splat(S[own + 5 * W])
            prefetch(row_data, row * stride + AHEAD)
            k = load(row_data, row * stride)
            work = fma(dx, gx, fma(dy, gy, dz * gz))
            if finite:
                inverse = load(row_data, row * stride + W)
                e = work * inverse
                s = e / (one + root(largest(one + e, zero)))
                # K s^2 r0^2 = (K s) (work / (1 + (1 + s))), without the division by 1 / r0^2 that empty slots lack
                energy = (k * s) * (work / (one + root(largest(one + e, zero))))
            else:
                energy = (half * k) * work * work
            store(terms, n, energy)
            n += W
            if n == BLOCK:
                add_terms(terms, n, digits)
                n = 0
                blocks += 1
                if blocks % BLOCKS == 0:
                    carry(digits)
    add_terms(terms, n, digits)
    carry(digits)


@njit(**_options)
def broken_energies(pairs, strengths, n, S, finite, energies):
    """Energies that the first ``n`` recorded bonds have at the displacements of the table.

    Parameters
    ----------
    pairs, strengths : int64, float32, shape (capacity, 2)
        Records of the sweeps.
    n : int
    S : float64, shape (n_clusters * 36,)
    finite : bool
    energies : float64, shape (>= n,), dimension force length
        Overwritten.
    """
    for t in range(n):
        i = 36 * (pairs[t, 0] // W) + pairs[t, 0] % W
        j = 36 * (pairs[t, 1] // W) + pairs[t, 1] % W
        k = np.float64(strengths[t, 0])
        x = (S[j] - S[i]) * (S[j + 3 * W] - S[i + 3 * W])
        y = (S[j + W] - S[i + W]) * (S[j + 4 * W] - S[i + 4 * W])
        z = (S[j + 2 * W] - S[i + 2 * W]) * (S[j + 5 * W] - S[i + 5 * W])
        work = (x + y) + z
        if finite:
            e = work * np.float64(strengths[t, 1])
            below = 1.0 + math.sqrt(max(1.0 + e, 0.0))
            energies[t] = (k * (e / below)) * (work / below)
        else:
            energies[t] = 0.5 * k * work * work


@njit(**_options)
def break_listed(wanted, row_start, row_offset, row_data, finite, pairs, strengths, found):
    """Break the listed bonds that stand in these rows.

    Parameters
    ----------
    wanted : int64, shape (n, 2)
        Local points; in either order.
    row_start, row_offset, row_data
        Rows as in the sweeps; broken slots are set to 0.
    finite : bool
    pairs, strengths : int64, float32, shape (n, 2)
        Records, overwritten.
    found : int64, shape (n,)
        Which of the listed bonds each record is; overwritten.

    Returns
    -------
    int
        Number of records.
    """
    stride = 2 * W if finite else W
    count = 0
    for t in range(wanted.shape[0]):
        for side in range(2):
            i, j = wanted[t, side], wanted[t, 1 - side]
            if i >= row_start.size - 1:
                continue
            for row in range(row_start[i], row_start[i + 1]):
                if np.int64(row_offset[row]) != 9 * W * (j // W):
                    continue
                slot = row * stride + j % W
                if row_data[slot] != 0.0:
                    found[count] = t
                    pairs[count, 0] = i
                    pairs[count, 1] = j
                    strengths[count, 0] = row_data[slot]
                    row_data[slot] = 0.0
                    if finite:
                        strengths[count, 1] = row_data[slot + W]
                        row_data[slot + W] = 0.0
                    count += 1
    return count


@njit(**_options)
def add_broken_blocks(pairs, strengths, x, finite, pattern, sums):
    """Add the stiffness ``K' xi_a xi_b`` of broken bonds to both of their points, rounded as `add_point_blocks` does.

    Parameters
    ----------
    pairs, strengths : int64, float32, shape (n, 2)
    x : float64, shape (n_clusters * 12,), dimension length
    finite : bool
    pattern : float
        ``M`` of the quantum.
    sums : int64, shape (n_clusters * 24,)
        ``[cluster][entry][lane]``, entries xx, yy, zz, xy, yz, zx; added to.
    """
    M = splat(pattern)
    out = np.empty(W)
    whole = out.view(np.int64)
    for t in range(pairs.shape[0]):
        i, j = pairs[t, 0], pairs[t, 1]
        a = 12 * (i // W) + i % W
        b = 12 * (j // W) + j % W
        dx = splat(x[b] - x[a])
        dy = splat(x[b + W] - x[a + W])
        dz = splat(x[b + 2 * W] - x[a + 2 * W])
        k = splat(np.float64(strengths[t, 0]))
        if finite:
            k = (k + k) * splat(np.float64(strengths[t, 1]))
        for entry in range(6):
            if entry == 0:
                p = dx * dx
            elif entry == 1:
                p = dy * dy
            elif entry == 2:
                p = dz * dz
            elif entry == 3:
                p = dx * dy
            elif entry == 4:
                p = dy * dz
            else:
                p = dz * dx
            store(out, 0, isub(fma(k, p, M), M))
            sums[24 * (i // W) + W * entry + i % W] += whole[0]
            sums[24 * (j // W) + W * entry + j % W] += whole[0]


@njit(**_options)
def add_noise(row_start, row_offset, row_data, cell_number, amplitude, seed, finite):
    """Multiply the stiffness of every bond by ``1 + amplitude x``, ``x`` even in [-1, 1], a hash of its points' ids.

    Parameters
    ----------
    row_start, row_offset, row_data
        Rows as in the sweeps; changed.
    cell_number : int64, shape (n_clusters / 2,)
        Global number of the cell of each local cell; point ids are ``8 number + g``.
    amplitude : float
        Below 1.
    seed : int
    finite : bool

    References
    ----------
    The mixing function of SplitMix64: Steele, Lea & Flood, Fast splittable pseudorandom number generators, 2014.
    """
    stride = 2 * W if finite else W
    for i in range(row_start.size - 1):
        own = 8 * cell_number[i // 8] + i % 8
        for row in range(row_start[i], row_start[i + 1]):
            for lane in range(W):
                if row_data[row * stride + lane] == 0.0:
                    continue
                j = np.int64(row_offset[row]) // 9 + lane
                other = 8 * cell_number[j // 8] + j % 8
                h = np.uint64(seed)
                h = _mixed(h + _golden * np.uint64(min(own, other) + 1))
                h = _mixed(h + _golden * np.uint64(max(own, other) + 1))
                x = np.float64(h >> np.uint64(11)) * 2.0**-52 - 1.0
                row_data[row * stride + lane] = row_data[row * stride + lane] * (1.0 + amplitude * x)


@njit(**_options)
def _mixed(h):
    h = (h ^ (h >> np.uint64(30))) * _mix_1
    h = (h ^ (h >> np.uint64(27))) * _mix_2
    return h ^ (h >> np.uint64(31))


_f8, _i8, _int = types.float64[::1], types.int64[::1], types.int64
_rows = (_i8, types.uint32[::1], types.float32[::1])
_records = (types.int64[:, ::1], types.float32[:, ::1])
SIGNATURES = {
    largest_ratio: types.float64(
        *_rows, _f8, types.uint8[::1], types.float64[:, ::1], types.boolean, types.float64, types.float64
    ),
    add_energies: types.void(*_rows, _f8, types.boolean, _i8),
    broken_energies: types.void(*_records, _int, _f8, types.boolean, _f8),
    break_listed: types.int64(types.int64[:, ::1], *_rows, types.boolean, *_records, _i8),
    add_broken_blocks: types.void(*_records, _f8, types.boolean, types.float64, _i8),
    add_noise: types.void(*_rows, _i8, types.float64, _int, types.boolean),
}
