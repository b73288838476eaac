"""Vectors and sums of a step of conjugate gradients, against numpy and math.fsum."""

import math

import numpy as np
import pytest

from pdfem_mpi.kernels import krylov
from pdfem_mpi.kernels.exact_sums import BLOCK, SIZE, value

sizes = pytest.mark.parametrize("n", [0, 1, 7, BLOCK, BLOCK + 1, 1700])


def vectors(count, n, seed=1):
    rng = np.random.default_rng(seed)
    return list(rng.normal(size=(count, n)) * 10.0 ** rng.integers(-6, 3, (count, n)))


@pytest.mark.nojit
@sizes
def test_a_sweep_is_turned_into_a_product(n):
    """Signs turned, fixed unknowns 0, and both dot products rounded once."""
    force, z, r = vectors(3, n)
    fixed = np.random.default_rng(2).random(n) < 0.2
    w, digits = force.copy(), np.zeros((2, SIZE), np.int64)
    krylov.finish_product(w, fixed, z, r, digits)
    np.testing.assert_array_equal(w, np.where(fixed, 0.0, -force))
    assert [value(row) for row in digits] == [math.fsum(r * z), math.fsum(z * w)]


@pytest.mark.nojit
@sizes
def test_a_step(n):
    """p = z + beta p, s = w + beta s, x += alpha p, r -= alpha s, and r.r."""
    z, w, p, s, x, r = vectors(6, n)
    alpha, beta = 0.37, 1.9
    expected_p, expected_s = z + beta * p, w + beta * s
    expected_x, expected_r = x + alpha * expected_p, r - alpha * expected_s
    digits = np.zeros(SIZE, np.int64)
    krylov.take_step(z, w, alpha, beta, p, s, x, r, digits)
    for found, expected in ((p, expected_p), (s, expected_s), (x, expected_x), (r, expected_r)):
        np.testing.assert_array_equal(found, expected)
    assert value(digits) == math.fsum(r * r)
