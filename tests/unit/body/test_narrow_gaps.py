"""Bonds across a void of a mesh file are told; those of other bodies are not there to be told."""

import numpy as np
import pytest

from pdfem_mpi.body.cutting import share_of
from pdfem_mpi.deck.loads import Support
from pdfem_mpi.deck.meshes import FileMesh
from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.mesh import generators
from pdfem_mpi.mesh.hexmesh import HexMesh
from pdfem_mpi.parallel.comm import mpi
from support.bodies import make_scene
from support.mesh_files import write_mesh


def told(tmp_path, gone, n_elements=0, cells=(8, 4, 2)):
    """What is said of a box of unit cells from a file, without the cells whose centroids are ``gone``."""
    box = generators.box((0.0, 0.0, 0.0), tuple(map(float, cells)), cells)
    left = box.cells[~gone(box.centroids)]
    used, renumbered = np.unique(left, return_inverse=True)
    write_mesh(tmp_path / "part.msh", HexMesh(box.nodes[used], renumbered.reshape(left.shape).astype(np.int32)))
    scene = make_scene(
        cells, n_elements, correction="none", loads=(), supports=(Support(face="x-", x=0.0, y=0.0, z=0.0),)
    )
    mesh = FileMesh(kind="file", path=str(tmp_path / "part.msh"), spacing=1.0)
    scene = Scene.model_validate({**dict(scene), "mesh": mesh})
    return [note for note in share_of(scene, mpi().COMM_SELF).notes if "void" in note]


def notch(width):
    """An edge notch from above at x = 3, half as deep as the body."""
    return lambda x: (x[:, 1] > 2.0) & (x[:, 0] > 3.0) & (x[:, 0] < 3.0 + width)


@pytest.mark.parametrize("width", [1, 2])
def test_a_narrow_notch_is_told_with_its_place(tmp_path, width):
    """Two walls of two by two faces, a cell or two apart: the cutoff radius is 2.5 cells."""
    (note,) = told(tmp_path, notch(width))
    assert (
        "warning: 8 faces of the mesh look at each other across a void narrower than the cutoff radius of 2.5" in note
    )
    assert f"the nearest {width} apart around ({3.0 + width / 2:g}, " in note
    assert "[[mesh.remove]]" in note and "[[cracks]]" in note


@pytest.mark.parametrize(
    "gone",
    [notch(3), lambda x: (x[:, 0] > 5.0) & (x[:, 1] > 2.0), lambda x: x[:, 0] < 0.0],
    ids=["a wide notch", "a corner", "nothing"],
)
def test_what_no_bond_reaches_across_is_not(tmp_path, gone):
    """A void wider than the bonds are long, an inner corner, and the sides of a thin body."""
    assert not told(tmp_path, gone)


def test_elements_have_no_bonds(tmp_path):
    """The same notch in elements is no matter."""
    assert not told(tmp_path, notch(1), n_elements=8)
