"""Scenes on mesh files: the answer of the same cells made by a generator, in any numbering, and loads on named sets."""

from __future__ import annotations

import numpy as np
import pytest

from pdfem_mpi.deck.loads import BodyForce, Support, Traction
from pdfem_mpi.deck.meshes import BoxMesh, FileMesh, PlateWithHoleMesh
from pdfem_mpi.deck.regions import Region
from pdfem_mpi.deck.table import SceneError
from pdfem_mpi.measure.fields import fields_sha256
from pdfem_mpi.mesh.generators import box, plate_with_hole
from pdfem_mpi.mesh.hexmesh import HexMesh
from pdfem_mpi.stepping import follow_load_program, make_solver
from support.bodies import YOUNGS_MODULUS, build, make_scene
from support.mesh_files import SUFFIXES, write_mesh
from support.reporters import Silence

CELLS = 2, 3, 8  # finite elements in z < 4, peridynamics above; numbers of cells run with z
HELD = (Support(face="x-", x=0.0, y=0.0, z=0.0),)
# Another numbering adds the terms of an element's forces, and takes the Gauss points of a cell, in another order:
# round-off of the displacements at a residual of 1e-12; measured 3e-13 of the largest.
RENUMBERED = 1e-12


def solve(scene):
    """Body and fields of a scene at load factor 1."""
    body = build(scene)
    solver = make_solver(scene, body.share, body.forces, body.case, Silence().line)
    steps = follow_load_program(scene, solver, None, body.state, body.case)
    assert len(list(steps)) == 1
    return body, body.fields(body.state.u)


