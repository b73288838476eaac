"""Four or eight elements side by side in the SIMD lanes: what the sweeps over elements share.

A short last group repeats its last element and leaves the copies out.
"""

import numpy as np
from numba import njit

from pdfem_mpi.kernels.hex8 import GRADIENTS_AT_GAUSS
from pdfem_mpi.kernels.simd import W, fma, load, splat, store

_options = {"cache": True, "nogil": True, "boundscheck": False, "error_model": "numpy"}

u8 = np.uint64  #: indices that the compiler need not turn round where they are negative
ONE, TWO, THREE, N = u8(1), u8(2), u8(3), u8(8)


@njit(**_options)
def gather(difference, u, connectivity, first):
    """Write ``u_a - u_0`` of a group's elements to ``difference[4 (3 a + component) + lane]``."""
    for lane in range(W):
        element = min(first + lane, len(connectivity) - 1)
        n = np.uint64(connectivity[element, 0])
        x, y, z = u[n, 0], u[n, 1], u[n, 2]
        for a in range(1, 8):
            n = np.uint64(connectivity[element, a])
            j = 3 * W * a + lane
            difference[j] = u[n, 0] - x
            difference[j + W] = u[n, 1] - y
            difference[j + 2 * W] = u[n, 2] - z


@njit(**_options)
def scatter(force, rounded, connectivity, first):
    """Take ``rounded[4 (3 a + component) + lane]`` from nodes 1 to 7, give their sum to node 0."""
    for lane in range(min(W, len(connectivity) - first)):
        x = y = z = np.int64(0)
        for a in range(1, 8):
            n = np.uint64(connectivity[first + lane, a])
            j = 3 * W * a + lane
            x += rounded[j]
            y += rounded[j + W]
            z += rounded[j + 2 * W]
            force[n, 0] -= rounded[j]
            force[n, 1] -= rounded[j + W]
            force[n, 2] -= rounded[j + 2 * W]
        n = np.uint64(connectivity[first + lane, 0])
        force[n, 0] += x
        force[n, 1] += y
        force[n, 2] += z


@njit(inline="always", **_options)
def gather8(difference, at, u, nodes, first):
    """Write ``u_a - u_0`` of eight elements to ``difference[at + 8 (3 a + component) + lane]``.

    ``u`` and ``nodes`` are the flat displacements and connectivity.
    """
    last = u8(nodes.size) // N - ONE
    for lane in range(N):
        e = N * min(first + lane, last)
        n = THREE * u8(nodes[e])
        x, y, z = u[n], u[n + ONE], u[n + TWO]
        for a in range(ONE, N):
            n = THREE * u8(nodes[e + a])
            j = at + N * THREE * a + lane
            difference[j] = u[n] - x
            difference[j + N] = u[n + ONE] - y
            difference[j + TWO * N] = u[n + TWO] - z


