"""Nodes and weights against numpy's, which LAPACK finds."""

import numpy as np
import pytest

from pdfem_mpi.body.quadrature import gauss_legendre, in_steps

ROUNDED = 1e-13  # a node's last digit counts 1 / (1 - x^2) times in its weight


@pytest.mark.parametrize("n", [1, 2, 3, 16, 60, 200])
def test_nodes_and_weights(n):
    nodes, weights = gauss_legendre(n)
    expected = np.polynomial.legendre.leggauss(n)
    np.testing.assert_allclose(nodes, expected[0], rtol=0.0, atol=ROUNDED)
    np.testing.assert_allclose(weights, expected[1], rtol=0.0, atol=ROUNDED)
    assert (nodes == -nodes[::-1]).all()


def test_steps_of_one_ratio():
    np.testing.assert_allclose(in_steps(1e-3, 7.0, 12), np.geomspace(1e-3, 7.0, 12), rtol=1e-14)
