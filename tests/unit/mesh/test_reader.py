"""Mesh files: each format gives the cells, the numbering and the named sets that were written; others are refused."""

import itertools
import re
import sys

import meshio
import numpy as np
import pytest

from pdfem_mpi.body.discretization import discretize
from pdfem_mpi.body.meshing import make_mesh
from pdfem_mpi.deck.meshes import FileMesh
from pdfem_mpi.deck.table import SceneError
from pdfem_mpi.deck.toml import parse_deck
from pdfem_mpi.mesh.generators import box
from pdfem_mpi.mesh.hexmesh import HexMesh
from pdfem_mpi.mesh.reader import read_mesh
from support.helpers import ROOT, run_pdfem
from support.mesh_files import SUFFIXES, write_mesh

CELLS = 2, 2, 4
DECK = """
[mesh]
kind = "file"
path = "{}"
[material]
youngs_modulus = 1.0
[[regions]]
name = "body"
model = "{}"
[[supports]]
face = "z-"
z = 0.0
"""


@pytest.fixture
def body():
    """A box with two regions in z, both end faces, and the nodes of an edge."""
    mesh = box((0.0, 0.0, 0.0), tuple(map(float, CELLS)), CELLS)
    cells = np.arange(16)
    return {
        "mesh": mesh,
        "regions": {"low": cells[:8], "high": cells[8:]},
        "faces": {"bottom": mesh.faces_on_face("z-")[1], "top": mesh.faces_on_face("z+")[1]},
        "nodes": {"edge": np.flatnonzero((mesh.nodes[:, 0] == 0.0) & (mesh.nodes[:, 1] == 0.0))},
    }


def entry(path, **keys):
    return FileMesh(path=str(path), **keys)


def refused(path, **keys):
    with pytest.raises(SceneError) as caught:
        read_mesh(entry(path, **keys))
    return caught.value.messages


def scene_of(path, model="finite_elements", *overrides):
    return parse_deck(DECK.format(path, model), "deck.toml", overrides)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_cells_and_nodes_come_back_in_their_order(tmp_path, body, suffix):
    """Bit for bit: what a file says in 17 digits or in binary is what the generator made."""
    write_mesh(tmp_path / f"box{suffix}", **body)
    mesh, number = read_mesh(entry(tmp_path / f"box{suffix}"))
    np.testing.assert_array_equal(mesh.nodes, body["mesh"].nodes)
    np.testing.assert_array_equal(mesh.cells, body["mesh"].cells)
    np.testing.assert_array_equal(number, np.arange(len(mesh.nodes)))
    assert mesh.cells.dtype == np.int32 and mesh.nodes.dtype == np.float64


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_named_sets_come_back(tmp_path, body, suffix):
    write_mesh(tmp_path / f"box{suffix}", **body)
    mesh, _ = read_mesh(entry(tmp_path / f"box{suffix}"))
    names = ("region=0", "region=1") if suffix == ".vtu" else ("low", "high")
    for name, cells in zip(names, body["regions"].values(), strict=True):
        np.testing.assert_array_equal(mesh.cell_sets[name], cells)
    if suffix != ".vtu":
        for name, faces in body["faces"].items():
            np.testing.assert_array_equal(np.sort(mesh.face_sets[name], axis=1), np.sort(faces, axis=1))
    if suffix != ".msh":
        np.testing.assert_array_equal(mesh.node_sets["edge=1" if suffix == ".vtu" else "edge"], body["nodes"]["edge"])


def test_sets_that_meshio_joins_into_one_array_have_their_own_names(tmp_path, body):
    """meshio writes sets to .vtu as one array called by all their names."""
    mesh, cells = body["mesh"], body["regions"]
    sets = {name: [members] for name, members in cells.items()}
    meshio.Mesh(mesh.nodes, [("hexahedron", mesh.cells)], cell_sets=sets).write(tmp_path / "box.vtu")
    found = read_mesh(entry(tmp_path / "box.vtu")).mesh.cell_sets
    assert set(found) == {"low", "high", "low-high=0", "low-high=1"}
    np.testing.assert_array_equal(found["high"], cells["high"])


