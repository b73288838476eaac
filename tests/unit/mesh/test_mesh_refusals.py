"""Damaged and odd mesh files: one sentence in less than two seconds; doubled nodes, folded cells, empty sets."""

import time

import numpy as np
import pytest

from pdfem_mpi.body.discretization import discretize
from pdfem_mpi.body.meshing import make_mesh
from pdfem_mpi.deck.loads import BodyForce, Support
from pdfem_mpi.deck.meshes import FileMesh
from pdfem_mpi.deck.regions import Region
from pdfem_mpi.deck.table import SceneError
from pdfem_mpi.mesh.defects import find_defects
from pdfem_mpi.mesh.generators import box
from pdfem_mpi.mesh.hexmesh import HexMesh
from pdfem_mpi.mesh.merge import merge_nodes
from pdfem_mpi.mesh.quality import folded_cells, measure
from pdfem_mpi.mesh.reader import read_mesh
from support.bodies import make_scene
from support.helpers import run_pdfem
from support.mesh_dresses import GmshDress, make_bar, write_exodus, write_vtk
from support.mesh_files import write_mesh

SECONDS = 2.0
GMSH = "$MeshFormat\n{} 0 8\n$EndMeshFormat\n"
ABAQUS = "*NODE\n1, 0., 0., 0.\n"
VTK = "# vtk DataFile Version 3.0\nx\nASCII\nDATASET UNSTRUCTURED_GRID\n"
VTU = '<VTKFile type="UnstructuredGrid"><UnstructuredGrid><Piece NumberOfPoints="{}" NumberOfCells="1">{}'


def refused(path, **keys):
    """The sentences of a refusal, which come at once."""
    start = time.perf_counter()
    with pytest.raises(SceneError) as caught:
        read_mesh(FileMesh(path=str(path), **keys))
    assert time.perf_counter() - start < SECONDS
    assert all(str(path) in message and message.endswith((".", "?")) for message in caught.value.messages)
    return caught.value.messages