def coupled(mesh, by_set, tolerance=1e-8):
    """A bar along z, held in z and loaded at its ends through sets of the file, or through faces and boxes."""
    middle = float(CELLS[2] // 2)
    sets = {
        "low": {"set": "low"} if by_set else {"upper": (9.0, 9.0, middle)},
        "high": {"set": "high"} if by_set else {"lower": (0.0, 0.0, middle)},
        "bottom": {"set": "bottom"} if by_set else {"face": "z-"},
        "top": {"set": "top"} if by_set else {"face": "z+"},
    }
    regions = (
        Region(name="elements", model="finite_elements", **sets["low"]),
        Region(name="bonds", model="peridynamics", **sets["high"]),
    )
    return make_scene(
        CELLS,
        regions=regions,
        loads=(
            BodyForce(kind="body_force", total=(0.3, 0.1, 2.0), layers=2, **sets["top"]),
            Traction(kind="traction", total=(0.0, 0.2, -1.0), **sets["bottom"]),
        ),
        supports=(Support(x=0.0, y=0.0, z=0.0, **sets["bottom"]),),
        solver="cg",
        tolerance=tolerance,
        mesh=mesh,
    )


@pytest.fixture(scope="module")
def bar():
    """The bar's cells and sets, its answer, and what it was made of."""
    mesh = box((0.0, 0.0, 0.0), tuple(map(float, CELLS)), CELLS)
    half = len(mesh.cells) // 2
    sets = {
        "regions": {"low": np.arange(half), "high": np.arange(half, 2 * half)},
        "faces": {"bottom": mesh.faces_on_face("z-")[1], "top": mesh.faces_on_face("z+")[1]},
        "nodes": {name: np.flatnonzero(mesh.nodes_on_face(face)) for name, face in (("bottom", "z-"), ("top", "z+"))},
    }
    generated = BoxMesh(lower=(0.0, 0.0, 0.0), upper=tuple(map(float, CELLS)), spacing=1.0)
    return mesh, sets, solve(coupled(generated, False))[1]


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_same_cells_from_a_file_give_the_same_bits(tmp_path, bar, suffix):
    """Elements, overlap and bonds; regions, loads and supports by sets where the format has their names."""
    mesh, sets, expected = bar
    write_mesh(tmp_path / f"bar{suffix}", mesh, **sets)
    entry = FileMesh(path=str(tmp_path / f"bar{suffix}"), spacing=1.0)
    assert fields_sha256(solve(coupled(entry, suffix != ".vtu"))[1]) == fields_sha256(expected)


def renumbered(mesh, seed):
    """The same body: nodes and cells in another order, and other corners of cells first."""
    random = np.random.default_rng(seed)
    place = random.permutation(len(mesh.nodes))
    nodes = np.empty_like(mesh.nodes)
    nodes[place] = mesh.nodes
    cells = place[mesh.cells]
    about_z, about_x = [1, 2, 3, 0, 5, 6, 7, 4], [3, 2, 6, 7, 0, 1, 5, 4]
    for turn in (about_z, about_x, about_z):
        chosen = random.random(len(cells)) < 0.5
        cells[chosen] = cells[chosen][:, turn]
    order = random.permutation(len(cells))
    number = np.argsort(order)
    return HexMesh(nodes, cells[order].astype(np.int32)), place, number


@pytest.mark.parametrize("seed", [1, 2])
def test_another_numbering_gives_the_same_answer(tmp_path, bar, seed):
    """Fields are compared at their places, to round-off."""
    mesh, sets, _ = bar
    generated = BoxMesh(lower=(0.0, 0.0, 0.0), upper=tuple(map(float, CELLS)), spacing=1.0)
    first, expected = solve(coupled(generated, False, 1e-12))
    other, place, number = renumbered(mesh, seed)
    named = {kind: {name: place[members] for name, members in sets[kind].items()} for kind in ("faces", "nodes")}
    regions = {name: number[members] for name, members in sets["regions"].items()}
    write_mesh(tmp_path / "bar.inp", other, regions, **named)
    second, found = solve(coupled(FileMesh(path=str(tmp_path / "bar.inp"), spacing=1.0), True, 1e-12))
    largest = np.abs(expected.u_nodes).max(), np.abs(expected.u_points).max()
    for body, fields in ((first, expected), (second, found)):
        x = body.share.mesh.nodes[body.share.node_row >= 0]
        order = np.lexsort(x.T)
        fields.u_nodes[:] = fields.u_nodes[order]
        order = np.lexsort(np.round(body.geometry.point_positions, 6).T)
        fields.u_points[:] = fields.u_points[order]
    np.testing.assert_allclose(found.u_nodes, expected.u_nodes, rtol=0, atol=RENUMBERED * largest[0])
    np.testing.assert_allclose(found.u_points, expected.u_points, rtol=0, atol=RENUMBERED * largest[1])


def test_plate_from_a_file_gives_the_bits_of_the_generator(tmp_path):
    """Distorted cells; 17 digits of text are enough."""
    lower, upper = (0.0, 0.0, 0.0), (12.0, 12.0, 1.0)
    generated = PlateWithHoleMesh(lower=lower, upper=upper, hole_radius=2.5, spacing=1.0)
    write_mesh(tmp_path / "plate.inp", plate_with_hole(lower, upper, 2.5, 1.0))
    keys = {"supports": HELD, "loads": (Traction(kind="traction", face="x+", total=(1.0, 0.0, 0.0)),), "solver": "cg"}
    answers = [
        fields_sha256(solve(make_scene((1, 1, 1), 1, mesh=mesh, **keys))[1])
        for mesh in (generated, FileMesh(path=str(tmp_path / "plate.inp")))
    ]
    assert answers[0] == answers[1]


# --- what a set selects -------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def cube(tmp_path_factory):
    """A file of 3 x 3 x 3 cells with sets of every kind, and a function that makes its load case."""
    mesh = box((0.0, 0.0, 0.0), (3.0, 3.0, 3.0), (3, 3, 3))
    top = mesh.faces_on_face("z+")[1]
    inner = mesh.cells[0][[[4, 5, 6, 7]]]
    path = tmp_path_factory.mktemp("cube") / "cube.inp"
    names = {
        "regions": {"slab": np.arange(9), "rest": np.arange(9, 27)},
        "faces": {"top": top[:, ::-1], "some": top[:4], "inner": inner},
        "nodes": {"top_nodes": np.unique(top), "corner": [0], "edge": [0, 1, 2, 3], "slab": np.arange(16)},
    }
    write_mesh(path, mesh, **names)

    def case(n_elements, loads=(), supports=HELD):
        mesh = FileMesh(path=str(path), spacing=1.0)
        body = build(make_scene((3, 3, 3), n_elements, loads=loads, supports=supports, mesh=mesh))
        return body.case.external, np.where(body.case.fixed, body.case.prescribed, np.nan)

    return case


def refused(cube, *arguments, **entries):
    with pytest.raises(SceneError) as caught:
        cube(*arguments, **entries)
    return caught.value.messages


@pytest.mark.parametrize("name", ["top", "top_nodes"])
@pytest.mark.parametrize("nodal", ["consistent", "equal"])
def test_traction_on_a_set_is_that_on_the_face(cube, name, nodal):
    """Faces in any winding, or all nodes of faces."""
    keys = {"kind": "traction", "total": (0.0, 1.0, 3.0), "nodal": nodal}
    by_face, by_set = (cube(3, (Traction(**keys, **place),))[0] for place in ({"face": "z+"}, {"set": name}))
    np.testing.assert_array_equal(by_set, by_face)
    free = {"consistent": 5 / 6, "equal": 3 / 4}[nodal]  # the others act on nodes that are held, at x = 0
    assert by_set.sum() == pytest.approx(free * 4.0 / YOUNGS_MODULUS)


@pytest.mark.parametrize("n_elements", [0, 3])
@pytest.mark.parametrize(("name", "layers"), [("top", 1), ("top", 2), ("top_nodes", 1)])
def test_body_force_beneath_a_set_of_faces(cube, n_elements, name, layers):
    keys = {"kind": "body_force", "total": (0.0, 1.0, 3.0), "layers": layers}
    by_face, by_set = (cube(n_elements, (BodyForce(**keys, **place),))[0] for place in ({"face": "z+"}, {"set": name}))
    np.testing.assert_array_equal(by_set, by_face)
    assert by_set.any()


@pytest.mark.parametrize("n_elements", [0, 3])
def test_body_force_on_a_set_of_cells(cube, n_elements):
    """A name of cells and of nodes means the cells."""
    keys = {"kind": "body_force", "density": (0.0, 1.0, 3.0)}
    places = {"upper": (3.0, 3.0, 1.0)}, {"set": "slab"}
    by_box, by_set = (cube(n_elements, (BodyForce(**keys, **place),))[0] for place in places)
    np.testing.assert_array_equal(by_set, by_box)


@pytest.mark.parametrize("name", ["top", "top_nodes"])
@pytest.mark.parametrize("n_elements", [0, 3])
def test_support_on_a_set_is_that_on_the_face(cube, n_elements, name):
    places = {"face": "z+"}, {"set": name}
    by_face, by_set = (cube(n_elements, supports=(Support(x=0.0, y=0.5, **place),))[1] for place in places)
    np.testing.assert_array_equal(by_set, by_face)
    assert np.count_nonzero(by_set == 0.5 / 1.0) == (16 if n_elements else 72)


def test_support_on_single_nodes_of_elements(cube):
    supports = Support(set="corner", x=0.0, y=0.0, z=0.0), Support(set="edge", y=0.0, z=0.0)
    fixed = ~np.isnan(cube(3, supports=supports)[1]).reshape(-1, 3)
    assert fixed.sum(axis=0).tolist() == [1, 4, 4]


def test_support_on_a_name_of_cells_and_nodes_means_the_nodes(cube):
    """Abaqus calls the nodes of a face and the elements beneath it by one name."""
    fixed = ~np.isnan(cube(3, supports=(Support(set="slab", x=0.0, y=0.0, z=0.0),))[1])
    assert fixed.sum() == 3 * 16


def test_support_on_single_nodes_of_peridynamic_cells_is_refused(cube):
    (message,) = refused(cube, 0, supports=(Support(set="edge", z=0.0),))
    assert message.startswith("supports.0.set = edge has 4 nodes of peridynamic cells that make up no face of one")


def test_faces_inside_the_body_are_refused(cube):
    (message,) = refused(cube, 3, (Traction(kind="traction", set="inner", total=(1.0, 0.0, 0.0)),))
    assert message.startswith('loads.0.set = "inner" has 1 of 1 faces that are not faces of cells on the boundary')
    assert "the first at (0.5, 0.5, 1)" in message


def test_equal_shares_on_peridynamic_cells_name_the_set(cube):
    (message,) = refused(cube, 2, (Traction(kind="traction", set="top", total=(1.0, 0.0, 0.0), nodal="equal"),))
    assert message.startswith("loads.0.set = top has 3 of 9 faces on peridynamic cells")
    assert message.endswith('Use nodal = "consistent".')


@pytest.mark.parametrize(
    ("load", "words"),
    [
        ({"kind": "traction", "set": "slaab"}, ('= "slaab" is not a set', "Did you mean slab?")),
        ({"kind": "traction", "set": "rest"}, ("is a set of cells, and a set of faces or nodes",)),
        ({"kind": "traction", "set": "edge"}, ("holds all nodes of no face of the boundary",)),
        ({"kind": "body_force", "set": "rest", "layers": 2}, ("loads.0.layers = 2 counts",)),
        ({"kind": "body_force", "set": "x"}, ("The mesh file's sets of cells or faces or nodes",)),
    ],
)
def test_sets_that_cannot_serve_are_refused_with_the_reason(cube, load, words):
    model = Traction if load["kind"] == "traction" else BodyForce
    (message,) = refused(cube, 3, (model(**load, total=(1.0, 0.0, 0.0)),))
    assert all(word in message for word in words), message


def test_cells_in_two_regions_and_in_none(tmp_path):
    """Sets of Abaqus may overlap; every cell needs one region."""
    mesh = box((0.0, 0.0, 0.0), (4.0, 1.0, 1.0), (4, 1, 1))
    write_mesh(tmp_path / "bar.inp", mesh, {"a": [0, 1], "b": [1, 2]})
    regions = tuple(Region(name=name, model="finite_elements", set=name) for name in "ab")
    mesh = FileMesh(path=str(tmp_path / "bar.inp"))
    scene = make_scene((1, 1, 1), regions=regions, loads=(), supports=HELD, mesh=mesh)
    with pytest.raises(SceneError) as caught:
        build(scene)
    twice, left = caught.value.messages
    assert twice.startswith("regions.b overlaps regions.a in 1 cells, the first 1 at (1.5, 0.5, 0.5)")
    assert left.startswith("regions leave out 1 of 4 cells, the first 3 at (3.5, 0.5, 0.5)")
