"""Bounds of strains against numpy, and what lies within the reach against all pairs."""

import numpy as np
import pytest

from pdfem_mpi.kernels.foretold import ROWS, near_larger, raise_bins, strains_by_nodes, strains_by_points
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


def largest_strains(corners, u):
    """Largest principal strain of the trilinear field on a lattice of places in each cell, its corners among them."""
    places = np.stack(np.meshgrid(*[np.linspace(-1.0, 1.0, 5)] * 3), axis=-1).reshape(-1, 3)
    gradients = shape_gradients(places)
    along, moved = (np.einsum("pak,nad->npkd", gradients, values) for values in (corners, u))
    slope = np.linalg.inv(along) @ moved
    return np.linalg.eigvalsh(0.5 * (slope + slope.swapaxes(-1, -2)))[..., -1].max(axis=1)


@pytest.mark.parametrize("enough", [0.0, np.inf])
def test_strains_are_bounded(cells, enough):
    """From nodes and from points alike, roughly or at the corners."""
    corners, u, inverse = cells
    connectivity = np.arange(160, dtype=np.int32).reshape(20, 8)
    by_nodes, by_points = np.empty(20), np.empty(20)
    inverse = np.ascontiguousarray(inverse)
    strains_by_nodes(connectivity, inverse, u.reshape(-1, 3), enough, by_nodes)
    S = np.zeros((20, 2, ROWS, W))
    S[:, :, 0:3] = (shape_functions(GAUSS_POINTS) @ u).reshape(20, 2, W, 3).swapaxes(2, 3)
    strains_by_points(S.reshape(-1), inverse, enough, by_points)
    np.testing.assert_allclose(by_points, by_nodes, rtol=ROUND_OFF)
    true = largest_strains(corners, u)
    assert (by_nodes >= true * (1.0 - ROUND_OFF)).all()
    assert np.median(by_nodes / true) < (1.2 if enough == 0.0 else 3.0)


def test_cells_near_larger_ones_are_found():
    """In bins as wide as the reach, against all pairs."""
    random = np.random.default_rng(7)
    centre, reach = random.uniform(0.0, 4.0, size=(300, 3)), 0.7
    place = (1 + centre // reach).astype(np.int32)
    shape = tuple(place.max(axis=0) + 2)
    number = np.ravel_multi_index(tuple(place.T.astype(np.int64)), shape)
    members = np.argsort(number, kind="stable")
    ends = np.searchsorted(number[members], np.arange(np.prod(shape) + 1))
    bins = np.stack([ends[:-1], ends[1:]], axis=1).reshape(*shape, 2)
    value, limit, around = random.uniform(size=300), random.uniform(0.9, 1.0, size=100), np.empty(shape)
    chosen = np.empty(100, bool)
    raise_bins(bins, members, value, around)
    near_larger(bins, members, place, centre, reach**2, value, around, limit, chosen)
    near = ((centre[:100, None] - centre) ** 2).sum(axis=2) <= reach**2
    np.testing.assert_array_equal(chosen, (near & (value > limit[:, None])).any(axis=1))
    assert 0 < np.count_nonzero(chosen) < 100
