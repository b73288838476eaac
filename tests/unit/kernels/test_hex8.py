"""The trilinear hexahedron against its defining properties and scikit-fem."""

import numpy as np
import pytest
from skfem import ElementHex1

from pdfem_mpi.kernels import hex8

ROUND_OFF = 1e-14  # a few roundings of numbers of order 1


@pytest.fixture
def distorted():
    """Five cells with every node moved by up to a fifth of the edge."""
    return hex8.REFERENCE_NODES + 0.4 * np.random.default_rng(1).uniform(-1.0, 1.0, (5, 8, 3))


def test_reference_nodes_are_in_vtk_order():
    """Bottom quadrilateral counter-clockwise, then the top one above it."""
    bottom, top = hex8.REFERENCE_NODES[:4], hex8.REFERENCE_NODES[4:]
    edges = np.roll(bottom, -1, axis=0) - bottom
    assert (np.cross(edges, np.roll(edges, -1, axis=0)) == [0, 0, 4]).all()
    assert (top - bottom == [0, 0, 2]).all()


def test_gauss_points_are_numbered_by_axis():
    """g = gx + 2 gy + 4 gz, at -1 and 1 over the root of 3."""
    g = np.arange(8)
    signs = 2 * np.stack([g % 2, g // 2 % 2, g // 4], axis=1) - 1
    assert (signs / np.sqrt(3.0) == hex8.GAUSS_POINTS).all()


def test_shape_functions_are_one_at_their_node():
    """N_a is 1 at node a and 0 at the others, exactly."""
    assert (hex8.shape_functions(hex8.REFERENCE_NODES) == np.eye(8)).all()


def test_shape_functions_and_gradients_equal_scikit_fem():
    """Values and gradients at arbitrary places; scikit-fem's cube is [0, 1]^3 and its node order another."""
    rst = np.random.default_rng(2).uniform(-1.0, 1.0, (6, 3))
    element = ElementHex1()
    values, gradients = hex8.shape_functions(rst), hex8.shape_gradients(rst)
    for i in range(8):
        a = int(np.flatnonzero((2 * element.doflocs[i] - 1 == hex8.REFERENCE_NODES).all(axis=1))[0])
        value, gradient = element.lbasis((rst.T + 1) / 2, i)
        np.testing.assert_allclose(values[:, a], value, rtol=0, atol=ROUND_OFF)
        np.testing.assert_allclose(gradients[:, a], np.transpose(gradient) / 2, rtol=0, atol=ROUND_OFF)


def test_positions_and_volumes_of_a_box_cell():
    """A cell of edges 2 a, 2 b, 2 c: Gauss points at the edges' halves over the root of 3, equal volumes."""
    half = np.array([1.0, 2.0, 3.0])
    nodes = (half * hex8.REFERENCE_NODES)[None] + 5.0
    np.testing.assert_allclose(hex8.gauss_positions(nodes)[0], 5.0 + half * hex8.GAUSS_POINTS, rtol=ROUND_OFF)
    np.testing.assert_allclose(hex8.gauss_volumes(nodes), np.full((1, 8), 6.0), rtol=ROUND_OFF)


def test_volumes_fill_a_distorted_cell(distorted):
    """The Gauss rule integrates det J exactly: the sum is the volume enclosed by the trilinear faces."""
    volume = np.zeros(len(distorted))
    abscissas, weights = np.polynomial.legendre.leggauss(4)
    for axis, side, p, q in np.ndindex(3, 2, 4, 4):
        rst = np.insert(abscissas[[p, q]], axis, 2 * side - 1)[None]
        x = np.einsum("a,nad->nd", hex8.shape_functions(rst)[0], distorted)
        tangents = np.einsum("ak,nad->nkd", hex8.shape_gradients(rst)[0], distorted)
        normal = np.cross(tangents[:, (axis + 1) % 3], tangents[:, (axis + 2) % 3])
        volume += (2 * side - 1) * weights[p] * weights[q] * (x * normal).sum(axis=1) / 3.0
    np.testing.assert_allclose(hex8.gauss_volumes(distorted).sum(axis=1), volume, rtol=ROUND_OFF)


def test_inverse_jacobians_invert(distorted):
    """J times its inverse is the unit matrix; the volumes are the determinants."""
    inverse, volumes = hex8.inverse_jacobians(distorted)
    jacobians = hex8.jacobians(distorted)
    np.testing.assert_allclose(jacobians @ inverse, np.broadcast_to(np.eye(3), inverse.shape), atol=ROUND_OFF)
    np.testing.assert_allclose(volumes, np.linalg.det(jacobians), rtol=ROUND_OFF)


def test_gradients_of_a_linear_field(distorted):
    """The gradient of the interpolated position is the unit matrix in a cell of any shape."""
    gradients, _ = hex8.gauss_gradients(distorted)
    identity = np.einsum("ngad,nac->ngcd", gradients, distorted)
    np.testing.assert_allclose(identity, np.broadcast_to(np.eye(3), identity.shape), atol=ROUND_OFF)


@pytest.mark.parametrize("function", [hex8.gauss_positions, hex8.gauss_volumes, hex8.jacobians])
def test_a_cell_has_the_same_bits_in_any_batch(distorted, function):
    """Ranks compute other batches of cells and must find the same numbers."""
    together = function(distorted)
    for cell, nodes in enumerate(distorted):
        assert (function(nodes[None])[0] == together[cell]).all()


def test_gradients_do_not_depend_on_an_exact_translation(distorted):
    """Cells of a regular mesh share one geometry to the bit when their coordinates are exact."""
    nodes = np.round(distorted * 2**20) / 2**20
    for here, there in zip(hex8.gauss_gradients(nodes), hex8.gauss_gradients(nodes + 512.0), strict=True):
        assert (here == there).all()
