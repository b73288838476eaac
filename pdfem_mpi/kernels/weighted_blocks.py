"""Sums over bonds that bound the stiffness by the masses: blocks weighted by the other end, and what they ask for.

A bond of stiffness ``k`` along ``n`` stores ``1/2 k (n . (u_i - u_j))^2``, and for any positive weights ``d`` of the
points (from ``2 a b <= t a^2 + b^2 / t`` with ``t = d_j / d_i``)::

    (n . (u_i - u_j))^2  <=  (1 + d_j / d_i) (n . u_i)^2  +  (1 + d_i / d_j) (n . u_j)^2

So ``u^T K u`` is at most ``sum_i u_i^T (B_i + C_i / d_i) u_i`` with ``B_i = sum_j k n n^T`` and
``C_i = sum_j d_j k n n^T``. See `pdfem_mpi.peridynamics.stable_masses` for the choice of the weights.
"""

import math

import numpy as np
from numba import njit, types

from pdfem_mpi.kernels.bond_response import AHEAD
from pdfem_mpi.kernels.simd import W, fma, iadd, ihsum, largest, load, magnitude, prefetch, root, splat, store

#: The closed form of an eigenvalue loses half of its digits where two of them meet; a bound is raised by more.
MARGIN = 1.0 + 1e-7

_options = {"cache": True, "nogil": True, "boundscheck": False, "error_model": "numpy"}


@njit(**_options)
def add_weighted_blocks(row_start, row_offset, row_data, S, SI, pattern, finite, mixed, stiffening):
    """Add each bond's stiffness, times the weight of its other end, to both of its points: three of six entries.

    Bonds of negative stiffness (fitted factors may have either sign) only lower the energy and add nothing.

    Parameters
    ----------
    row_start, row_offset, row_data
        Rows as in the sweeps.
    S, SI : float64, int64, shape (n_clusters * 36,)
        Weights in row 0, positions in rows 3-5; patterns are added to rows 6-8.
    pattern : float
        ``M``; an entry is at most the bond's force per unit stretch over its length, times the largest weight.
    finite, mixed : bool
        Layout of ``row_data``; entries xx, yy, zz or (mixed) xy, yz, zx.
    stiffening
        As in `bond_densities.add_densities`.
    """
    M = splat(pattern)
    zero = splat(0.0)
    stiffens = stiffening.size > 0
    stride = 2 * W if finite else W
    for i in range(row_start.size - 1):
        c = i // W
        own = c * 9 * W + (i - c * W)
        weight = splat(S[own])
        sx = zero
        sy = zero
        sz = zero
        for row in range(row_start[i], row_start[i + 1]):
            b = np.int64(row_offset[row])
            dx = load(S, b + 3 * W) - splat(S[own + 3 * W])
            dy = load(S, b + 4 * W) - splat(S[own + 4 * W])
            dz = load(S, b + 5 * W) - splat(S[own + 5 * W])
            prefetch(row_data, row * stride + AHEAD)
            k = load(row_data, row * stride)
            if stiffens:
                growth = root(fma(dx, dx, fma(dy, dy, dz * dz))) * (splat(stiffening[i]) + load(stiffening, b // 9))
                k = fma(magnitude(k), growth, largest(k, zero))
            else:
                k = largest(k, zero)
            if finite:
                k = (k + k) * load(row_data, row * stride + W)
            if mixed:
                px, py, pz = dx * dy, dy * dz, dz * dx
            else:
                px, py, pz = dx * dx, dy * dy, dz * dz
            there = k * load(S, b)
            sx = iadd(sx, fma(there, px, M))
            sy = iadd(sy, fma(there, py, M))
            sz = iadd(sz, fma(there, pz, M))
            here = k * weight
            store(S, b + 6 * W, iadd(load(S, b + 6 * W), fma(here, px, M)))
            store(S, b + 7 * W, iadd(load(S, b + 7 * W), fma(here, py, M)))
            store(S, b + 8 * W, iadd(load(S, b + 8 * W), fma(here, pz, M)))
        SI[own + 6 * W] += ihsum(sx)
        SI[own + 7 * W] += ihsum(sy)
        SI[own + 8 * W] += ihsum(sz)


@njit(**_options)
def stiffness_bounds(blocks, weighted, weight, slack, bound):
    """Largest eigenvalue of ``B_i + C_i / d_i`` of each point, from above; 0 for a point without bonds.

    Parameters
    ----------
    blocks, weighted : float64, shape (n_points, 6), dimension force / length
        ``B`` and ``C``, entries xx, yy, zz, xy, yz, zx.
    weight : float64, shape (n_points,)
        ``d``, positive.
    slack : float, dimension force / length
        What the rounding of an entry of ``B`` or ``C`` is at most.
    bound : float64, shape (n_points,), dimension force / length
        Overwritten.
    """
    for i in range(len(weight)):
        b, c, share = blocks[i], weighted[i], 1.0 / weight[i]
        if b[0] + b[1] + b[2] == 0.0:
            bound[i] = 0.0
            continue
        mean = (b[0] + b[1] + b[2] + share * (c[0] + c[1] + c[2])) / 3.0
        xx, yy, zz = b[0] + share * c[0] - mean, b[1] + share * c[1] - mean, b[2] + share * c[2] - mean
        xy, yz, zx = b[3] + share * c[3], b[4] + share * c[4], b[5] + share * c[5]
        size = math.sqrt((xx * xx + yy * yy + zz * zz + 2.0 * (xy * xy + yz * yz + zx * zx)) / 6.0)
        top = mean
        if size > 0.0:
            determinant = xx * (yy * zz - yz * yz) - xy * (xy * zz - yz * zx) + zx * (xy * yz - yy * zx)
            cosine = min(max(0.5 * determinant / (size * size * size), -1.0), 1.0)
            top = mean + 2.0 * size * math.cos(math.acos(cosine) / 3.0)
        bound[i] = MARGIN * (top + 3.0 * slack * (1.0 + share))


_f8, _i8, _table = types.float64[::1], types.int64[::1], types.float64[:, ::1]
SIGNATURES = {
    add_weighted_blocks: types.void(
        _i8, types.uint32[::1], types.float32[::1], _f8, _i8, types.float64, types.boolean, types.boolean,
        _f8,
    ),
    stiffness_bounds: types.void(_table, _table, _f8, types.float64, _f8),
}  # fmt: skip
