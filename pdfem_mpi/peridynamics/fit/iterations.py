"""Preconditioned conjugate gradients for the multipliers of the fit."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from pdfem_mpi.parallel.sums import exact_dots
from pdfem_mpi.peridynamics.fit.operator import size_of

#: A residual this much above the best of its solve is round-off growing along the operator's fifty free motions.
DRIFT = 100.0
#: A solve ends where the residual has not been halved for so many iterations: round-off is reached.
STALLED = 100


def solve(
    comm,
    multiply: Callable[[np.ndarray, float], np.ndarray],
    precondition: Callable[[np.ndarray], np.ndarray],
    right: np.ndarray,
    reduction: float,
    most: int,
    stalled: int = STALLED,
) -> tuple[np.ndarray, float]:
    """Preconditioned conjugate gradients from 0, with exact dot products. Collective.

    Parameters
    ----------
    multiply : callable
        Of a vector and a bound of its points' norms.
    right : float64, shape (n_clusters, 10, 4)
    reduction : float
        Of the residual's norm, at which the solve ends.
    most, stalled : int
        Iterations; and those without half of the residual after which the solve ends.

    Returns
    -------
    x : float64, shape (n_clusters, 10, 4)
    reached : float
        Reduction of the recursive residual's norm.
    """
    x, r = np.zeros_like(right), right.copy()
    z = precondition(r)
    p = z.copy()
    gamma, first = exact_dots(comm, [(r, z), (r, r)])
    square, iterations = first, 0
    best, best_x = first, x.copy()
    halved, since = first, 0
    while iterations < most and reduction**2 * first < square < DRIFT**2 * best and iterations - since < stalled:
        w = multiply(p, size_of(comm, p))
        (curvature,) = exact_dots(comm, [(p, w)])
        if not curvature > 0.0:
            break  # round-off: the operator has no negative direction
        alpha = gamma / curvature
        x += alpha * p
        r -= alpha * w
        z = precondition(r)
        before = gamma
        gamma, square = exact_dots(comm, [(r, z), (r, r)])
        if square < best:
            best = square
            best_x[:] = x
        if square < 0.25 * halved:
            halved, since = square, iterations
        p *= gamma / before
        p += z
        iterations += 1
    return best_x, math.sqrt(best / first) if first > 0.0 else 0.0