def test_groups_of_the_gmsh_plate():
    """Format 4.1 as Gmsh writes it: volumes, and surfaces as faces; the mesh that comes with the decks."""
    mesh, _ = read_mesh(entry(ROOT / "jobs" / "meshes" / "plate_with_hole.msh"))
    x = mesh.centroids[:, 0]
    np.testing.assert_array_equal(np.sort(mesh.cell_sets["elements"]), np.flatnonzero(np.abs(x) > 2.0))
    np.testing.assert_array_equal(np.sort(mesh.cell_sets["bands"]), np.flatnonzero((np.abs(x) > 1.5) & (np.abs(x) < 2)))
    assert sum(len(mesh.cell_sets[name]) for name in ("elements", "bands", "hole")) == len(mesh.cells)
    end = {tuple(row) for row in np.sort(mesh.faces_on_face("x+")[1], axis=1)}
    assert {tuple(row) for row in np.sort(mesh.face_sets["right_end"], axis=1)} == end


def test_exodus_sets_without_names_are_called_by_their_ids(tmp_path, body):
    """As other programs of that format call them."""
    write_mesh(tmp_path / "box.exo", body["mesh"])
    assert set(read_mesh(entry(tmp_path / "box.exo")).mesh.cell_sets) == {"block_0"}


def test_nodes_without_hexahedra_are_left_out(tmp_path, body):
    """Points of the geometry, centres of circles: the bounding box is that of the cells; messages keep file numbers."""
    mesh = body["mesh"]
    nodes = np.concatenate([[[90.0, 0.0, 0.0]], mesh.nodes, [[-90.0, 0.0, 0.0]]])
    spoilt = HexMesh(nodes, mesh.cells + 1)
    write_mesh(tmp_path / "box.inp", spoilt, nodes={"all": np.arange(len(nodes))})
    found, number = read_mesh(entry(tmp_path / "box.inp"))
    np.testing.assert_array_equal(found.nodes, mesh.nodes)
    np.testing.assert_array_equal(found.cells, mesh.cells)
    np.testing.assert_array_equal(number, np.arange(1, 1 + len(mesh.nodes)))
    np.testing.assert_array_equal(found.node_sets["all"], np.arange(len(mesh.nodes)))


def test_numbers_of_nodes_may_have_gaps(tmp_path, body):
    """Abaqus and Gmsh number nodes as they like; the file's order counts."""
    write_mesh(tmp_path / "box.inp", body["mesh"])
    text = (tmp_path / "box.inp").read_text()
    head, tail = text.split("*ELEMENT")
    first, *rows = tail.splitlines()
    rows = [",".join([row.split(",")[0], *(str(10 * int(n)) for n in row.split(",")[1:])]) for row in rows if row]
    head = re.sub(r"(?m)^(\d+),", lambda m: f"{10 * int(m[1])},", head)
    (tmp_path / "gaps.inp").write_text(head + "*ELEMENT" + "\n".join([first, *rows]) + "\n")
    np.testing.assert_array_equal(read_mesh(entry(tmp_path / "gaps.inp")).mesh.cells, body["mesh"].cells)


def test_scale_multiplies_coordinates(tmp_path, body):
    write_mesh(tmp_path / "box.vtu", body["mesh"])
    np.testing.assert_array_equal(
        read_mesh(entry(tmp_path / "box.vtu", scale=0.25)).mesh.nodes, 0.25 * body["mesh"].nodes
    )


