"""Cholesky's factors of banded matrices and of fronts, against LAPACK."""

import numpy as np
import pytest

from pdfem_mpi.kernels import banded
from pdfem_mpi.kernels.banded import factor_of_band, solution_of_band
from pdfem_mpi.kernels.fronts import MARGIN, eliminate_front

SINGLE = 1e-6  # relative: the factor is kept in single precision, the matrices' condition is below 10
ROUNDED = 1e-13


def positive(n, half_band, seed=0):
    a = np.random.default_rng(seed).uniform(-1.0, 1.0, (n, n))
    a = np.tril(np.triu(a + a.T, -half_band), half_band)
    return a + np.diag(np.abs(a).sum(axis=1))


@pytest.mark.parametrize(("n", "half_band"), [(1, 0), (3, 2), (4, 1), (23, 5), (40, 12), (41, 39), (64, 7), (700, 9)])
def test_solutions_are_those_of_the_dense_matrix(n, half_band):
    a = positive(n, half_band)
    row, column = np.nonzero(np.tril(a))
    factor = factor_of_band(row, column, a[row, column], n)
    right = np.random.default_rng(1).standard_normal(n)
    exact = np.linalg.solve(a, right)
    assert np.abs(solution_of_band(*factor, right) - exact).max() < SINGLE * np.abs(exact).max()


def test_the_solve_is_symmetric():
    """x.Cy = y.Cx to the last digits, whatever the rounding of the factor: it preconditions conjugate gradients."""
    a = positive(60, 17)
    row, column = np.nonzero(np.tril(a))
    factor = factor_of_band(row, column, a[row, column], 60)
    x, y = np.random.default_rng(2).standard_normal((2, 60))
    assert x @ solution_of_band(*factor, y) == pytest.approx(y @ solution_of_band(*factor, x), rel=ROUNDED)


def test_columns_eliminated_together_change_no_bit(monkeypatch):
    a = positive(203, 13)
    row, column = np.nonzero(np.tril(a))
    whole = factor_of_band(row, column, a[row, column], 203)
    monkeypatch.setattr(banded, "TOGETHER", 1)
    in_pieces = factor_of_band(row, column, a[row, column], 203)
    assert all(np.array_equal(one, other) for one, other in zip(whole, in_pieces, strict=True))


def test_a_matrix_that_is_not_positive_is_refused():
    with pytest.raises(ArithmeticError, match="not positive"):
        factor_of_band(np.array([0, 1, 1]), np.array([0, 0, 1]), np.array([1.0, 2.0, 1.0]), 2)


@pytest.mark.parametrize(("n", "m"), [(5, 2), (40, 40), (77, 35), (130, 100), (6, 0)])
def test_a_front_leaves_the_complement_of_what_is_eliminated(n, m):
    a = positive(n, n, 3)
    entries = np.zeros((n + MARGIN, n + MARGIN))
    entries[:n, :n] = np.triu(a)
    assert eliminate_front(entries.reshape(-1), n + MARGIN, n, m) == -1
    factor = np.linalg.cholesky(a)
    np.testing.assert_allclose(np.triu(entries[:m, :n]), factor.T[:m], atol=ROUNDED * n)
    left = a[m:, m:] - factor[m:, :m] @ factor[m:, :m].T
    np.testing.assert_allclose(np.triu(entries[m:n, m:n]), np.triu(left), atol=ROUNDED * n * n)
    assert not entries[n:].any()


def test_a_front_names_the_pivot_that_is_not_positive():
    entries = np.zeros((3 + MARGIN, 3 + MARGIN))
    entries[:3, :3] = np.diag([1.0, -1.0, 1.0])
    assert eliminate_front(entries.reshape(-1), 3 + MARGIN, 3, 3) == 1