BAD = {
    "false count of nodes": (".msh", GMSH.format("2.2") + "$Nodes\n99\n1 0 0 0\n$EndNodes\n", "ends before the"),
    "count of 1e12": (".msh", GMSH.format("4.1") + "$Nodes\n1 1000000000000 1 2\n$EndNodes\n", "ends before the"),
    "count of 1e18": (".msh", GMSH.format("2.2") + "$Nodes\n1e18\n$EndNodes\n", "is not a whole number"),
    "word for a number": (
        ".msh",
        GMSH.format("2.2") + "$Nodes\n1\n1 0 zero 0\n$EndNodes\n",
        'line 6: "zero" is no number',
    ),
    "more nodes than declared": (
        ".msh",
        GMSH.format("2.2") + "$Nodes\n1\n1 0 0 0\n2 0 0 0\n$EndNodes\n",
        "more than it",
    ),
    "no end of a section": (".msh", GMSH.format("2.2") + "$Nodes\n1\n1 0 0 0\n", "does not end. The file was cut off"),
    "another version": (".msh", GMSH.format("1.0"), 'the format is "1.0"; 2.2, 4.0 and 4.1 are read'),
    "no elements": (
        ".msh",
        GMSH.format("2.2") + "$Nodes\n1\n1 0 0 0\n$EndNodes\n",
        "the section $Elements is not there",
    ),
    "false count of names": (
        ".msh",
        GMSH.format("2.2") + '$PhysicalNames\n2\n3 1 "a"\n$EndPhysicalNames\n',
        "and holds 1",
    ),
    "node number of 1e18": (
        ".inp",
        "*NODE\n1000000000000000000, 0., 0., 0.\n*ELEMENT, TYPE=C3D8\n1,1,2,3,4,5,6,7,8",
        "names node 1",
    ),
    "node number of 1e30": (".inp", f"*NODE\n1{'0' * 30}, 0., 0., 0.\n", "is not the number of a node"),
    "rubbish in a row": (".inp", "*NODE\n1, 0., \x01\x02, 0.\n", 'line 2: "??" is not a coordinate'),
    "text before a keyword": (".inp", "1, 2, 3\n*NODE\n", 'line 1: "1, 2, 3" stands before any keyword'),
    "nodes only": (".inp", ABAQUS, "the mesh has no hexahedra, and no other cells"),
    "points short": (".vtk", VTK + "POINTS 8 double\n0 0 0\n", "points declare 24 numbers, and 3 are there"),
    "a count of 1e14": (".vtk", VTK + "POINTS 99999999999999 double\n0 0 0\n", "3 are there"),
    "structured points": (
        ".vtk",
        VTK.replace("UNSTRUCTURED_GRID", "STRUCTURED_POINTS"),
        '"STRUCTURED_POINTS", and unstr',
    ),
    "cells short": (".vtk", VTK + "POINTS 1 double\n0 0 0\nCELLS 1 9\n8 0 0 0\n", "cells declare 9 numbers, and 4 are"),
    "no cells": (".vtk", VTK + "POINTS 1 double\n0 0 0\n", "the file ends without connectivity and types"),
    "no points": (".vtu", VTU.format(8, "</Piece></UnstructuredGrid></VTKFile>"), "no array of points"),
    "not closed": (".vtu", VTU.format(8, ""), "this is not XML"),
    "count of points 1e17": (
        ".vtu",
        VTU.format(10**17, "</Piece></UnstructuredGrid></VTKFile>"),
        "the piece has NumberOfPoints",
    ),
    "a picture": (".vtu", '<VTKFile type="ImageData"></VTKFile>', 'it is a VTK file of "ImageData"'),
    "false count in a header": (".g", "CDF\x02\0\0\0\0\0\0\0\x0a\x64\0\0\0", "declares 1677721600 things, more than"),
    "rubbish of netCDF": (".e", "CDF\x01\x00\x00 nothing else", "cut off"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_files_are_refused_in_one_sentence(tmp_path, case):
    suffix, text, words = BAD[case]
    path = tmp_path / f"bad{suffix}"
    path.write_bytes(text.encode("latin-1"))
    (message,) = refused(path)
    assert words in message, message


WRITERS = {
    ".msh": lambda path, bar, random: GmshDress(bar, random).write(path),
    ".vtu": write_vtk, ".vtk": write_vtk, ".exo": write_exodus,
}  # fmt: skip


@pytest.mark.parametrize("suffix", WRITERS)
def test_files_cut_anywhere_or_with_bytes_changed_are_whole_or_refused(tmp_path, suffix):
    """No traceback, and no body of another size: every cut and every changed byte is refused, or changes no cell."""
    for seed in range(6):
        random = np.random.default_rng(seed)
        path = tmp_path / f"bar{seed}{suffix}"
        WRITERS[suffix](path, make_bar(), random)
        whole = path.read_bytes()
        for _ in range(8):
            damaged = bytearray(whole)
            if random.random() < 0.5:
                damaged = damaged[: int(random.integers(len(whole) - 1))]
            else:
                for place in random.integers(len(whole), size=3):
                    damaged[place] = int(random.integers(256))
            path.write_bytes(bytes(damaged))
            start = time.perf_counter()
            try:
                mesh = read_mesh(FileMesh(path=str(path))).mesh
            except SceneError as error:
                assert all(str(path) in message and message.endswith((".", "?")) for message in error.messages)
            else:
                assert len(mesh.cells) == 16 and np.isfinite(mesh.nodes).all()
            assert time.perf_counter() - start < SECONDS


@pytest.mark.parametrize(("value", "words"), [(1e300, "beyond 1e+50"), (np.nan, "not finite"), (-np.inf, "not finite")])
@pytest.mark.parametrize("suffix", [".inp", ".msh", ".vtu", ".exo"])
def test_coordinates_that_no_body_has(tmp_path, suffix, value, words):
    mesh = box((0.0, 0.0, 0.0), (2.0, 1.0, 1.0), (2, 1, 1))
    nodes = mesh.nodes.copy()
    nodes[3, 1] = value
    write_mesh(tmp_path / f"far{suffix}", HexMesh(nodes, mesh.cells))
    assert any(words in message for message in refused(tmp_path / f"far{suffix}"))
    if value == 1e300:
        write_mesh(tmp_path / f"near{suffix}", mesh)
        (message,) = refused(tmp_path / f"near{suffix}", scale=1e60)
        assert "times mesh.scale = 1e+60" in message


def test_the_command_line_refuses_with_64(tmp_path):
    (tmp_path / "bar.inp").write_text("*NODE\n1, 0., 0.\n")
    deck = '[mesh]\nkind = "file"\npath = "bar.inp"\n[material]\nyoungs_modulus = 1.0\n[[regions]]\nname = "a"\n'
    (tmp_path / "deck.toml").write_text(deck + 'model = "finite_elements"\n[[supports]]\nface = "x-"\nx = 0.0\n')
    done = run_pdfem("check", tmp_path / "deck.toml")
    text = " ".join((done.stdout + done.stderr).split())
    assert done.returncode == 64 and "line 2: node 1 has 2 coordinates" in text and "Traceback" not in text


# --- doubled nodes ------------------------------------------------------------------------------------------------


def two_blocks(gap=0.0):
    """Two boxes that touch at x = 2, each with nodes of its own there."""
    left, right = (
        box((0.0, 0.0, 0.0), (2.0, 2.0, 1.0), (2, 2, 1)),
        box((2.0 + gap, 0.0, 0.0), (4.0, 2.0, 1.0), (2, 2, 1)),
    )
    cells = np.concatenate([left.cells, right.cells + len(left.nodes)])
    seam = len(left.nodes) + np.flatnonzero(right.nodes[:, 0] == 2.0 + gap)
    faces = {"seam": left.cells[[1]][:, [1, 2, 6, 5]], "end": right.faces_on_face("x+")[1] + len(left.nodes)}
    return HexMesh(np.concatenate([left.nodes, right.nodes]), cells, {}, faces, {"seam": seam})


def test_without_merge_doubled_nodes_are_refused_and_the_key_is_named():
    mesh = two_blocks()
    (message,) = find_defects(mesh, np.arange(len(mesh.nodes)))
    assert message.startswith("mesh has 6 nodes with another node at the same place")
    assert "Merge them by mesh.merge = LENGTH in the deck" in message


@pytest.mark.parametrize("gap", [0.0, 1e-3])
def test_merge_joins_blocks_that_were_meshed_apart(gap):
    mesh = two_blocks(gap)
    merged, number = merge_nodes(mesh, np.arange(len(mesh.nodes)), 0.01)
    assert len(merged.nodes) == len(mesh.nodes) - 6 and find_defects(merged, number) == []
    np.testing.assert_array_equal(merged.nodes, mesh.nodes[number])
    moved = np.abs(merged.nodes[merged.cells] - mesh.nodes[mesh.cells])
    assert moved.max() == pytest.approx(gap)
    np.testing.assert_array_equal(merged.nodes[merged.node_sets["seam"]][:, 0], 2.0)
    np.testing.assert_array_equal(merged.nodes[merged.face_sets["end"]][..., 0], 4.0)
    assert merged.notes == ("mesh.merge = 0.01 joined 6 nodes to others at their place",)


def test_merge_is_refused_above_a_tenth_of_the_shortest_edge(tmp_path):
    mesh = two_blocks()
    write_mesh(tmp_path / "two.inp", mesh)
    with pytest.raises(SceneError, match=r"mesh.merge = 0.2 is above a tenth of the shortest edge, 1. Use at most 0.1"):
        read_mesh(FileMesh(path=str(tmp_path / "two.inp"), merge=0.2))
    assert len(read_mesh(FileMesh(path=str(tmp_path / "two.inp"), merge=0.1)).mesh.nodes) == len(mesh.nodes) - 6


# --- cells folded at a corner ---------------------------------------------------------------------------------------


def folded_body():
    """A corner of the last of eight cells pushed in until its Jacobian is negative; those of Gauss points are not."""
    mesh = box((0.0, 0.0, 0.0), (2.0, 2.0, 2.0), (2, 2, 2))
    nodes = mesh.nodes.copy()
    nodes[mesh.cells[7, 6]] -= 0.45
    return HexMesh(nodes, mesh.cells)


def test_cells_folded_at_a_corner_are_taken_by_elements_with_a_warning(tmp_path):
    mesh = folded_body()
    quality = measure(mesh)
    assert quality.smallest_scaled_jacobian < 0.0 < quality.smallest_gauss_volume
    np.testing.assert_array_equal(folded_cells(mesh), [7])
    write_mesh(tmp_path / "fold.inp", mesh)
    entry = FileMesh(path=str(tmp_path / "fold.inp"))
    held = (Support(face="x-", x=0.0, y=0.0, z=0.0),)
    elements = make_scene(
        (2, 2, 2), regions=(Region(name="a", model="finite_elements"),), loads=(), supports=held, mesh=entry
    )
    (note,) = discretize(elements).notes
    assert note.startswith("warning: mesh has 1 cells that are folded at a corner") and "7 at (1.44" in note
    bonds = make_scene(
        (2, 2, 2), regions=(Region(name="a", model="peridynamics"),), loads=(), supports=held, mesh=entry
    )
    with pytest.raises(SceneError, match=r"folded at a corner .* in peridynamics or the overlap"):
        discretize(bonds)


# --- sets -----------------------------------------------------------------------------------------------------------


def test_a_name_of_nodes_and_faces_that_differ_is_refused_for_a_support(tmp_path):
    """In Gmsh a curve and a surface, in Abaqus a set of nodes and a surface: one of the two would be forgotten."""
    mesh = box((0.0, 0.0, 0.0), (2.0, 2.0, 2.0), (2, 2, 2))
    write_mesh(tmp_path / "a.inp", mesh, faces={"fix": mesh.faces_on_face("x-")[1]}, nodes={"fix": [0, 3, 6]})
    scene = make_scene(
        (2, 2, 2), 2, loads=(), supports=(Support(set="fix", x=0.0, y=0.0, z=0.0),),
        mesh=FileMesh(path=str(tmp_path / "a.inp")),
    )  # fmt: skip
    with pytest.raises(SceneError, match="is a set of 3 nodes and one of faces with 9 nodes, which are not the same"):
        make_mesh(scene)


@pytest.mark.parametrize("table", ["regions", "loads", "supports"])
def test_empty_sets_are_refused_wherever_they_are_used(tmp_path, table):
    mesh = box((0.0, 0.0, 0.0), (2.0, 2.0, 2.0), (2, 2, 2))
    write_mesh(tmp_path / "a.inp", mesh)
    text = (tmp_path / "a.inp").read_text() + "*ELSET, ELSET=none\n*NSET, NSET=none\n"
    (tmp_path / "a.inp").write_text(text)
    region = Region(name="a", model="finite_elements", set="none" if table == "regions" else None)
    load = BodyForce(kind="body_force", set="none", density=(1.0, 0.0, 0.0))
    support = Support(set="none", x=0.0, y=0.0, z=0.0)
    scene = make_scene(
        (2, 2, 2),
        regions=(region,),
        loads=(load,) if table == "loads" else (),
        supports=(support,) if table == "supports" else (),
        mesh=FileMesh(path=str(tmp_path / "a.inp")),
    )
    with pytest.raises(SceneError, match='set = "none" is an empty set: the mesh file names it'):
        make_mesh(scene)
