"""Meshes that no answer should be computed on: each defect is counted and placed, sound meshes have none."""

import numpy as np
import pytest

from pdfem_mpi.mesh.defects import face_problems, find_defects
from pdfem_mpi.mesh.generators import box, plate_with_hole
from pdfem_mpi.mesh.hexmesh import HexMesh

CLOCKWISE = [4, 5, 6, 7, 0, 1, 2, 3]  # local nodes of a cell with its lower and upper face exchanged


def cube(n=3):
    return box((0.0, 0.0, 0.0), (float(n),) * 3, (n, n, n))


def defects(nodes, cells):
    mesh = HexMesh(np.asarray(nodes, float), np.asarray(cells, np.int32))
    return find_defects(mesh, np.arange(len(nodes)))


def glued(*parts):
    """Parts side by side, their nodes not shared."""
    nodes = np.concatenate([part.nodes for part in parts])
    starts = np.cumsum([0] + [len(part.nodes) for part in parts])
    return nodes, np.concatenate([part.cells + start for part, start in zip(parts, starts, strict=False)])


def merged(nodes, cells):
    """The same with nodes at one place made one."""
    _, first, back = np.unique(np.round(nodes, 9), axis=0, return_index=True, return_inverse=True)
    return nodes[first], back.reshape(-1)[cells]


@pytest.mark.parametrize(
    "mesh",
    [
        cube(),
        box((0.0, 0.0, 0.0), (100.0, 1.0, 1e-3), (10, 3, 1)),  # thin cells, 10 : 1/3 : 1e-3
        box((1e6, 0.0, 0.0), (1e6 + 3.0, 1.0, 1.0), (3, 1, 1)),
        plate_with_hole((0.0, 0.0, 0.0), (24.0, 16.0, 2.0), 4.0, 1.0),
        cube(1),
        HexMesh(cube(1).nodes * [1.0, 1.0, 5e-4] + cube(1).nodes[:, 2:] * [0.2, 0.2, 0.0], cube(1).cells),
    ],
    ids=["cube", "thin", "far", "plate", "one cell", "one thin oblique cell"],
)
def test_sound_meshes_have_no_defects(mesh):
    assert find_defects(mesh, np.arange(len(mesh.nodes))) == []


def test_distorted_cells_are_no_defect():
    """Inner and surface nodes moved by up to 0.2 of a cell."""
    mesh = cube(4)
    moved = mesh.nodes + 0.2 * np.random.default_rng(1).uniform(-1.0, 1.0, mesh.nodes.shape)
    assert defects(moved, mesh.cells) == []


def test_clockwise_cells_have_their_own_remedy():
    mesh = cube()
    cells = mesh.cells.copy()
    cells[[4, 20]] = cells[[4, 20]][:, CLOCKWISE]
    (message,) = defects(mesh.nodes, cells)
    assert message.startswith("mesh has 2 of 27 cells that are wound clockwise (all their Jacobians are negative)")
    assert "the first 4 at (1.5, 1.5, 0.5), 20 at (2.5, 0.5, 2.5). Exchange the first and the last four" in message


def test_clockwise_and_flat_cells_are_told_apart():
    mesh = cube()
    cells, nodes = mesh.cells.copy(), mesh.nodes.copy()
    cells[0] = cells[0][CLOCKWISE]
    nodes[cells[26, 6]] = nodes[cells[26, 0]] + [0.1, 0.1, 0.1]  # a free corner pushed through the cell
    clockwise, inside_out = defects(nodes, cells)
    assert clockwise.startswith("mesh has 1 of 27 cells that are wound clockwise")
    assert inside_out.startswith("mesh has 1 of 27 cells that are flat or inside out")


def test_collapsed_hexahedra():
    """A wedge written as a hexahedron."""
    mesh = cube()
    cells = mesh.cells.copy()
    cells[13, [3, 7]] = cells[13, [2, 6]]
    message, *_ = defects(mesh.nodes, cells)
    assert message.startswith("mesh has 1 of 27 cells that name a node twice")
    assert "cell 13 at (1.75, 1.5, 1.5)" in message


def test_cells_that_are_there_twice():
    """Also with their nodes in another order, on the surface and inside."""
    mesh = cube()
    again = np.concatenate([mesh.cells, mesh.cells[[13, 0]][:, [1, 2, 3, 0, 5, 6, 7, 4]]])
    (message,) = defects(mesh.nodes, again)
    assert message.startswith("mesh has 2 cells with the same eight nodes as a cell before them")
    assert "cell 27 at (1.5, 1.5, 1.5), cell 28 at (0.5, 0.5, 0.5)" in message


def test_faces_of_three_cells():
    """A second layer that begins at an inner face."""
    mesh = box((0.0, 0.0, 0.0), (2.0, 1.0, 1.0), (2, 1, 1))
    extra = box((1.0, 0.0, 0.0), (1.5, 1.0, 1.0), (1, 1, 1))
    messages = defects(*merged(*glued(mesh, extra)))
    assert messages[0].startswith("mesh has 1 faces that more than two cells share: cells overlap")
    assert "cell 0 at (0.5, 0.5, 0.5), cell 1 at (1.5, 0.5, 0.5), cell 2 at (1.25, 0.5, 0.5)" in messages[0]