@njit(inline="always", **_options)
def scatter8(force, rounded, at, nodes, first):
    """Take ``rounded[at + 8 (3 a + component) + lane]`` from nodes 1 to 7, give their sum to node 0, as `gather8`."""
    for lane in range(min(N, u8(nodes.size) // N - first)):
        e = N * (first + lane)
        x = y = z = np.int64(0)
        for a in range(ONE, N):
            n = THREE * u8(nodes[e + a])
            j = at + N * THREE * a + lane
            p, q, r = rounded[j], rounded[j + N], rounded[j + TWO * N]
            x += p
            y += q
            z += r
            force[n] -= p
            force[n + ONE] -= q
            force[n + TWO] -= r
        n = THREE * u8(nodes[e])
        force[n] += x
        force[n + ONE] += y
        force[n + TWO] += z


@njit(**_options)
def aligned(array):
    """Where the first line of a cache begins in a flat float64 array that has eight numbers to spare."""
    return u8(-np.int64(array.ctypes.data) % 64 // 8)


@njit(**_options)
def load_moduli(moduli, lam, mu, first):
    """Lame's moduli of a group's elements, side by side."""
    for lane in range(W):
        element = min(first + lane, len(lam) - 1)
        moduli[lane] = lam[element]
        moduli[W + lane] = mu[element]


@njit(inline="always", **_options)
def displacement_gradient(difference, table, row, g):
    """``du_i / dx_j`` at a Gauss point, in the order xx, xy, xz, yx, ..."""
    zero = splat(0.0)
    xr = xs = xt = yr = ys = yt = zr = zs = zt = zero
    for a in range(1, 8):
        dr = splat(GRADIENTS_AT_GAUSS[g, a, 0])
        ds = splat(GRADIENTS_AT_GAUSS[g, a, 1])
        dt = splat(GRADIENTS_AT_GAUSS[g, a, 2])
        x = load(difference, 3 * W * a)
        y = load(difference, 3 * W * a + W)
        z = load(difference, 3 * W * a + 2 * W)
        xr, xs, xt = fma(x, dr, xr), fma(x, ds, xs), fma(x, dt, xt)
        yr, ys, yt = fma(y, dr, yr), fma(y, ds, ys), fma(y, dt, yt)
        zr, zs, zt = fma(z, dr, zr), fma(z, ds, zs), fma(z, dt, zt)
    rx, sx, tx = load(table, row), load(table, row + W), load(table, row + 2 * W)
    ry, sy, ty = load(table, row + 3 * W), load(table, row + 4 * W), load(table, row + 5 * W)
    rz, sz, tz = load(table, row + 6 * W), load(table, row + 7 * W), load(table, row + 8 * W)
    return (
        fma(xr, rx, fma(xs, sx, xt * tx)),
        fma(xr, ry, fma(xs, sy, xt * ty)),
        fma(xr, rz, fma(xs, sz, xt * tz)),
        fma(yr, rx, fma(ys, sx, yt * tx)),
        fma(yr, ry, fma(ys, sy, yt * ty)),
        fma(yr, rz, fma(ys, sz, yt * tz)),
        fma(zr, rx, fma(zs, sx, zt * tx)),
        fma(zr, ry, fma(zs, sy, zt * ty)),
        fma(zr, rz, fma(zs, sz, zt * tz)),
    )


@njit(inline="always", **_options)
def add_stress(forces, table, row, g, pxx, pxy, pxz, pyx, pyy, pyz, pzx, pzy, pzz):
    """Add ``P dN_a/dx`` of a Gauss point to the forces of nodes 1 to 7; ``P`` has the volume in it."""
    rx, sx, tx = load(table, row), load(table, row + W), load(table, row + 2 * W)
    ry, sy, ty = load(table, row + 3 * W), load(table, row + 4 * W), load(table, row + 5 * W)
    rz, sz, tz = load(table, row + 6 * W), load(table, row + 7 * W), load(table, row + 8 * W)
    xr, xs = fma(pxx, rx, fma(pxy, ry, pxz * rz)), fma(pxx, sx, fma(pxy, sy, pxz * sz))
    yr, ys = fma(pyx, rx, fma(pyy, ry, pyz * rz)), fma(pyx, sx, fma(pyy, sy, pyz * sz))
    zr, zs = fma(pzx, rx, fma(pzy, ry, pzz * rz)), fma(pzx, sx, fma(pzy, sy, pzz * sz))
    xt = fma(pxx, tx, fma(pxy, ty, pxz * tz))
    yt = fma(pyx, tx, fma(pyy, ty, pyz * tz))
    zt = fma(pzx, tx, fma(pzy, ty, pzz * tz))
    for a in range(1, 8):
        dr = splat(GRADIENTS_AT_GAUSS[g, a, 0])
        ds = splat(GRADIENTS_AT_GAUSS[g, a, 1])
        dt = splat(GRADIENTS_AT_GAUSS[g, a, 2])
        j = 3 * W * a
        store(forces, j, fma(xr, dr, fma(xs, ds, fma(xt, dt, load(forces, j)))))
        j += W
        store(forces, j, fma(yr, dr, fma(ys, ds, fma(yt, dt, load(forces, j)))))
        j += W
        store(forces, j, fma(zr, dr, fma(zs, ds, fma(zt, dt, load(forces, j)))))
