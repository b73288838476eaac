"""Cells near a place, found by bundles, are those that a look at all of them finds."""

import numpy as np
import pytest

from pdfem_mpi.mesh.hexmesh import HexMesh
from support.mixed_cells import MESHES, grid


def cubes():
    """More than a bundle, many places as near to one middle as to another."""
    return grid(range(12), range(8), range(6))


ALL = MESHES | {"cubes": cubes, "one cell": lambda: grid([0, 1], [0, 2], [0, 3])}


@pytest.fixture(scope="module", params=ALL)
def mesh(request):
    return ALL[request.param]()


def places(mesh):
    """Nodes, middles, places between, and some beyond the body."""
    rng = np.random.default_rng(1)
    size = mesh.upper - mesh.lower
    drawn = mesh.lower + rng.uniform(-0.5, 1.5, (40, 3)) * size
    return np.concatenate([mesh.nodes[:20], mesh.centroids[:20], drawn, [mesh.upper + 100.0 * size]])


def test_the_nearest_middle_is_that_of_all_cells(mesh):
    for place in places(mesh):
        squares = ((mesh.centroids - place) ** 2).sum(axis=1)
        assert mesh.boxes.nearest(place) == (squares.min(), squares.argmin())


@pytest.mark.parametrize("reach", [0.0, 0.7, 4.0])
def test_cells_within_a_reach_are_those_of_all_cells(mesh, reach):
    corners = mesh.nodes[mesh.cells]
    lower, upper = corners.min(axis=1), corners.max(axis=1)
    for place in places(mesh):
        beyond = np.maximum(np.maximum(lower - place, place - upper), 0.0)
        expected = np.flatnonzero(np.sqrt((beyond * beyond).sum(axis=1)) <= reach)
        np.testing.assert_array_equal(mesh.boxes.within(place, place, reach), expected)


def test_cells_around_one_are_its_neighbours(mesh):
    for cell in range(0, len(mesh.cells), 5):
        expected = np.flatnonzero(mesh.neighbours(np.arange(len(mesh.cells)) == cell))
        np.testing.assert_array_equal(mesh.boxes.around(cell), expected)


def test_a_place_does_not_need_all_cells():
    """Of 32,768 cells in no order, the boxes of some hundred are made for a place."""
    mesh = grid(range(33), range(33), range(33))
    mesh = HexMesh(mesh.nodes, mesh.cells[np.random.default_rng(2).permutation(len(mesh.cells))])
    boxes, made = mesh.boxes, []
    make = boxes._boxes
    boxes._boxes = lambda cells: made.append(len(cells)) or make(cells)
    boxes.nearest(np.array([16.2, 16.3, 16.4]))
    assert 0 < sum(made) < 2000