def test_spacing_is_the_mean_edge_unless_given(tmp_path):
    """Cells of 1 x 1 x 0.5: twelve edges, four of each length."""
    write_mesh(tmp_path / "box.vtu", box((0.0, 0.0, 0.0), (2.0, 2.0, 1.0), (2, 2, 2)))
    assert discretize(scene_of(tmp_path / "box.vtu", "peridynamics")).units.length == pytest.approx(2.5 / 3, rel=1e-15)
    given = scene_of(tmp_path / "box.vtu", "peridynamics", "mesh.spacing=0.9")
    assert discretize(given).units.length == 0.9


def test_checks_that_wait_for_the_cells(tmp_path):
    """A spacing in other units, and a cutoff radius below the mean edge, are told once the file is read."""
    write_mesh(tmp_path / "box.vtu", box((0.0, 0.0, 0.0), (2.0, 2.0, 2.0), (2, 2, 2)))
    for overrides, start in (
        (["mesh.spacing=25.4"], "mesh.spacing = 25.4 is not between the shortest and the longest edge of the cells"),
        (["peridynamics.internal_length=0.3"], "peridynamics.internal_length = 0.3 makes the cutoff radius"),
        (["peridynamics.cutoff_radius=0.9", "peridynamics.internal_length=0.5"], "peridynamics.cutoff_radius = 0.9 is"),
    ):
        with pytest.raises(SceneError) as caught:
            make_mesh(scene_of(tmp_path / "box.vtu", "peridynamics", *overrides))
        (message,) = caught.value.messages
        assert message.startswith(start)
        assert "spacing" in overrides[0] or "below the mean edge of the cells = 1.0" in message


def test_hash_tells_content_and_not_the_file(tmp_path, body):
    """The same content in two files; another digit, numbering or set."""
    for name in ("a.inp", "b.inp"):
        write_mesh(tmp_path / name, **body)
    first, second = (read_mesh(entry(tmp_path / name)).mesh for name in ("a.inp", "b.inp"))
    assert first.sha256() == second.sha256() and len(first.sha256()) == 64
    moved = first.nodes.copy()
    moved[3, 1] = np.nextafter(moved[3, 1], 9.0)
    others = [
        HexMesh(moved, first.cells, first.cell_sets, first.face_sets, first.node_sets),
        HexMesh(first.nodes, first.cells[::-1], first.cell_sets, first.face_sets, first.node_sets),
        HexMesh(first.nodes, first.cells, first.cell_sets, first.face_sets, {}),
        HexMesh(first.nodes, first.cells, {"low": first.cell_sets["high"]}, first.face_sets, first.node_sets),
        HexMesh(first.nodes, first.cells, {"low": first.cell_sets["low"]}, first.face_sets, first.node_sets),
    ]
    assert len({first.sha256(), *(other.sha256() for other in others)}) == 6


def test_path_is_relative_to_the_deck(tmp_path):
    """And absolute in the scene, so that the copy of the deck in a run folder still finds it."""
    scene = parse_deck(DECK.format("meshes/box.vtu", "finite_elements"), str(tmp_path / "deck.toml"))
    assert scene.mesh.path == str(tmp_path / "meshes" / "box.vtu")
    absolute = parse_deck(DECK.format(tmp_path / "box.vtu", "finite_elements"), "other/deck.toml")
    assert absolute.mesh.path == str(tmp_path / "box.vtu")


# --- files that are refused -----------------------------------------------------------------------------------


def test_suffix_is_checked_before_anything_is_read():
    with pytest.raises(SceneError, match=r"mesh.path = .*box.stl\" has a suffix of no known mesh format. Give a file"):
        scene_of("box.stl")


def test_missing_file_names_its_neighbour(tmp_path, body):
    write_mesh(tmp_path / "plate.vtu", body["mesh"])
    (message,) = refused(tmp_path / "palte.vtu")
    assert "there is no such file. Did you mean" in message and message.endswith("plate.vtu?")
    (message,) = refused(tmp_path / "other" / "plate.vtu")
    assert message.endswith("there is no such file. Give its path relative to the folder of the deck.")


