"""Bounds of strains, and what opens between cells, against numpy."""

import numpy as np
import pytest

from pdfem_mpi.kernels.cell_strains import ROWS, gaps_between, strains_by_nodes, strains_by_points
from pdfem_mpi.kernels.hex8 import GAUSS_POINTS, REFERENCE_NODES, shape_functions, shape_gradients
from pdfem_mpi.kernels.simd import W

#: Round-off of strains of size 1.
ROUND_OFF = 1e-12


@pytest.fixture
def cells():
    """Skew parallelepipeds, with random displacements of their nodes; (n, 8, 3)."""
    random = np.random.default_rng(5)
    edges = np.eye(3) + 0.3 * random.normal(size=(20, 3, 3))
    return 0.5 * REFERENCE_NODES @ edges, random.normal(size=(20, 8, 3)), np.linalg.inv(0.5 * edges).swapaxes(1, 2)


def table(corners, u):
    """The kernels' table of cells by their corners and the displacements of these; (n * 48,)."""
    S = np.zeros((len(u), 2, ROWS, W))
    for row, values in ((0, u), (3, corners)):
        S[:, :, row : row + 3] = (shape_functions(GAUSS_POINTS) @ values).reshape(-1, 2, W, 3).swapaxes(2, 3)
    return S.reshape(-1)


def largest_strains(corners, u):
    """Largest principal strain of the trilinear field on a lattice of places in each cell, its corners among them."""
    places = np.stack(np.meshgrid(*[np.linspace(-1.0, 1.0, 5)] * 3), axis=-1).reshape(-1, 3)
    gradients = shape_gradients(places)
    along, moved = (np.einsum("pak,nad->npkd", gradients, values) for values in (corners, u))
    slope = np.linalg.inv(along) @ moved
    return np.linalg.eigvalsh(0.5 * (slope + slope.swapaxes(-1, -2)))[..., -1].max(axis=1)


@pytest.mark.parametrize("enough", [0.0, np.inf])
def test_strains_are_bounded(cells, enough):
    """From nodes and from points alike at the corners; roughly, where that is enough, from nodes by their box."""
    corners, u, inverse = cells
    connectivity = np.arange(160, dtype=np.int32).reshape(20, 8)
    by_nodes, by_points = np.empty(20), np.empty(20)
    inverse = np.ascontiguousarray(inverse)
    S, straight = table(corners, u), np.zeros(20, bool)
    steep = 0.5 * np.linalg.norm(inverse, axis=2).sum(axis=1)
    strains_by_nodes(connectivity, inverse, steep, straight, S, 0, u.reshape(-1, 3), enough, by_nodes)
    strains_by_points(S, inverse, straight, enough, by_points)
    true = largest_strains(corners, u)
    if enough == 0.0:
        np.testing.assert_allclose(by_points, by_nodes, rtol=ROUND_OFF)
    for bound, most in ((by_points, 3.0), (by_nodes, 4.0)):
        assert (bound >= true * (1.0 - ROUND_OFF)).all()
        assert np.median(bound / true) < (1.2 if enough == 0.0 else most)


@pytest.mark.parametrize("size", [0.5, 1.0, 2.0])
def test_strains_of_tapered_cells_are_bounded(size):
    """The cell of a ring around a hole of radius 1, strained as beside it under tension; a turn changes nothing."""
    angle, radius = np.radians([80.0, 100.0]), np.array([1.0, 1.0 + size])
    ring = np.stack([np.outer(radius, np.cos(angle)), np.outer(radius, np.sin(angle))], axis=-1)  # by radius, angle
    flat = ring[[0, 1, 1, 0], [1, 1, 0, 0]]
    corners = np.concatenate([np.column_stack([flat, np.full(4, z)]) for z in (0.0, 1.0)])[None]
    hoop = (
        1.0
        + 0.5 / np.linalg.norm(corners[..., :2], axis=-1) ** 2
        + 1.5 / np.linalg.norm(corners[..., :2], axis=-1) ** 4
    )
    u = np.zeros((1, 8, 3))
    u[..., 0] = hoop * corners[..., 0]
    u += 5.0 * np.cross([0.0, 0.0, 1.0], corners)
    S, tapered, inverse = table(corners, u), np.ones(1, bool), np.full((1, 3, 3), np.nan)
    by_nodes, by_points = np.empty(1), np.empty(1)
    steep = np.full(1, np.nan)  # of parallelepipeds alone
    strains_by_nodes(np.arange(8, dtype=np.int32)[None], inverse, steep, tapered, S, 0, u[0], 0.0, by_nodes)
    strains_by_points(S, inverse, tapered, 0.0, by_points)
    np.testing.assert_allclose(by_points, by_nodes, rtol=ROUND_OFF)
    assert by_nodes[0] >= largest_strains(corners, u)[0] * (1.0 - ROUND_OFF)
    assert _largest_stretch(corners[0], u[0]) <= by_nodes[0]


def _largest_stretch(corners, u):
    """Of the bonds between the points of a cell."""
    x, moved = (shape_functions(GAUSS_POINTS) @ values for values in (corners, u))
    one, two = np.triu_indices(8, 1)
    xi, eta = x[two] - x[one], moved[two] - moved[one]
    return ((xi * eta).sum(axis=1) / (xi**2).sum(axis=1)).max()


def test_gaps_are_what_cells_carry_a_node_apart():
    """Two cells side by side with displacements of their own; on a mirror plane the image goes the other way."""
    corners = np.stack([0.5 * REFERENCE_NODES, 0.5 * REFERENCE_NODES + [1.0, 0.0, 0.0]])
    u = np.random.default_rng(11).normal(size=(2, 8, 3))
    nodes = np.array([np.arange(8), [1, 8, 9, 2, 5, 10, 11, 6]], np.int32)
    held, apart = np.zeros((12, 3), bool), np.empty(2)
    rows = np.empty((12, 3)), np.empty((12, 3)), apart
    gaps_between(table(corners, u), np.arange(2), nodes, held, *rows)
    jumps = np.linalg.norm(u[0, [1, 2, 5, 6]] - u[1, [0, 3, 4, 7]], axis=1)
    np.testing.assert_allclose(apart, jumps.max(), rtol=ROUND_OFF)
    held[9, 1] = True  # a node of the second cell alone
    gaps_between(table(corners, 0.0 * u + np.arange(3)), np.arange(2), nodes, held, *rows)
    np.testing.assert_allclose(apart, [0.0, 2.0], atol=ROUND_OFF)
