"""Symmetric tensors: principal values and axes, and the equivalent stress."""

import numpy as np
import pytest

from pdfem_mpi.measure import tensors

ROUND_OFF = 1e-13  # of the largest component


def some(n=50):
    return np.random.default_rng(3).normal(size=(n, 6))


def test_six_components_are_those_of_the_matrix():
    six = np.arange(1.0, 7.0)
    np.testing.assert_array_equal(tensors.matrices(six), [[1.0, 4.0, 6.0], [4.0, 2.0, 5.0], [6.0, 5.0, 3.0]])
    np.testing.assert_array_equal(tensors.six_of(tensors.matrices(six)), six)


def test_principal_values_and_axes_make_up_the_tensor():
    six = some()
    values, axes = tensors.principal(six)
    assert (np.diff(values, axis=-1) <= 0.0).all()
    again = np.einsum("nk,nki,nkj->nij", values, axes, axes)
    np.testing.assert_allclose(again, tensors.matrices(six), rtol=0, atol=ROUND_OFF * np.abs(six).max())
    assert (np.take_along_axis(axes, np.abs(axes).argmax(axis=-1)[..., None], axis=-1) > 0.0).all()


def test_principal_values_are_unknown_where_the_tensor_is():
    values, axes = tensors.principal(np.array([[np.nan] * 6, [1.0, 2.0, 3.0, 0.0, 0.0, 0.0]]))
    assert np.isnan(values[0]).all() and np.isnan(axes[0]).all()
    np.testing.assert_array_equal(values[1], [3.0, 2.0, 1.0])
    np.testing.assert_array_equal(np.abs(axes[1]), np.eye(3)[::-1])


@pytest.mark.parametrize(
    ("six", "expected"),
    [((5.0, 0, 0, 0, 0, 0), 5.0), ((0, 0, 0, 0, 2.0, 0), 2.0 * np.sqrt(3.0)), ((7.0, 7.0, 7.0, 0, 0, 0), 0.0)],
    ids=["uniaxial", "shear", "pressure"],
)
def test_equivalent_stress_of_states_that_are_known(six, expected):
    assert tensors.von_mises(np.array(six, float)) == pytest.approx(expected, abs=ROUND_OFF)


def test_equivalent_stress_does_not_depend_on_the_axes():
    six = some()
    principal = np.concatenate([tensors.principal(six)[0], np.zeros((len(six), 3))], axis=1)
    np.testing.assert_allclose(tensors.von_mises(six), tensors.von_mises(principal), rtol=1e-12)


def test_determinants_and_products_are_those_of_numpy():
    a, b = np.random.default_rng(4).normal(size=(2, 20, 3, 3))
    np.testing.assert_allclose(tensors.products(a, b), a @ b, rtol=0, atol=10 * ROUND_OFF)
    np.testing.assert_allclose(tensors.determinants(a), np.linalg.det(a), rtol=0, atol=10 * ROUND_OFF)
