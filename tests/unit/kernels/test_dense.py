"""Dense algebra in a written order, against LAPACK."""

import numpy as np
import pytest

from pdfem_mpi.kernels import dense

ROUNDED = 1e-13  # relative: some hundred operations on matrices of condition 1e3 at most


def symmetric(n, m, seed=0):
    a = np.random.default_rng(seed).standard_normal((n, m, m))
    return a + a.swapaxes(1, 2)


@pytest.mark.parametrize(("n", "k", "m"), [(3, 200, 5), (1, 1, 1), (0, 4, 2), (2, 0, 3)])
def test_product_is_that_of_matrices(n, k, m):
    rng = np.random.default_rng(1)
    a, b = rng.standard_normal((n, k)), rng.standard_normal((k, m))
    np.testing.assert_allclose(dense.product(a, b), a @ b, atol=ROUNDED * max(k, 1))


def test_product_sums_over_neighbouring_axes_and_in_order():
    """Axes beside stay; the terms of an entry are added one after the other, each rounded."""
    rng = np.random.default_rng(2)
    a, b = rng.standard_normal((2, 3, 70)), rng.standard_normal((70, 4, 5))
    found = dense.product(a, b)
    assert found.shape == (2, 3, 4, 5)
    total = 0.0
    for x, y in zip(a[1, 2].tolist(), b[:, 3, 4].tolist(), strict=True):
        total += x * y
    assert found[1, 2, 3, 4] == total
    assert dense.product(a[0], b[:, 0, 0]).shape == (3,)


@pytest.mark.parametrize("m", [1, 2, 3, 6, 20])
def test_eigenvalues_rise_and_vectors_are_orthonormal(m):
    a = symmetric(5, m)
    values, vectors = dense.eigen(a)
    np.testing.assert_allclose(values, np.linalg.eigvalsh(a), atol=ROUNDED * np.abs(a).max() * m)
    np.testing.assert_allclose(vectors.swapaxes(1, 2) @ vectors, np.broadcast_to(np.eye(m), a.shape), atol=ROUNDED)
    np.testing.assert_allclose(a @ vectors, vectors * values[:, None, :], atol=ROUNDED * np.abs(a).max() * m)


@pytest.mark.parametrize(
    "a",
    [
        np.zeros((3, 3)),
        np.diag([3.0, 1.0, 2.0]),
        np.ones((3, 3)),
        np.diag([1e300, 1e-300, 0.0]),
        1e-200 * np.ones((2, 2)),
    ],
    ids=["zero", "diagonal", "rank 1", "far apart", "small"],
)
def test_eigenvalues_of_special_matrices(a):
    values, vectors = dense.eigen(a)
    np.testing.assert_allclose(values, np.linalg.eigvalsh(a), atol=ROUNDED * np.abs(a).max())
    np.testing.assert_allclose(vectors.T @ vectors, np.eye(len(a)), atol=ROUNDED)


def test_small_eigenvalues_keep_their_digits():
    """Of a graded positive matrix Jacobi's rotations find the small ones to all digits."""
    scale = np.array([1.0, 1e-5, 1e-10])
    a = scale[:, None] * np.array([[2.0, 1.0, 0.5], [1.0, 3.0, 1.0], [0.5, 1.0, 1.0]]) * scale
    determinant = np.linalg.det(a / scale / scale[:, None]) * np.prod(scale) ** 2
    assert np.prod(dense.eigen(a)[0]) == pytest.approx(determinant, rel=1e-12)


def test_numbers_that_are_none_do_not_stop_it():
    values, _ = dense.eigen(np.full((3, 3), np.nan))
    assert np.isnan(values).all()


@pytest.mark.parametrize("m", [1, 3, 9])
def test_equations_are_solved_with_pivots(m):
    a = np.random.default_rng(3).standard_normal((4, m, m))
    a[0, 0, 0] = 0.0 if m > 1 else 1.0
    right = np.random.default_rng(4).standard_normal((4, m, 2))
    np.testing.assert_allclose(dense.solve(a, right), np.linalg.solve(a, right), rtol=1e-9)
    np.testing.assert_allclose(dense.solve(a[1], right[1, :, 0]), np.linalg.solve(a[1], right[1, :, 0]), rtol=1e-9)


def test_a_singular_matrix_has_no_finite_solution():
    assert not np.isfinite(dense.solve(np.ones((2, 2)), np.array([1.0, 2.0]))).any()


def test_orthonormal_rows_span_the_same():
    """Rows that depend on others are left out; nearly dependent ones stay orthogonal to the last digits."""
    rng = np.random.default_rng(5)
    basis = rng.standard_normal((4, 37))
    rows = np.concatenate([basis, basis[:2] + basis[2:], [basis[0] + 1e-7 * rng.standard_normal(37)]])
    found = dense.orthonormal_rows(rows, 1e-9)
    assert found.shape == (5, 37)
    np.testing.assert_allclose(found @ found.T, np.eye(5), atol=1e-15 * 37)
    np.testing.assert_allclose(rows @ found.T @ found, rows, atol=1e-13)
    assert dense.orthonormal_rows(np.zeros((0, 5))).shape == (0, 5)


def test_components_are_taken_out():
    rng = np.random.default_rng(6)
    rows, x = dense.orthonormal_rows(rng.standard_normal((3, 50))), rng.standard_normal(50)
    np.testing.assert_allclose(dense.without_components(rows, x), x - rows.T @ (rows @ x), atol=ROUNDED)
    assert dense.without_components(rows[:0], x) is x
