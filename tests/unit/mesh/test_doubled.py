"""Cracks made of doubled nodes: kept where the deck says so, for elements and for bonds."""

import numpy as np
import pytest

from pdfem_mpi.deck.loads import Support, Traction
from pdfem_mpi.deck.meshes import BoxMesh, FileMesh
from pdfem_mpi.deck.peridynamics import Crack
from pdfem_mpi.deck.table import SceneError
from pdfem_mpi.mesh import generators
from pdfem_mpi.mesh.doubled import doubled_faces
from pdfem_mpi.mesh.hexmesh import HexMesh
from pdfem_mpi.solvers.equilibrium import make_solver
from support.bodies import bond_list, build, make_scene
from support.mesh_files import write_mesh

CELLS = (6, 4, 2)
CRACK = Crack(polygon=((3.0, -1.0, -1.0), (3.0, 2.0, -1.0), (3.0, 2.0, 9.0), (3.0, -1.0, 9.0)))


def cracked(shift=0.0):
    """A box whose cells at x > 3 have nodes of their own at x = 3, y < 2; moved a little apart."""
    box = generators.box((0.0, 0.0, 0.0), CELLS, CELLS)
    on = np.flatnonzero((box.nodes[:, 0] == 3.0) & (box.nodes[:, 1] < 2.0))
    number = np.arange(len(box.nodes))
    number[on] = len(box.nodes) + np.arange(len(on))
    beyond = box.centroids[:, 0] > 3.0
    cells = np.where(beyond[:, None], number[box.cells], box.cells).astype(np.int32)
    return HexMesh(np.concatenate([box.nodes, box.nodes[on] + [shift, 0.0, 0.0]]), cells)


def scene(path, mesh, elements=0, doubled="crack", **options):
    write_mesh(path, mesh)
    return make_scene(CELLS, elements, mesh=FileMesh(path=str(path), doubled_nodes=doubled), loads=(), **options)


def refusals(*arguments, **options):
    with pytest.raises(SceneError) as caught:
        build(scene(*arguments, **options))
    return caught.value.messages


def test_faces_at_one_place():
    corners, stray = doubled_faces(cracked())
    assert corners.shape == (2 * 2, 4, 3) and not len(stray)
    assert (corners[:, :, 0] == 3.0).all() and corners[:, :, 1].max() == 2.0


def test_bonds_are_cut_as_by_a_polygon(tmp_path):
    """Along the same faces; bonds through their edges are cut by both."""
    body = build(scene(tmp_path / "cracked.vtu", cracked(), correction="none"))
    mesh = BoxMesh(lower=(0.0, 0.0, 0.0), upper=tuple(map(float, CELLS)), spacing=1.0)
    other = build(make_scene(CELLS, mesh=mesh, loads=(), correction="none", cracks=(CRACK,)))
    found, expected = (
        {tuple(sorted((tuple(np.round(x[a], 6)), tuple(np.round(x[b], 6))))) for a, b in zip(i, j, strict=True)}
        for x, i, j, _ in map(bond_list, (body, other))
    )
    assert found == expected
    assert len(found) < len(bond_list(build(make_scene(CELLS, loads=(), correction="none")))[1])


def test_elements_part_along_it(tmp_path):
    """Pulled across the crack, nodes at one place move apart."""
    pull = Traction(kind="traction", face="x+", traction=(1.0, 0.0, 0.0))
    tables = {"supports": (Support(face="x-", x=0.0, y=0.0, z=0.0),), "solver": "cg"}
    made = scene(tmp_path / "cracked.vtu", cracked(), CELLS[0], **tables).model_copy(update={"loads": (pull,)})
    body = build(made)
    solve = make_solver(made, body.share, body.forces, body.case, print)
    solve(body.state, body.case.forces(1.0))
    u, x = body.model.unknowns.of_nodes(body.state.u), body.model.nodes.x
    at = np.flatnonzero(np.abs(x[:, 0]) < 1e-9)  # the middle plane
    mouth = at[x[at, 1] == x[at, 1].min()]
    assert len(mouth) == 2 * 3
    assert np.ptp(u[mouth, 0]) > 1e-3


def test_without_the_key_they_are_refused(tmp_path):
    messages = refusals(tmp_path / "cracked.vtu", cracked(), doubled="refuse")
    assert any("nodes with another node at the same place" in text and "doubled_nodes" in text for text in messages)


def test_a_mesh_without_a_crack_is_named(tmp_path):
    (message,) = refusals(tmp_path / "box.vtu", generators.box((0.0, 0.0, 0.0), CELLS, CELLS))
    assert 'mesh.doubled_nodes = "crack" finds none' in message


def test_doubled_nodes_that_are_no_crack_are_named(tmp_path):
    """Two cells that touch along an edge with two nodes each: no face lies on another."""
    box = generators.box((0.0, 0.0, 0.0), (2.0, 2.0, 1.0), (2, 2, 1))
    cells = box.cells[[0, 3]]
    mesh = HexMesh(box.nodes[cells.reshape(-1)], np.arange(16, dtype=np.int32).reshape(2, 8))
    corners, stray = doubled_faces(mesh)
    assert not len(corners) and len(stray) == 4
    (message,) = refusals(tmp_path / "edge.vtu", mesh)
    assert "4 nodes have another node at their place and no face with another face at its place" in message


def test_a_crack_through_all_of_the_body_is_refused(tmp_path):
    """It falls into parts, as any other mesh would."""
    box = generators.box((0.0, 0.0, 0.0), CELLS, CELLS)
    on = np.flatnonzero(box.nodes[:, 0] == 3.0)
    number = np.arange(len(box.nodes))
    number[on] = len(box.nodes) + np.arange(len(on))
    cells = np.where((box.centroids[:, 0] > 3.0)[:, None], number[box.cells], box.cells).astype(np.int32)
    (message,) = refusals(tmp_path / "parts.vtu", HexMesh(np.concatenate([box.nodes, box.nodes[on]]), cells))
    assert "falls into 2 parts" in message


def test_fitted_factors_and_merging_do_not_go_with_it(tmp_path):
    with pytest.raises(ValueError, match=r"mesh\.doubled_nodes = .crack. keeps a crack across bonds"):
        scene(tmp_path / "cracked.vtu", cracked(), correction="fitted")
    with pytest.raises(ValueError, match=r"merge = 0\.1 makes one of nodes"):
        FileMesh(path="a.vtu", merge=0.1, doubled_nodes="crack")
