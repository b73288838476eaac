"""Blocks of ten by ten, one a point, of the operator that fits bond factors: their inverses, and products with them."""

import math

import numpy as np
from numba import njit, types

from pdfem_mpi.kernels.monomials import BLOCK_ENTRIES, BLOCK_SCALES, N
from pdfem_mpi.kernels.simd import W

#: Pivots below this fraction of the largest entry have no stiffness.
SOFTEST = 1e-9

_options = {"cache": True, "nogil": True, "boundscheck": False, "error_model": "numpy"}


@njit(**_options)
def invert_blocks(sums, pinned, inverse):
    """Inverse of every point's block of the operator, by Cholesky's method.

    Parameters
    ----------
    sums : float64, shape (n_points, 30)
        Sums of `bond_moments.add_blocks`, part by part.
    pinned : float64, shape (n_points,)
        Added to the diagonal.
    inverse : float32, shape (n_points, 55)
        Lower triangle, row by row; overwritten. A pivot without stiffness leaves its row and column 0.
    """
    L = np.empty((N, N))
    for p in range(sums.shape[0]):
        for a in range(N):
            for b in range(a + 1):
                L[a, b] = sums[p, BLOCK_ENTRIES[a, b]] * BLOCK_SCALES[a, b]
            L[a, a] += pinned[p]
        scale = 0.0
        for a in range(N):
            scale = max(scale, L[a, a])
        for a in range(N):  # factor, and its inverse in place
            pivot = L[a, a]
            for b in range(a):
                pivot -= L[a, b] * L[a, b]
            soft = not pivot > SOFTEST * scale
            L[a, a] = 0.0 if soft else math.sqrt(pivot)
            for r in range(a + 1, N):
                value = L[r, a]
                for b in range(a):
                    value -= L[r, b] * L[a, b]
                L[r, a] = 0.0 if soft else value / L[a, a]
        for a in range(N):
            L[a, a] = 1.0 / L[a, a] if L[a, a] > 0.0 else 0.0
            for b in range(a):
                value = 0.0
                for k in range(b, a):
                    value -= L[a, k] * L[k, b]
                L[a, b] = value * L[a, a]
        place = 0
        for a in range(N):
            for b in range(a + 1):
                value = 0.0
                for k in range(a, N):
                    value += L[k, a] * L[k, b]
                inverse[p, place] = value
                place += 1


@njit(**_options)
def multiply_blocks(inverse, r, z):
    """``z = B^-1 r`` for every point.

    Parameters
    ----------
    inverse : float32, shape (n_points, 55)
    r, z : float64, shape (n_points * 10,)
        In cluster layout ``[cluster][10][4]``; ``z`` is overwritten.
    """
    for p in range(inverse.shape[0]):
        base = N * W * (p // W) + p % W
        for a in range(N):
            z[base + W * a] = 0.0
        place = 0
        for a in range(N):
            value = 0.0
            ra = r[base + W * a]
            for b in range(a):
                e = np.float64(inverse[p, place])
                value += e * r[base + W * b]
                z[base + W * b] += e * ra
                place += 1
            z[base + W * a] += value + np.float64(inverse[p, place]) * ra
            place += 1


_f8, _packed = types.float64[::1], types.float32[:, ::1]
SIGNATURES = {
    invert_blocks: types.void(types.float64[:, ::1], _f8, _packed),
    multiply_blocks: types.void(_packed, _f8, _f8),
}
