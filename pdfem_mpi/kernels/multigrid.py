"""Multilevel preconditioner, pointwise: restriction, interpolation, blocks of points and nodes.

A flat vector over unknowns holds triples, one per point or node; the points of a cell are two clusters. The three
components of triple ``t`` stand at ``12 (t // 4) + t % 4 + 4 d`` in cluster layout, at ``3 t + d`` for nodes.
"""

import numpy as np
from numba import njit, types

from pdfem_mpi.kernels.bond_response import AHEAD
from pdfem_mpi.kernels.hex8 import SHAPE_AT_GAUSS
from pdfem_mpi.kernels.simd import PATTERN, W, fma, iadd, ihsum, isub, load, prefetch, splat, store

_AT_POINTS = np.ascontiguousarray(SHAPE_AT_GAUSS).reshape(-1)  # corners of a point together
_OF_CORNERS = np.ascontiguousarray(SHAPE_AT_GAUSS.T).reshape(-1)  # points of a corner together
_options = {"cache": True, "nogil": True, "boundscheck": False, "error_model": "numpy"}


@njit(**_options)
def restrict_points(cells, r, quantum, coarse):
    """Add ``T^t r`` of the points of cells to the cells' nodes, the sums of a cell's points rounded to the quantum.

    Parameters
    ----------
    cells : int32, shape (n_cells, 8)
        Nodes of each cell.
    r : float64, shape (n_cells * 24,), dimension force
        In cluster layout.
    quantum : float, dimension force
        Power of two, at least ``2**-47`` of the largest ``|r_i|``.
    coarse : int64, shape (n_nodes, 3), dimension force / quantum
        Added to.
    """
    M = splat(PATTERN * quantum)
    rounded = np.empty(6 * W)
    integers = rounded.view(np.int64)
    for cell in range(cells.shape[0]):
        for d in range(3):
            low = splat(0.0)
            high = splat(0.0)
            for p in range(8):
                value = splat(r[24 * cell + 12 * (p // W) + W * d + p % W])
                low = fma(value, load(_AT_POINTS, 8 * p), low)
                high = fma(value, load(_AT_POINTS, 8 * p + W), high)
            store(rounded, 2 * W * d, isub(low + M, M))
            store(rounded, 2 * W * d + W, isub(high + M, M))
        for a in range(8):
            n = np.uint64(cells[cell, a])
            coarse[n, 0] += integers[a]
            coarse[n, 1] += integers[8 + a]
            coarse[n, 2] += integers[16 + a]


@njit(**_options)
def correct_points(cells, coarse, blocks, omega, r, z):
    """``z = T coarse + omega B r`` at the points of cells, in one pass over the vectors.

    Parameters
    ----------
    cells
        As of `restrict_points`.
    coarse : float64, shape (n_nodes, 3), dimension length
    blocks, omega
        As of `add_block_products`, a block for each point.
    r, z : float64, shape (n_cells * 24,), dimensions force and length
        In cluster layout; ``z`` is overwritten.
    """
    values, known = np.empty(24), np.empty(24)
    for cell in range(cells.shape[0]):
        for a in range(8):
            n = np.uint64(cells[cell, a])
            values[a] = coarse[n, 0]
            values[8 + a] = coarse[n, 1]
            values[16 + a] = coarse[n, 2]
        for d in range(3):
            low = splat(0.0)
            high = splat(0.0)
            for a in range(8):
                value = splat(values[8 * d + a])
                low = fma(value, load(_OF_CORNERS, 8 * a), low)
                high = fma(value, load(_OF_CORNERS, 8 * a + W), high)
            store(known, W * d, low)
            store(known, 3 * W + W * d, high)
        for p in range(8):
            at = 3 * W * (p // W) + p % W
            base = 24 * cell + at
            x, y, w = r[base], r[base + W], r[base + 2 * W]
            b = blocks[8 * cell + p]
            z[base] = known[at] + omega * (b[0] * x + b[3] * y + b[5] * w)
            z[base + W] = known[at + W] + omega * (b[3] * x + b[1] * y + b[4] * w)
            z[base + 2 * W] = known[at + 2 * W] + omega * (b[5] * x + b[4] * y + b[2] * w)


@njit(**_options)
def restrict(corners, weights, r, quantum, coarse):
    """Add ``T^t r`` of nodes to the nodes of a coarser grid, each term rounded to the quantum.

    Parameters
    ----------
    corners : int32, shape (n_nodes, 8)
        Grid nodes around each node.
    weights : float64, shape (n_nodes, 8), dimension 1
        Interpolation functions of the corners at the node.
    r : float64, shape (n_nodes * 3,), dimension force
    quantum : float, dimension force
        Power of two; a sum must stay below ``2**62`` quanta.
    coarse : int64, shape (n_grid_nodes, 3), dimension force / quantum
        Added to.
    """
    inverse = 1.0 / quantum
    for t in range(corners.shape[0]):
        x, y, z = r[3 * t] * inverse, r[3 * t + 1] * inverse, r[3 * t + 2] * inverse
        for a in range(8):
            n, weight = np.uint64(corners[t, a]), weights[t, a]
            coarse[n, 0] += np.int64(np.rint(weight * x))
            coarse[n, 1] += np.int64(np.rint(weight * y))
            coarse[n, 2] += np.int64(np.rint(weight * z))


@njit(**_options)
def interpolate(corners, weights, coarse, z):
    """Add ``T coarse`` to ``z``; parameters as in `restrict`, ``coarse`` and ``z`` of dimension length."""
    for t in range(corners.shape[0]):
        ux, uy, uz = z[3 * t], z[3 * t + 1], z[3 * t + 2]
        for a in range(8):
            n, weight = np.uint64(corners[t, a]), weights[t, a]
            ux += weight * coarse[n, 0]
            uy += weight * coarse[n, 1]
            uz += weight * coarse[n, 2]
        z[3 * t], z[3 * t + 1], z[3 * t + 2] = ux, uy, uz


@njit(**_options)
def add_block_products(blocks, omega, r, z):
    """``z += omega B r`` with a symmetric 3x3 block for each node.

    Parameters
    ----------
    blocks : float64, shape (n_nodes, 6), dimension length / force
        Entries xx, yy, zz, xy, yz, zx.
    omega : float
    r, z : float64, shape (n_nodes * 3,), dimensions force and length
    """
    for t in range(blocks.shape[0]):
        x, y, w = r[3 * t], r[3 * t + 1], r[3 * t + 2]
        b = blocks[t]
        z[3 * t] += omega * (b[0] * x + b[3] * y + b[5] * w)
        z[3 * t + 1] += omega * (b[3] * x + b[1] * y + b[4] * w)
        z[3 * t + 2] += omega * (b[5] * x + b[4] * y + b[2] * w)


@njit(**_options)
def add_point_blocks(row_start, row_offset, row_data, S, SI, pattern, finite, mixed):
    """Add each bond's stiffness ``K' xi_a xi_b`` to both of its points: three of the six entries of their blocks.

    Parameters
    ----------
    row_start, row_offset, row_data
        Rows as in the sweeps; broken bonds add nothing.
    S, SI : float64, int64, shape (n_clusters * 36,)
        Positions in rows 3-5; patterns are added to rows 6-8.
    pattern : float
        ``M``; an entry is at most the bond's force per unit stretch over its length.
    finite, mixed : bool
        Layout of ``row_data``; entries xx, yy, zz or (mixed) xy, yz, zx.
    """
    M = splat(pattern)
    stride = 2 * W if finite else W
    for i in range(row_start.size - 1):
        c = i // W
        own = c * 9 * W + (i - c * W)
        sx = splat(0.0)
        sy = splat(0.0)
        sz = splat(0.0)
        for row in range(row_start[i], row_start[i + 1]):
            b = np.int64(row_offset[row])
            dx = load(S, b + 3 * W) - splat(S[own + 3 * W])
            dy = load(S, b + 4 * W) - splat(S[own + 4 * W])
            dz = load(S, b + 5 * W) - splat(S[own + 5 * W])
            prefetch(row_data, row * stride + AHEAD)
            k = load(row_data, row * stride)
            if finite:
                k = (k + k) * load(row_data, row * stride + W)
            if mixed:
                px = fma(k, dx * dy, M)
                py = fma(k, dy * dz, M)
                pz = fma(k, dz * dx, M)
            else:
                px = fma(k, dx * dx, M)
                py = fma(k, dy * dy, M)
                pz = fma(k, dz * dz, M)
            sx = iadd(sx, px)
            sy = iadd(sy, py)
            sz = iadd(sz, pz)
            store(S, b + 6 * W, iadd(load(S, b + 6 * W), px))
            store(S, b + 7 * W, iadd(load(S, b + 7 * W), py))
            store(S, b + 8 * W, iadd(load(S, b + 8 * W), pz))
        SI[own + 6 * W] += ihsum(sx)
        SI[own + 7 * W] += ihsum(sy)
        SI[own + 8 * W] += ihsum(sz)


_f8, _i8, _table = types.float64[::1], types.int64[::1], types.float64[:, ::1]
_cells = types.int32[:, ::1]
_map = (_cells, _table)
SIGNATURES = {
    restrict_points: types.void(_cells, _f8, types.float64, types.int64[:, ::1]),
    correct_points: types.void(_cells, _table, _table, types.float64, _f8, _f8),
    restrict: types.void(*_map, _f8, types.float64, types.int64[:, ::1]),
    interpolate: types.void(*_map, _table, _f8),
    add_block_products: types.void(_table, types.float64, _f8, _f8),
    add_point_blocks: types.void(
        _i8, types.uint32[::1], types.float32[::1], _f8, _i8, types.float64, types.boolean, types.boolean
    ),
}