def test_folder_empty_file_and_unreadable_file(tmp_path, monkeypatch):
    (tmp_path / "folder.msh").mkdir()
    (tmp_path / "empty.msh").write_bytes(b"\n  \n")
    (tmp_path / "file.msh").write_text("x")
    assert "this is a folder" in refused(tmp_path / "folder.msh")[0]
    assert "the file is empty" in refused(tmp_path / "empty.msh")[0]
    assert "cannot be read: Not a directory" in refused(tmp_path / "file.msh" / "x.msh")[0]

    def forbidden(*arguments, **options):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("pdfem_mpi.mesh.reader.open_plain", forbidden)
    (message,) = refused(tmp_path / "file.msh")
    assert message.endswith("cannot be read: Permission denied. Give a file that this user may read.")


@pytest.mark.parametrize(("content", "suffix"), list(itertools.permutations(SUFFIXES, 2)))
def test_content_that_is_not_what_the_suffix_says(tmp_path, body, suffix, content):
    """Each format under each other's name: told what it is and how to call it."""
    write_mesh(tmp_path / f"right{content}", body["mesh"])
    (tmp_path / f"right{content}").rename(tmp_path / f"wrong{suffix}")
    (message,) = refused(tmp_path / f"wrong{suffix}")
    assert "its content is not" in message and f"rename it to {content}" in message


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_text_that_is_no_mesh(tmp_path, suffix):
    (tmp_path / f"note{suffix}").write_text("Dear reader, this is not a mesh.\n")
    (message,) = refused(tmp_path / f"note{suffix}")
    assert "its content is not" in message and message.endswith("Give a mesh file.")


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_files_that_are_cut_off(tmp_path, body, suffix):
    """No traceback and no exit from within the library, wherever the file ends."""
    path = tmp_path / f"box{suffix}"
    write_mesh(path, body["mesh"])
    whole = path.read_bytes()
    for part in (0.3, 0.6, 0.9):
        path.write_bytes(whole[: int(part * len(whole))].rstrip(b"0123456789"))
        try:
            mesh = read_mesh(entry(path)).mesh
        except SceneError as error:
            (message,) = error.messages
            assert str(path) in message and message.endswith((".", "?")), message
            assert any(word in message for word in ("rite the mesh again", "cut off", "no hexahedra")), message
        else:  # Abaqus has no end mark: a file that ends between two elements is a smaller mesh
            assert suffix == ".inp" and len(mesh.cells) < len(body["mesh"].cells)


def test_cells_that_are_not_hexahedra_are_counted_by_type(tmp_path, body):
    mesh = body["mesh"]
    cell = mesh.cells[0]
    blocks = [
        ("hexahedron", mesh.cells[1:]),
        ("tetra", cell[[[0, 1, 2, 5], [0, 2, 3, 7]]]),
        ("wedge", cell[[[0, 1, 2, 4, 5, 6]]]),
    ]
    meshio.Mesh(mesh.nodes, blocks).write(tmp_path / "mixed.vtu")
    (message,) = refused(tmp_path / "mixed.vtu")
    assert "2 of type tetra, 1 of type wedge beside 15 hexahedra" in message
    assert "a tetra at (0.75, 0.25, 0.25)" in message


def test_hexahedra_of_second_order_are_refused_by_name(tmp_path, body):
    nodes = np.random.default_rng(0).random((20, 3))
    meshio.Mesh(nodes, [("hexahedron20", np.arange(20)[None])]).write(tmp_path / "second.vtu")
    (message,) = refused(tmp_path / "second.vtu")
    assert "1 of type hexahedron20 beside 0 hexahedra" in message and "ElementOrder = 1" in message


def test_surface_meshes_have_no_hexahedra(tmp_path, body):
    meshio.Mesh(body["mesh"].nodes, [("quad", body["faces"]["top"])]).write(tmp_path / "shell.vtu")
    assert "the mesh has no hexahedra" in refused(tmp_path / "shell.vtu")[0]


