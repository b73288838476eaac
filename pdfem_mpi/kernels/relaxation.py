"""Adaptive dynamic relaxation, pointwise: the sums of eq. (31) with (32), and central differences (33)-(35).

Vectors are the flat owned unknowns of a rank. Sums are exact (`exact_sums`): their value is the correctly rounded sum
of the float64 terms on any number of ranks.
"""

import numpy as np
from numba import njit, types

from pdfem_mpi.kernels.exact_sums import BLOCK, BLOCKS, add_terms, carry
from pdfem_mpi.kernels.simd import W, above, both, isub, lanes, load, magnitude, splat, store, unequal

EVERY = 2**W - 1  #: all lanes


@njit(cache=True, nogil=True, boundscheck=False, error_model="numpy")
def add_damping_sums(u, v, force, previous_force, inverse_mass, sums):
    """Add this rank's terms of the four global sums of an iteration.

    ``U^T K U`` with the local stiffness (32) ``K_ii = -(F_i^n - F_i^(n-1)) / (m_i v_i)``, 0 where ``v_i = 0`` or the
    ratio is not finite; ``U^T U``; the square of the residual force; and that of the reactions. The first three run
    over the unknowns that are free to move (``1 / m_i > 0``), the last over the others.

    Parameters
    ----------
    u, v, force, previous_force, inverse_mass : float64, shape (n,)
        Dimensions length, length (the time step is 1), force, force, length / force.
    sums : int64, shape (4, exact_sums.SIZE)
        Added to.
    """
    stiffness = np.empty(BLOCK)
    square = np.empty(BLOCK)
    residual = np.empty(BLOCK)
    reaction = np.empty(BLOCK)
    n = u.size
    zero, infinite = splat(0.0), splat(np.inf)
    for start in range(0, n, BLOCK):
        m = min(BLOCK, n - start)
        whole = m // W * W
        held = False
        for k in range(0, whole, W):
            i = start + k
            f = load(force, i)
            mass = load(inverse_mass, i)
            free = above(mass, zero)
            held |= lanes(free) != EVERY
            speed = load(v, i)
            change = (load(previous_force, i) - f) * mass
            ratio = both(change / speed, unequal(speed, zero))
            ratio = both(ratio, above(infinite, magnitude(ratio)))
            f = f * f
            product = load(u, i)
            product = both(product * product, free)
            store(square, k, product)
            store(stiffness, k, product * ratio)
            product = both(f, free)
            store(residual, k, product)
            store(reaction, k, isub(f, product))
        for k in range(whole, m):
            i = start + k
            change = -(force[i] - previous_force[i]) * inverse_mass[i]
            ratio = change / v[i] if v[i] != 0.0 else 0.0
            ratio = ratio if abs(ratio) < np.inf else 0.0
            free = inverse_mass[i] > 0.0
            square[k] = u[i] * u[i] if free else 0.0
            stiffness[k] = square[k] * ratio
            residual[k] = force[i] * force[i] if free else 0.0
            reaction[k] = 0.0 if free else force[i] * force[i]
            held |= not free
        add_terms(stiffness, m, sums[0])
        add_terms(square, m, sums[1])
        add_terms(residual, m, sums[2])
        if held:
            add_terms(reaction, m, sums[3])
        if start // BLOCK % BLOCKS == BLOCKS - 1:
            for k in range(len(sums)):
                carry(sums[k])
    for k in range(len(sums)):
        carry(sums[k])


@njit(cache=True, nogil=True, boundscheck=False, error_model="numpy")
def advance(u, v, force, previous_force, inverse_mass, damping, first):
    """One step of central differences with a time step of 1: eqs (33), (34); the first step is eq. (35).

    Parameters
    ----------
    u, v, previous_force : float64, shape (n,)
        Overwritten: displacement, velocity at the half step, and ``force``.
    force, inverse_mass : float64, shape (n,)
    damping : float
        ``c_n``.
    first : bool
        Start from rest: ``v^(1/2) = 1/2 M^-1 F^0``.
    """
    for i in range(u.size):
        if first:
            v[i] = 0.5 * inverse_mass[i] * force[i]
        else:
            v[i] = ((2.0 - damping) * v[i] + 2.0 * inverse_mass[i] * force[i]) / (2.0 + damping)
        u[i] += v[i]
        previous_force[i] = force[i]


_f8 = types.float64[::1]
SIGNATURES = {
    add_damping_sums: types.void(_f8, _f8, _f8, _f8, _f8, types.int64[:, ::1]),
    advance: types.void(_f8, _f8, _f8, _f8, _f8, types.float64, types.boolean),
}