def test_coincident_nodes():
    """Two halves that touch and share nothing: one sentence, with the file's numbers of the nodes."""
    left = box((0.0, 0.0, 0.0), (1.0, 2.0, 1.0), (1, 2, 1))
    right = box((1.0, 0.0, 0.0), (2.0, 2.0, 1.0), (1, 2, 1))
    nodes, cells = glued(left, right)
    (message,) = find_defects(HexMesh(nodes, cells.astype(np.int32)), 100 + np.arange(len(nodes)))
    assert message.startswith("mesh has 6 nodes with another node at the same place")
    assert "the first node 101 at (1, 0, 0), node 103 at (1, 1, 0)" in message
    assert "[[cracks]]" in message


@pytest.mark.parametrize(("gap", "words"), [(1.8e-6, "4 nodes with another node at"), (2.2e-6, "falls into 2 parts")])
def test_nodes_coincide_within_a_millionth_of_the_body(gap, words):
    """Of 2; beyond it they are two places, and the parts are apart."""
    left = box((0.0, 0.0, 0.0), (1.0, 1.0, 1.0), (1, 1, 1))
    right = box((1.0 + gap, 0.0, 0.0), (2.0, 1.0, 1.0), (1, 1, 1))
    (message,) = defects(*glued(left, right))
    assert words in message


def test_hanging_nodes_on_a_face():
    """Two cells of half the width beside one: the node in the middle of an edge hangs."""
    coarse = box((0.0, 0.0, 0.0), (1.0, 1.0, 1.0), (1, 1, 1))
    fine = box((1.0, 0.0, 0.0), (2.0, 1.0, 1.0), (1, 2, 1))
    (message,) = defects(*merged(*glued(coarse, fine)))
    assert message.startswith("mesh has 2 hanging nodes")
    assert "at (1, 0.5, 0)" in message and "at (1, 0.5, 1)" in message


def test_hanging_nodes_inside_a_face():
    coarse = box((0.0, 0.0, 0.0), (1.0, 1.0, 1.0), (1, 1, 1))
    fine = box((1.0, 0.0, 0.0), (2.0, 1.0, 1.0), (2, 2, 2))
    (message,) = defects(*merged(*glued(coarse, fine)))
    assert message.startswith("mesh has 5 hanging nodes")  # the middle of the face and of its four edges


def test_hanging_nodes_on_a_twisted_face():
    """The face's own surface counts, also off its middle, not a plane through some of its corners."""
    coarse = box((0.0, 0.0, 0.0), (1.0, 1.0, 1.0), (1, 1, 1))
    fine = box((1.0, 0.0, 0.0), (2.0, 1.0, 1.0), (1, 3, 3))
    nodes, cells = merged(*glued(coarse, fine))
    x, y, z = nodes.T
    (message,) = defects(np.stack([x + 0.3 * y * z, y + 0.8 * z, z], axis=1), cells)
    assert message.startswith("mesh has 12 hanging nodes")


def test_nodes_across_a_narrow_slit_do_not_hang():
    """A U of seven cells, the slit a tenth of a cell wide, nodes opposite the middle of faces: near is not on."""
    mesh = box((0.0, 0.0, 0.0), (3.0, 3.0, 1.0), (3, 3, 1))
    nodes = mesh.nodes.copy()
    nodes[:, 0] = np.choose(np.rint(nodes[:, 0]).astype(int), [0.0, 1.0, 1.1, 2.1])
    nodes[(nodes[:, 0] > 1.05) & (nodes[:, 1] == 2.0), 1] = 1.5
    assert defects(nodes, mesh.cells[[0, 1, 2, 3, 5, 6, 8]]) == []


def test_parts_that_do_not_touch():
    first, second = cube(2), box((5.0, 0.0, 0.0), (6.0, 1.0, 1.0), (1, 1, 1))
    (message,) = defects(*glued(first, second))
    assert message.startswith("mesh falls into 2 parts that share no node, of 8, 1 cells")
    assert "cell 0 at (0.5, 0.5, 0.5), cell 8 at (5.5, 0.5, 0.5)" in message


def test_several_defects_are_told_at_once():
    left, right = (box((x, 0.0, 0.0), (x + 1.0, 1.0, 1.0), (1, 1, 1)) for x in (0.0, 1.0))
    nodes, cells = glued(left, right)
    cells[1] = cells[1][CLOCKWISE]
    clockwise, coincident = defects(nodes, cells)
    assert "wound clockwise" in clockwise and "4 nodes with another node" in coincident


def test_face_of_the_box_that_the_body_only_touches():
    """A prism on its edge: the plane z- has nodes and no faces."""
    mesh = cube(2)
    turn = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 1.0], [0.0, -1.0, 1.0]])
    turned = HexMesh(mesh.nodes @ turn, mesh.cells)
    assert find_defects(turned, np.arange(27)) == []
    (message,) = face_problems(turned, "z-", "supports.3")
    assert message.startswith("supports.3.face = z- selects nothing: no face of a cell lies on the plane z = 0")
    assert face_problems(turned, "x+", "supports.3") == []


def test_nodes_nearly_on_a_face_of_the_box():
    """Coordinates printed with few digits: the face would be loaded in part."""
    mesh = cube(2)
    nodes = mesh.nodes.copy()
    top = np.flatnonzero(nodes[:, 2] == 2.0)
    nodes[top[1:4], 2] -= 1e-4
    (message,) = face_problems(HexMesh(nodes, mesh.cells), "z+", "loads.0")
    assert message.startswith("loads.0.face = z+ leaves out 3 nodes that lie nearly on the plane z = 2, the first at (")
    assert face_problems(mesh, "z+", "loads.0") == []
