"""Selections of cells, faces and nodes that decks speak of, on a small box."""

import numpy as np
import pytest

from pdfem_mpi.kernels.hex8 import gauss_volumes
from pdfem_mpi.mesh.generators import box
from pdfem_mpi.mesh.hexmesh import FACES
from pdfem_mpi.mesh.layers import cells_near_face

CELLS = 3, 2, 4
ROUND_OFF = 1e-14  # of a few additions of numbers of order 1
FACE_NAMES = ("x-", "x+", "y-", "y+", "z-", "z+")


@pytest.fixture
def mesh():
    """Cells of 0.5 x 1 x 0.25."""
    return box((-1.0, 0.0, 2.0), (0.5, 2.0, 3.0), CELLS)


def plane(mesh, face):
    axis = "xyz".index(face[0])
    return axis, (mesh.lower if face[1] == "-" else mesh.upper)[axis]


def test_cells_are_numbered_with_x_fastest(mesh):
    assert (len(mesh.cells), len(mesh.nodes)) == (3 * 2 * 4, 4 * 3 * 5)
    expected = [(-0.75, 0.5, 2.125), (-0.25, 0.5, 2.125), (0.25, 0.5, 2.125), (-0.75, 1.5, 2.125)]
    np.testing.assert_allclose(mesh.centroids[:4], expected, rtol=0, atol=ROUND_OFF)
    np.testing.assert_allclose(mesh.centroids[6], (-0.75, 0.5, 2.375), rtol=0, atol=ROUND_OFF)


def test_cells_have_positive_volumes_and_fill_the_box(mesh):
    """VTK node order: a cell turned inside out has negative Gauss volumes."""
    volumes = gauss_volumes(mesh.nodes[mesh.cells])
    np.testing.assert_allclose(volumes, 0.5 * 1.0 * 0.25 / 8, rtol=ROUND_OFF)


def test_corners_are_exact():
    """0.1 + 2 * 0.1 is not 0.3: the last plane of nodes is the corner that was given, not a sum."""
    mesh = box((0.1, 0.1, 0.1), (0.4, 0.7, 0.8), (3, 6, 7))
    assert tuple(mesh.lower) == (0.1, 0.1, 0.1)
    assert tuple(mesh.upper) == (0.4, 0.7, 0.8)


def test_edges(mesh):
    assert mesh.largest_edge == pytest.approx(1.0, rel=ROUND_OFF)
    assert mesh.mean_edge == pytest.approx(0.5 * (0.25 + 1.0), rel=ROUND_OFF)


@pytest.mark.parametrize("face", FACE_NAMES)
def test_nodes_on_a_face(mesh, face):
    """All nodes of one plane of the box, and no others."""
    axis, position = plane(mesh, face)
    chosen = mesh.nodes_on_face(face)
    assert np.count_nonzero(chosen) == np.prod([n + 1 for d, n in enumerate(CELLS) if d != axis])
    np.testing.assert_array_equal(mesh.nodes[chosen, axis], position)


@pytest.mark.parametrize("face", FACE_NAMES)
def test_faces_on_a_face(mesh, face):
    """Each boundary face once, with its cell, its nodes counter-clockwise seen from outside."""
    axis, position = plane(mesh, face)
    cells, nodes = mesh.faces_on_face(face)
    assert len(np.unique(cells)) == len(cells) == np.prod([n for d, n in enumerate(CELLS) if d != axis])
    corners = mesh.nodes[nodes]
    np.testing.assert_array_equal(corners[:, :, axis], position)
    assert all(set(row) <= set(cell) for row, cell in zip(nodes, mesh.cells[cells], strict=True))
    diagonals = corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1]
    normal = np.cross(*diagonals)[:, axis]
    assert (normal * (1 if face[1] == "+" else -1) > 0).all()


def test_faces_are_listed_in_the_order_of_their_names(mesh):
    """FACES: x-, x+, y-, y+, z-, z+ of a cell."""
    corners = mesh.nodes[mesh.cells[0]]
    for face, nodes in zip(FACE_NAMES, FACES, strict=True):
        axis = "xyz".index(face[0])
        extreme = corners[:, axis].max() if face[1] == "+" else corners[:, axis].min()
        assert (corners[nodes, axis] == extreme).all()


@pytest.mark.parametrize("layers", [1, 2, 3, 9])
@pytest.mark.parametrize("face", FACE_NAMES)
def test_layers_beneath_a_face(mesh, face, layers):
    """The first cells of every column beneath the face; more layers than there are: all cells."""
    axis, position = plane(mesh, face)
    thickness = (mesh.upper - mesh.lower)[axis] / CELLS[axis]
    depth = np.abs(mesh.centroids[:, axis] - position)
    np.testing.assert_array_equal(cells_near_face(mesh, face, layers), depth < layers * thickness)


@pytest.mark.parametrize(
    ("lower", "upper", "count"),
    [
        (None, None, 24),
        ((-1.0, 0.0, 2.0), (0.5, 2.0, 3.0), 24),
        (None, (-0.5, 2.0, 3.0), 8),
        ((-0.25, 0.0, 2.0), None, 16),  # from the second layer's centroids on: the box is closed
        ((-0.25, 0.5, 2.125), (-0.25, 0.5, 2.125), 1),
        ((-0.25 + 2e-9, 0.5, 2.125), (-0.25, 0.5, 2.125), 1),  # within the tolerance of positions
        ((-0.2, 0.0, 2.0), (0.2, 2.0, 3.0), 0),
    ],
)
def test_cells_in_a_box(mesh, lower, upper, count):
    """Cells whose centroid lies in the closed box; None for a corner sets no limit there."""
    assert np.count_nonzero(mesh.cells_in_box(lower, upper)) == count


def test_neighbours_share_a_node(mesh):
    """The cells around a corner cell, itself included: two along each axis."""
    chosen = np.arange(24) == 0
    np.testing.assert_array_equal(np.flatnonzero(mesh.neighbours(chosen)), [0, 1, 3, 4, 6, 7, 9, 10])
    assert not mesh.neighbours(np.zeros(24, bool)).any()
    assert mesh.neighbours(np.ones(24, bool)).all()
