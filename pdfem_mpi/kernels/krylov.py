"""Conjugate gradients, pointwise: vectors and exact dot products of an iteration, each in one pass.

Vectors are the flat owned unknowns of a rank. Sums are exact (`exact_sums`): the same on any number of ranks.
"""

import numpy as np
from numba import njit, types

from pdfem_mpi.kernels.exact_sums import AT_ONCE, BLOCK, BLOCKS, add_terms, carry
from pdfem_mpi.kernels.simd import load8, splat8, store

_options = {"cache": True, "nogil": True, "boundscheck": False, "error_model": "numpy"}


@njit(**_options)
def finish_product(w, fixed, z, r, sums):
    """Turn the force of a sweep into ``w = K z`` on the free unknowns, and add the terms of ``r.z`` and ``z.w``.

    Parameters
    ----------
    w : float64, shape (n,), dimension force
        The internal force, which is ``-K z``; overwritten, 0 on fixed unknowns.
    fixed : bool, shape (n,)
    z, r : float64, shape (n,), dimensions length and force
    sums : int64, shape (2, exact_sums.SIZE)
        Added to.
    """
    first, second = np.empty(BLOCK), np.empty(BLOCK)
    for start in range(0, w.size, BLOCK):
        m = min(BLOCK, w.size - start)
        whole = m // AT_ONCE * AT_ONCE
        for i in range(start, start + m):
            w[i] = 0.0 if fixed[i] else -w[i]
        for k in range(0, whole, AT_ONCE):
            x = load8(z, start + k)
            store(first, k, load8(r, start + k) * x)
            store(second, k, x * load8(w, start + k))
        for k in range(whole, m):
            first[k] = r[start + k] * z[start + k]
            second[k] = z[start + k] * w[start + k]
        add_terms(first, m, sums[0])
        add_terms(second, m, sums[1])
        if start // BLOCK % BLOCKS == BLOCKS - 1:
            for k in range(len(sums)):
                carry(sums[k])
    for k in range(len(sums)):
        carry(sums[k])


@njit(**_options)
def take_step(z, w, alpha, beta, p, s, x, r, square):
    """``p = z + beta p``, ``s = w + beta s``, ``x += alpha p``, ``r -= alpha s``; add the terms of ``r.r``.

    Parameters
    ----------
    z, w : float64, shape (n,), dimensions length and force
    alpha, beta : float
    p, s, x, r : float64, shape (n,), dimensions length, force, length, force
        Overwritten.
    square : int64, shape (exact_sums.SIZE,)
        Added to.
    """
    terms = np.empty(BLOCK)
    a, b = splat8(alpha), splat8(beta)
    for start in range(0, z.size, BLOCK):
        m = min(BLOCK, z.size - start)
        whole = m // AT_ONCE * AT_ONCE
        for k in range(0, whole, AT_ONCE):
            i = start + k
            v = load8(z, i) + b * load8(p, i)
            store(p, i, v)
            store(x, i, load8(x, i) + a * v)
            v = load8(w, i) + b * load8(s, i)
            store(s, i, v)
            v = load8(r, i) - a * v
            store(r, i, v)
            store(terms, k, v * v)
        for k in range(whole, m):
            i = start + k
            p[i] = z[i] + beta * p[i]
            s[i] = w[i] + beta * s[i]
            x[i] += alpha * p[i]
            r[i] -= alpha * s[i]
            terms[k] = r[i] * r[i]
        add_terms(terms, m, square)
        if start // BLOCK % BLOCKS == BLOCKS - 1:
            carry(square)
    carry(square)


_f8, _real = types.float64[::1], types.float64
SIGNATURES = {
    finish_product: types.void(_f8, types.boolean[::1], _f8, _f8, types.int64[:, ::1]),
    take_step: types.void(_f8, _f8, _real, _real, _f8, _f8, _f8, _f8, types.int64[::1]),
}