def test_coordinates_that_are_not_finite(tmp_path, body):
    nodes = body["mesh"].nodes.copy()
    nodes[7, 2], nodes[9, 0] = np.nan, np.inf
    write_mesh(tmp_path / "box.vtu", HexMesh(nodes, body["mesh"].cells))
    (message,) = refused(tmp_path / "box.vtu")
    assert "2 nodes have coordinates that are not finite, the first node 7 at (1, 2, nan)" in message


def test_cells_with_nodes_that_are_not_there(tmp_path, body):
    cells = body["mesh"].cells.copy()
    cells[5, 3] = 1000
    meshio.Mesh(body["mesh"].nodes, [("hexahedron", cells)]).write(tmp_path / "box.vtu")
    (message,) = refused(tmp_path / "box.vtu")
    assert "1 cells (hexahedron) name nodes that the file does not have, the first cell 5" in message


def test_pieces_of_vtu_files_are_refused(tmp_path, body):
    """Each has nodes of its own, and a seam between them would be a crack."""
    write_mesh(tmp_path / "box.vtu", body["mesh"])
    text = (tmp_path / "box.vtu").read_text()
    piece = text[text.index("<Piece") : text.index("</Piece>") + len("</Piece>")]
    (tmp_path / "box.vtu").write_text(text.replace(piece, piece + "\n" + piece))
    assert "the file has 2 pieces, and one is read. Merge them into one" in refused(tmp_path / "box.vtu")[0]


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("*NSET, NSET=edge\n", "*NSET, NSET=edge\nother\n", 'the set edge is made of "other", which is no NSET'),
        ("*ELEMENT", "*NGEN\n1, 2\n*ELEMENT", "*NGEN, which is not read"),
        ("*ELEMENT", "*INCLUDE, INPUT=a.inp\n*ELEMENT", '*INCLUDE of "a.inp", which is not followed'),
        ("*ELEMENT", "*NODE\n1, 0., 0., 0.5\n*ELEMENT", "node 1 is there already, at line"),
        ("*NODE\n", "*NODE, SYSTEM=C\n", "cylindrical or spherical coordinates"),
        ("*ELSET, ELSET=low", "*INSTANCE, PART=b\n1., 0., 0.\n*ELSET, ELSET=low", "is moved from its part's place"),
        ("*ELEMENT", "*PART, NAME=a\n*END PART\n*PART, NAME=b\n*ELEMENT", '"b" is the second part'),
        ("*NODE\n", "*ELEMNT, TYPE=C3D8\n*NODE\n", "*ELEMNT is no keyword that is known. Did you mean *ELEMENT?"),
        ("*NSET, NSET=edge\n", "*NSET, NSET=edge, GENERATE\n1, 3, 1\n", "numbers are no range"),
        ("*NSET, NSET=edge\n", "*NSET, NSET=edge\n4000\n", "the set edge has node 4000, which the file does not have"),
        ("*NSET, NSET=edge\n", "*NSET, NSET=edge\nedge\n", "the set edge is made of itself"),
        ("*NSET, NSET=edge\n", "*NSET\n", "without the name of a set"),
        ("*NODE\n", "*NODE, INPUT=nodes.txt\n", 'the option "INPUT", which is not read'),
        ("*NODE\n", "*NODE\n999, 1.0, 2.0\n", "node 999 has 2 coordinates"),
        ("*NODE\n", "*NODE\n999, 1.0, 2.0, 3.0x\n", '"3.0x" is not a coordinate'),
        ("*NODE\n", "*NODE\n9.5, 1.0, 2.0, 3.0\n", '"9.5" is not the number of a node'),
        ("*ELSET, ELSET=low", "*ELEMENT, TYPE=C3D20R\n1, 2, 3\n*ELSET, ELSET=low", 'elements of type "C3D20R"'),
        ("*ELSET, ELSET=low", "*ELEMENT, TYPE=C3D8\n99, 1, 2, 3\n*ELSET, ELSET=low", "has 3 nodes and not 8"),
        (
            "*ELSET, ELSET=low",
            "*ELEMENT, TYPE=C3D8\n99, 1, 2, 3, 4, 5, 6, 7, 800\n*ELSET, ELSET=low",
            "element 99 of the block that begins here names node 800",
        ),
        (
            "*ELSET, ELSET=low",
            "*ELEMENT, TYPE=C3D8\n1, 1, 2, 3, 4, 5, 6, 7, 8\n*ELSET, ELSET=low",
            "element 1 is there already",
        ),
    ],
)
def test_what_an_abaqus_file_is_refused_for_is_told_with_its_line(tmp_path, body, old, new, words):
    write_mesh(tmp_path / "box.inp", **body)
    text = (tmp_path / "box.inp").read_text().replace("TYPE=C3D8RH", "TYPE=C3D8R")
    assert text.count(old) >= 1
    (tmp_path / "box.inp").write_text(text)
    read_mesh(entry(tmp_path / "box.inp"))  # sound before
    (tmp_path / "box.inp").write_text(text.replace(old, new, 1))
    (message,) = refused(tmp_path / "box.inp")
    assert words in message and re.search(r'box.inp": line \d+: ', message), message


