"""What `[[mesh.remove]]` takes out of a box of cells, and what is left that is no body."""

import numpy as np
import pytest

from pdfem_mpi.body.discretization import discretize
from pdfem_mpi.deck.meshes import BoxMesh
from pdfem_mpi.deck.removals import RemovedBox, RemovedCylinder, RemovedHalfSpace, RemovedPrism
from pdfem_mpi.deck.table import SceneError
from pdfem_mpi.mesh import generators
from pdfem_mpi.mesh.carving import carve, is_removed
from support.bodies import make_scene

CELLS = (8, 6, 4)


def box(*removals, symmetry=()):
    upper = tuple(map(float, CELLS))
    return BoxMesh(lower=(0.0, 0.0, 0.0), upper=upper, spacing=1.0, remove=removals, symmetry=symmetry)


def left(*removals, symmetry=()):
    return carve(generators.box((0.0, 0.0, 0.0), CELLS, CELLS), removals, symmetry)


def refusals(*removals, symmetry=()):
    with pytest.raises(SceneError) as caught:
        left(*removals, symmetry=symmetry)
    return caught.value.messages


def centroids():
    x = np.stack(np.meshgrid(*(np.arange(n) + 0.5 for n in CELLS[::-1]), indexing="ij")[::-1], axis=-1)
    return x.reshape(-1, 3)  # x fastest, as the generator counts


NOTCH = RemovedBox(kind="box", lower=(3.0, -1.0, -1.0), upper=(4.0, 2.0, 9.0))


@pytest.mark.parametrize(
    ("removal", "inside"),
    [
        (NOTCH, lambda x, y, z: (x > 3) & (x < 4) & (y < 2)),
        (
            RemovedCylinder(kind="cylinder", axis="y", centre=(4.0, 99.0, 2.0), radius=1.2),
            lambda x, y, z: (x - 4) ** 2 + (z - 2) ** 2 <= 1.2**2,
        ),
        (
            RemovedCylinder(kind="cylinder", axis="z", centre=(4.0, 3.0, 0.0), radius=1.0, span=(1.0, 3.0)),
            lambda x, y, z: ((x - 4) ** 2 + (y - 3) ** 2 <= 1.0) & (z > 1) & (z < 3),
        ),
        (
            RemovedHalfSpace(kind="half_space", point=(6.0, 0.0, 0.0), normal=(30.0, 0.0, 30.0)),
            lambda x, y, z: x - 6 + z >= 0,
        ),
        (
            RemovedPrism(kind="prism", axis="x", polygon=((0.0, 0.0), (4.0, 0.0), (0.0, 4.0)), span=(-9.0, 2.0)),
            lambda x, y, z: (y + z <= 4.0) & (x < 2),
        ),
        (  # an L, not convex
            RemovedPrism(kind="prism", axis="y", polygon=((0, 0), (8, 0), (8, 1), (1, 1), (1, 4), (0, 4))),
            lambda x, y, z: (z < 1) | (x < 1),
        ),
    ],
    ids=["box", "cylinder", "cylinder with ends", "half space", "prism", "prism, not convex"],
)
def test_cells_whose_centroid_lies_inside_go(removal, inside):
    """Their formulas, written out once more; a centroid on the surface counts as inside."""
    x = centroids()
    expected = inside(*x.T)
    assert 0 < expected.sum() < len(x)
    np.testing.assert_array_equal(is_removed((removal,), x, 1e-5), expected)
    mesh = left(removal)
    np.testing.assert_allclose(mesh.centroids, x[~expected], rtol=0, atol=1e-14)
    assert np.array_equal(np.unique(mesh.cells), np.arange(len(mesh.nodes)))  # no node without a cell
    assert len(np.unique(mesh.nodes, axis=0)) == len(mesh.nodes)


def test_nothing_removed_is_the_box():
    """Decks without the table have the mesh they had, in every bit."""
    plain = generators.box((0.0, 0.0, 0.0), CELLS, CELLS)
    assert discretize(make_scene(CELLS, 8, mesh=box())).mesh.sha256() == plain.sha256()


def test_faces_are_those_of_what_is_left():
    """The upper layers are gone: the face y+ is the one below them."""
    mesh = left(RemovedBox(kind="box", lower=(-1.0, 4.0, -1.0), upper=(9.0, 9.0, 9.0)))
    assert mesh.upper.tolist() == [8.0, 4.0, 4.0]
    assert len(mesh.faces_on_face("y+")[0]) == 8 * 4


def test_what_removes_nothing_is_named():
    (message,) = refusals(NOTCH, RemovedBox(kind="box", lower=(0.0, 0.0, 0.0), upper=(0.4, 0.4, 0.4)))
    assert message.startswith("mesh.remove.1 removes no cell: its box holds no centroid of the 192 cells")
    assert "make it wider" in message


def test_a_body_removed_whole_is_named():
    (message,) = refusals(RemovedHalfSpace(kind="half_space", point=(-1.0, 0.0, 0.0), normal=(1.0, 0.0, 0.0)))
    assert message == "mesh.remove takes all cells: nothing of the body is left. Remove less."


def test_a_body_cut_in_two_is_named():
    """Cells that share an edge alone hang together by nothing: no bond passes between them."""
    (message,) = refusals(RemovedBox(kind="box", lower=(3.0, 0.0, 0.0), upper=(4.0, 6.0, 4.0)))
    assert "leaves 2 parts that share no face, of 72, 96 cells" in message and "(0.5, 0.5, 0.5)" in message
    corners = (
        RemovedBox(kind="box", lower=(0.0, 0.0, 0.0), upper=(4.0, 3.0, 4.0)),
        RemovedBox(kind="box", lower=(4.0, 3.0, 0.0), upper=(8.0, 6.0, 4.0)),
    )
    (message,) = refusals(*corners)
    assert "leaves 2 parts" in message


def test_a_mirror_plane_that_the_body_does_not_reach_is_named():
    removal = RemovedBox(kind="box", lower=(0.0, 0.0, 0.0), upper=(2.0, 6.0, 4.0))
    (message,) = refusals(removal, symmetry=("x-", "y-"))
    assert message.startswith("mesh.remove takes all cells at the mirror plane x- (mesh.symmetry)")
