"""Restriction and interpolation between nodes and the points of their cells: adjoint, exact for linear functions."""

import numpy as np
import pytest

from pdfem_mpi.kernels.hex8 import gauss_positions
from pdfem_mpi.kernels.multigrid import correct_points, restrict_points
from pdfem_mpi.mesh import generators
from pdfem_mpi.peridynamics.clusters import cluster_layout

QUANTUM = 2.0**-40


def interpolate_to_points(cells, coarse, z):
    """``z = T coarse``: correct points without residuals."""
    correct_points(cells, coarse, np.ones((8 * len(cells), 6)), 0.5, np.zeros_like(z), z)


@pytest.fixture
def mesh():
    """A box of 3 x 2 x 2 cells, its corners moved a little."""
    box = generators.box((0.0, 0.0, 0.0), (3.0, 2.0, 2.0), (3, 2, 2))
    return box.nodes + np.random.default_rng(1).uniform(-0.1, 0.1, box.nodes.shape), box.cells


@pytest.mark.nojit
def test_linear_functions_are_interpolated_exactly(mesh):
    """At the Gauss points of distorted cells too: their positions are interpolated the same way."""
    nodes, cells = mesh
    z = np.full(24 * len(cells), np.nan)
    interpolate_to_points(cells, nodes @ np.array([[1.0, 0.2, 0.0], [0.0, -0.5, 0.3], [0.7, 0.0, 0.4]]), z)
    x = gauss_positions(nodes[cells])
    expected = cluster_layout(x @ np.array([[1.0, 0.2, 0.0], [0.0, -0.5, 0.3], [0.7, 0.0, 0.4]]))
    np.testing.assert_allclose(z, expected, rtol=0, atol=1e-14)


@pytest.mark.nojit
def test_restriction_is_the_adjoint_of_interpolation(mesh):
    """r.(T c) = (T^t r).c to the quantum, and forces are neither lost nor made."""
    nodes, cells = mesh
    rng = np.random.default_rng(2)
    r, coarse = rng.normal(size=24 * len(cells)), rng.normal(size=nodes.shape)
    z, sums = np.empty_like(r), np.zeros(nodes.shape, np.int64)
    interpolate_to_points(cells, coarse, z)
    restrict_points(cells, r, QUANTUM, sums)
    rounding = 24 * len(cells) * QUANTUM
    assert r @ z == pytest.approx((sums * QUANTUM * coarse).sum(), abs=rounding * np.abs(coarse).max())
    np.testing.assert_allclose(sums.sum(axis=0) * QUANTUM, r.reshape(-1, 3, 4).sum(axis=(0, 2)), rtol=0, atol=rounding)


def test_the_order_of_cells_does_not_change_a_bit(mesh):
    nodes, cells = mesh
    r = np.random.default_rng(3).normal(size=(len(cells), 24))
    order = np.random.default_rng(4).permutation(len(cells))
    sums = np.zeros((2, *nodes.shape), np.int64)
    restrict_points(cells, r.reshape(-1), QUANTUM, sums[0])
    restrict_points(np.ascontiguousarray(cells[order]), np.ascontiguousarray(r[order]).reshape(-1), QUANTUM, sums[1])
    np.testing.assert_array_equal(sums[0], sums[1])


@pytest.mark.nojit
def test_blocks_are_added_to_what_is_interpolated(mesh):
    """``omega B r`` of each point, with the entries xx, yy, zz, xy, yz, zx of its symmetric block."""
    nodes, cells = mesh
    rng = np.random.default_rng(5)
    blocks, r = rng.normal(size=(8 * len(cells), 6)), rng.normal(size=(len(cells), 8, 3))
    z, interpolated = np.full((2, r.size), np.nan)
    matrices = blocks[:, [[0, 3, 5], [3, 1, 4], [5, 4, 2]]].reshape(len(cells), 8, 3, 3)
    coarse = rng.normal(size=nodes.shape)
    correct_points(cells, coarse, blocks, 0.75, cluster_layout(r), z)
    interpolate_to_points(cells, coarse, interpolated)
    products = cluster_layout(np.einsum("cpij,cpj->cpi", matrices, r))
    np.testing.assert_allclose(z - interpolated, 0.75 * products, rtol=0, atol=1e-14)