def test_volumes_outside_of_gmsh_groups_are_read(tmp_path):
    """Some entities are in groups and others not: all cells are there, and regions tell which ones they leave out."""
    lines = (ROOT / "jobs" / "meshes" / "plate_with_hole.msh").read_text().split("\n")
    last = lines.index("$EndEntities") - 1  # a volume: tag, box, number of groups, groups, bounding surfaces
    words = lines[last].split()
    assert words[7] == "1"
    lines[last] = " ".join([*words[:7], "0", *words[9:]])
    (tmp_path / "some.msh").write_text("\n".join(lines))
    whole = read_mesh(entry(ROOT / "jobs" / "meshes" / "plate_with_hole.msh")).mesh
    some = read_mesh(entry(tmp_path / "some.msh")).mesh
    assert len(some.cells) == len(whole.cells) == 600
    named = ("elements", "bands", "hole")
    assert 0 < sum(len(some.cell_sets[name]) for name in named) < sum(len(whole.cell_sets[name]) for name in named)


def test_exodus_without_its_library_names_the_extra(tmp_path, body, monkeypatch):
    write_mesh(tmp_path / "box.exo", body["mesh"])
    monkeypatch.setitem(sys.modules, "netCDF4", None)
    assert "pip install netCDF4" in refused(tmp_path / "box.exo")[0]


def test_command_line_tells_all_at_once_and_exits_with_64(tmp_path, body):
    """A mirrored mesh, and sets that are not there: three sentences, no traceback."""
    mesh = body["mesh"]
    write_mesh(tmp_path / "box.inp", HexMesh(mesh.nodes * [1.0, 1.0, -1.0], mesh.cells), body["regions"], body["faces"])
    load = '[[loads]]\nkind = "traction"\nset = "topp"\ntotal = [0, 0, 1.0]\n'
    deck = DECK.format("box.inp", "finite_elements") + load
    (tmp_path / "deck.toml").write_text(deck.replace('name = "body"', 'name = "body"\nset = "hihg"'))
    done = run_pdfem("check", tmp_path / "deck.toml")
    assert done.returncode == 64 and "Traceback" not in done.stderr
    clockwise, load, region = done.stderr.splitlines()
    assert "mesh has 16 of 16 cells that are wound clockwise" in clockwise
    assert 'loads.0.set = "topp" is not a set of the mesh file. Did you mean top?' in load
    assert 'regions.body.set = "hihg" is not a set of the mesh file. Did you mean high?' in region
