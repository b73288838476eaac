"""Loads and supports as vectors over the unknowns, and the rigid motions they leave free."""

import re

import numpy as np
import pytest

from pdfem_mpi import Simulation
from pdfem_mpi.deck.loads import BodyForce, Force, Support, Traction
from pdfem_mpi.deck.regions import Region
from pdfem_mpi.deck.table import SceneError
from pdfem_mpi.model.loads import remove_rigid_motion
from pdfem_mpi.model.motions import free_motions, rigid_modes
from pdfem_mpi.model.parts import positions
from pdfem_mpi.solvers import adr
from support.bodies import YOUNGS_MODULUS, build, make_scene

ROUND_OFF = 1e-13  # relative, of sums of some hundred terms
SOLVER_TOLERANCE = 1e-10  # of the residual; displacements of small bodies are then good to 1e-8
SOLVED = 1e-8

ELEMENTS = ((4, 2, 2), 4)
POINTS = ((4, 2, 2), 0)
COUPLED = ((6, 2, 2), 3)


def pull(face="x+", total=(1.0, 0.0, 0.0), **options):
    return Traction(kind="traction", face=face, total=total, **options)


def push(total=None, density=None, **where):
    return BodyForce(kind="body_force", total=total, density=density, **where)


HOLD = Support(face="x-", x=0.0, y=0.0, z=0.0)


def loaded(body, loads=(), supports=(HOLD,), **options):
    """A body with some loads; held at x- unless said otherwise."""
    cells, n_elements = body
    return build(make_scene(cells, n_elements, loads=tuple(loads), supports=tuple(supports), **options))


def refused(body, loads=(), supports=(), **options):
    """All sentences about loads and supports that cannot be."""
    with pytest.raises(SceneError) as caught:
        loaded(body, loads, supports, **options)
    return caught.value.messages


def on_nodes(body, vector):
    """Part of a vector over the unknowns that belongs to nodes, with their positions in the deck's units."""
    units = body.model.units
    return vector[3 * body.model.unknowns.n_points :].reshape(-1, 3), body.model.nodes.x * units.length + units.origin


def total_force(body):
    """Sum of the external forces in the deck's units."""
    modes = np.stack(list(rigid_modes(body.model)))[:3]
    return modes @ body.case.external * body.model.units.force


# --- tractions -------------------------------------------------------------------------------------------


def test_consistent_nodal_loads_of_a_square_grid():
    """Corners, edges, inside of a uniformly loaded face carry 1 : 2 : 4."""
    body = loaded(ELEMENTS, [pull()])
    forces, x = on_nodes(body, body.case.external * body.model.units.force)
    face = np.isclose(x[:, 0], 4.0)
    assert not forces[~face].any()
    assert not forces[:, 1:].any()
    at_rim = np.isclose(np.abs(x[face, 1:] - 1.0), 1.0).sum(axis=1)  # 2 at corners, 1 on edges, 0 inside
    np.testing.assert_allclose(forces[face, 0] * 16, np.array([4.0, 2.0, 1.0])[at_rim], rtol=ROUND_OFF)


def test_equal_nodal_loads():
    """Sec. 4.1, "uniform point forces": the same on all nodes of the face, with the same sum."""
    body = loaded(ELEMENTS, [pull(nodal="equal")])
    forces, x = on_nodes(body, body.case.external * body.model.units.force)
    face = np.isclose(x[:, 0], 4.0)
    np.testing.assert_allclose(forces[face], np.tile([1 / 9, 0.0, 0.0], (9, 1)), rtol=ROUND_OFF)
    assert not forces[~face].any()


@pytest.mark.parametrize("nodal", ["consistent", "equal"])
@pytest.mark.parametrize("face", ["x+", "y-", "y+", "z-", "z+"])
def test_traction_times_area_is_the_total(face, nodal):
    """A traction of any direction on a face of any normal acts with its area, in the deck's units."""
    area = 4.0 if face[0] == "x" else 8.0
    body = loaded(ELEMENTS, [Traction(kind="traction", face=face, traction=(3.0, -2.0, 1.0), nodal=nodal)])
    held = np.isclose(on_nodes(body, body.case.external)[1][:, 0], 0.0)
    free = loaded(ELEMENTS, [Traction(kind="traction", face=face, total=(3.0 * area, -2.0 * area, area), nodal=nodal)])
    np.testing.assert_allclose(body.case.external, free.case.external, rtol=ROUND_OFF, atol=1e-20)
    if face == "x+":
        np.testing.assert_allclose(total_force(body), np.array([3.0, -2.0, 1.0]) * area, rtol=ROUND_OFF)
    assert not on_nodes(body, body.case.external)[0][held].any()  # supports carry what acts on them


@pytest.mark.parametrize("face", ["x+", "y+", "z-"])
@pytest.mark.parametrize("body", [POINTS, COUPLED], ids=["points", "coupled"])
def test_traction_on_peridynamic_faces_is_the_total(body, face):
    """Points share the area of their cell's face, also where a face belongs to both models."""
    total = (3.0, -2.0, 0.5)
    found = loaded(body, [pull(face, total)])
    taken = np.nan_to_num(found.case.taken) * found.model.units.force  # by the support, where faces meet
    np.testing.assert_allclose(total_force(found) + taken, total, rtol=ROUND_OFF)


def test_equal_nodal_loads_of_peridynamic_faces_are_refused():
    """There are no nodes; the sentence names the load, counts the faces, and says what to use."""
    (sentence,) = refused(COUPLED, [pull("y+", nodal="equal")])
    assert sentence.startswith("loads.0.face = y+ has 6 of 12 faces on peridynamic cells")  # two are of the overlap
    assert 'Use nodal = "consistent"' in sentence


# --- forces at points and on lines ------------------------------------------------------------------------


@pytest.mark.parametrize("body", [ELEMENTS, POINTS, COUPLED], ids=["elements", "points", "coupled"])
@pytest.mark.parametrize(
    "where",
    [
        {"line": ((3.0, 2.0, 0.0), (3.0, 2.0, 2.0))},
        {"line": ((1.0, 2.0, 1.0), (4.0, 2.0, 1.0))},
        {"point": (4.0, 1.0, 1.0)},
    ],
    ids=["across", "along", "point"],
)
def test_a_force_is_spread_whole(body, where):
    """Over nodes, rows of points, or both; its components keep their ratio everywhere."""
    total = (3.0, -2.0, 0.5)
    found = loaded(body, [Force(kind="force", total=total, **where)])
    np.testing.assert_allclose(total_force(found), total, rtol=ROUND_OFF)
    rows = found.model.unknowns.rows(found.case.external)
    rows = rows[rows.any(axis=1)]
    np.testing.assert_allclose(rows[:, 1] / rows[:, 0], -2.0 / 3.0, rtol=ROUND_OFF)


def test_a_force_on_a_line_of_nodes_goes_by_length():
    """Ends carry half of what is carried between."""
    body = loaded(ELEMENTS, [Force(kind="force", line=((1.0, 2.0, 0.0), (4.0, 2.0, 0.0)), total=(0.0, -6.0, 0.0))])
    forces, x = on_nodes(body, body.case.external * body.model.units.force)
    carried = forces[:, 1] != 0.0
    order = np.argsort(x[carried, 0])
    np.testing.assert_allclose(forces[carried, 1][order], [-1.0, -2.0, -2.0, -1.0], rtol=ROUND_OFF)


# --- narrow supports --------------------------------------------------------------------------------------


def held_places(body):
    """Places with a prescribed displacement, the deck's units, and which components; points and nodes."""
    units, rows = body.model.units, body.model.unknowns.rows(body.case.fixed)
    x = positions(body.model) * units.length + units.origin
    chosen = rows.any(axis=1)
    return x[chosen], rows[chosen]


def test_a_line_of_nodes_is_held():
    body = loaded(ELEMENTS, supports=[HOLD, Support(line=((3.0, 0.0, 0.0), (3.0, 0.0, 2.0)), y=0.0)])
    x, components = held_places(body)
    on = x[:, 0] > 0.5
    assert sorted(map(tuple, x[on].round(9).tolist())) == [(3.0, 0.0, 0.0), (3.0, 0.0, 1.0), (3.0, 0.0, 2.0)]
    assert components[on].tolist() == [[False, True, False]] * 3


def test_a_row_of_points_is_held():
    """Of two cells beside the line the points of the one at lower coordinates that are nearest to it."""
    body = loaded(POINTS, supports=[HOLD, Support(line=((3.0, 0.0, 0.0), (3.0, 0.0, 2.0)), y=0.0)])
    x, _ = held_places(body)
    x = x[x[:, 0] > 1.0]
    inside = 0.5 - 0.5 / np.sqrt(3.0)
    expected = [(3.0 - inside, inside, z) for z in (inside, 1.0 - inside, 1.0 + inside, 2.0 - inside)]
    np.testing.assert_allclose(x[np.argsort(x[:, 2])], expected, rtol=0, atol=1e-12)


def test_nodes_and_points_in_a_box_are_held():
    """The box is that of places, not of the cells' centroids."""
    box = {"lower": (3.0, 0.0, 0.0), "upper": (3.4, 2.0, 2.0), "of": "nodes"}
    x, _ = held_places(loaded(ELEMENTS, supports=[HOLD, Support(**box, y=0.0)]))
    assert np.count_nonzero(x[:, 0] == 3.0) == 9
    x, _ = held_places(loaded(POINTS, supports=[HOLD, Support(**box, y=0.0)]))
    assert np.count_nonzero(x[:, 0] > 1.0) == 4 * 4


@pytest.mark.parametrize("body", [ELEMENTS, POINTS, COUPLED], ids=["elements", "points", "coupled"])
def test_displacements_by_place(body):
    """A formula on a face: its value at every node or point that is held there."""
    found = loaded(body, supports=[Support(face="x-", x=0.0, y="1e-3 * z * x + 2e-3", z="-sin(y) / 7")])
    rows, units = found.model.unknowns.rows(found.case.prescribed) * found.model.units.length, found.model.units
    x = positions(found.model) * units.length + units.origin
    held = found.model.unknowns.rows(found.case.fixed).all(axis=1)
    expected = np.stack([0.0 * x[:, 0], 1e-3 * x[:, 2] * x[:, 0] + 2e-3, -np.sin(x[:, 1]) / 7.0], axis=1)
    assert held.any()
    np.testing.assert_allclose(rows[held], expected[held], rtol=1e-12, atol=1e-15)
    assert found.case.moves == (True,)


@pytest.mark.parametrize(
    ("support", "says"),
    [
        ({"point": (3.3, 0.0, 0.0), "y": 0.0}, r"supports.0.point has no node .* it; the nearest is 0.3 away"),
        ({"line": ((0.0, 0.5, 0.0), (0.0, 0.5, 2.0)), "y": 0.0}, r"supports.0.line has no node .* 0.5 away"),
        ({"lower": (3.1, 0.0, 0.0), "upper": (3.2, 2.0, 2.0), "of": "nodes", "y": 0.0}, "no node of elements"),
        ({"face": "x-", "y": "1 / (y - 1)"}, r"supports.0.y = .* is not finite at \(0, 1, 0\)"),
        ({"face": "x-", "y": "log(-z)"}, r"is not finite at \(0, 0, 0\)"),
    ],
)
def test_supports_of_nothing_are_named(support, says):
    (sentence,) = refused(ELEMENTS, [pull()], [Support(**support)])
    assert re.search(says, sentence), sentence


# --- body forces -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("body", [ELEMENTS, POINTS, COUPLED], ids=["elements", "points", "coupled"])
@pytest.mark.parametrize(
    "where",
    [
        {"face": "x+"},
        {"face": "x+", "layers": 2},
        {"lower": (1.0, 0.0, 0.0)},
        {"lower": (1.0, 0.0, 1.0), "upper": (4.0, 1.0, 2.0)},
    ],
    ids=["face", "layers", "half-open box", "box"],
)
def test_body_force_adds_up_to_its_total(body, where):
    """Eq. 26 and the points' volumes: no force is lost at the overlap or between cells."""
    total = (3.0, -2.0, 0.5)
    found = loaded(body, [push(total, **where)])
    np.testing.assert_allclose(total_force(found), total, rtol=ROUND_OFF)


@pytest.mark.parametrize("body", [ELEMENTS, POINTS, COUPLED], ids=["elements", "points", "coupled"])
def test_density_times_volume_is_the_total(body):
    """A density on two layers of four unit cells is 8 densities of force."""
    by_density = loaded(body, [push(density=(0.0, 0.25, -0.5), face="x+", layers=2)])
    by_total = loaded(body, [push((0.0, 2.0, -4.0), face="x+", layers=2)])
    np.testing.assert_allclose(by_density.case.external, by_total.case.external, rtol=ROUND_OFF)
    np.testing.assert_allclose(total_force(by_total), [0.0, 2.0, -4.0], rtol=ROUND_OFF, atol=ROUND_OFF)


def test_body_force_on_a_region():
    """Points of the region share it; those of the overlap and the elements get none."""
    body = loaded(COUPLED, [push((0.0, 24.0, 0.0), region="bonds")])
    n = 3 * body.model.unknowns.n_points
    np.testing.assert_allclose(
        body.case.external[:n].reshape(-1, 3, 4)[:, 1] * body.model.units.force, 24.0 / 96, rtol=ROUND_OFF
    )
    assert not body.case.external[n:].any()


def test_loads_add_up():
    body = loaded(ELEMENTS, [pull(), pull("y+", (0.0, 1.0, 0.0)), push((0.0, 0.0, 2.0), face="x+")])
    one_by_one = [
        loaded(ELEMENTS, [load]).case.external
        for load in (pull(), pull("y+", (0.0, 1.0, 0.0)), push((0.0, 0.0, 2.0), face="x+"))
    ]
    np.testing.assert_allclose(body.case.external, np.sum(one_by_one, axis=0), rtol=ROUND_OFF, atol=1e-20)


def test_selection_without_cells_is_refused():
    sentences = refused(
        POINTS,
        [push((1.0, 0.0, 0.0), lower=(0.1, 0.1, 0.1), upper=(0.2, 0.2, 0.2))],
        [Support(lower=(9.0, 9.0, 9.0), x=0.0)],
    )
    assert [sentence.split(" selects no cell")[0] for sentence in sentences] == ["loads.0", "supports.0"]


# --- balance and rigid motions ---------------------------------------------------------------------------


@pytest.mark.parametrize("axis", "xyz")
def test_force_on_a_free_body_is_refused_naming_the_motion(axis):
    total = tuple(float(name == axis) for name in "xyz")
    (sentence,) = refused(POINTS, [push(total, lower=(0.0, 0.0, 0.0))])
    assert sentence.startswith("loads are not in balance")
    assert f"no support holds the translation along {axis}" in sentence


@pytest.mark.parametrize("axis", "xyz")
def test_moment_on_a_free_body_is_refused_naming_the_motion(axis):
    """A couple: opposite forces along the next axis, at the ends of the last one."""
    order = "xyzxy"
    along, lever = order["xyz".index(axis) + 1], order["xyz".index(axis) + 2]
    total = np.array([float(name == along) for name in "xyz"])
    loads = [push(tuple(total), face=f"{lever}+"), push(tuple(-total), face=f"{lever}-")]
    (sentence,) = refused(POINTS, loads)
    assert f"no support holds the rotation about {axis}" in sentence
    assert "their sum is a force of (0, 0, 0)" in sentence


@pytest.mark.parametrize("body", [ELEMENTS, POINTS, COUPLED], ids=["elements", "points", "coupled"])
def test_motions_that_supports_leave_free(body):
    """A face held along its normal leaves two translations and a rotation; held in its plane too, nothing."""
    assert len(loaded(body, supports=[]).case.free_motions) == 6
    assert len(loaded(body, supports=[Support(face="x-", x=0.0)]).case.free_motions) == 3
    assert len(loaded(body, supports=[Support(face="x-", x=0.0), Support(face="y-", y=0.0)]).case.free_motions) == 1
    assert len(loaded(body).case.free_motions) == 0


def test_load_across_a_sliding_support_is_refused():
    """Held along x only and pushed along y: that motion is named, and nothing is said of x."""
    (sentence,) = refused(ELEMENTS, [pull(total=(1.0, 0.5, 0.0))], [Support(face="x-", x=0.0)])
    assert "no support holds the translation along y" in sentence


def test_load_that_turns_a_body_about_a_hinge_is_refused_as_a_rotation():
    """Nodes of x- held along z are a hinge about y for forces along z; the translation along z is held."""
    (sentence,) = refused(ELEMENTS, [pull(total=(0.0, 0.0, 1.0))], [Support(face="x-", z=0.0)])
    assert "no support holds the rotation about y" in sentence


def test_free_motions_move_no_fixed_unknown():
    body = loaded(COUPLED, supports=[Support(face="x-", x=0.0)])
    modes = body.case.free_motions @ np.stack(list(rigid_modes(body.model)))
    assert np.abs(modes[:, body.case.fixed]).max() <= 1e-7 * np.abs(modes).max()
    assert free_motions(body.model, body.case.fixed).tolist() == body.case.free_motions.tolist()


@pytest.mark.parametrize("body", [ELEMENTS, POINTS, COUPLED], ids=["elements", "points", "coupled"])
def test_rigid_motions_are_removed_and_strains_stay(body):
    """What is left has no mean translation or rotation; a body that is held keeps all of its displacement."""
    free = loaded(body, supports=[])
    strain = free.of_positions(lambda x: x * np.array([1.0, -0.25, -0.25]))
    motion = np.array([0.3, -0.2, 0.5, 0.1, 0.2, -0.3]) @ np.stack(list(rigid_modes(free.model)))
    u = strain + motion
    remove_rigid_motion(free.model, free.case, u)
    np.testing.assert_allclose(u, strain, rtol=0, atol=ROUND_OFF * np.abs(motion).max())
    held = loaded(body)
    u = motion.copy()
    remove_rigid_motion(held.model, held.case, u)
    np.testing.assert_array_equal(u, motion)


@pytest.mark.parametrize("body", [ELEMENTS, POINTS, COUPLED], ids=["elements", "points", "coupled"])
def test_volumes_of_the_unknowns_fill_the_body(body):
    """The mean over the volume counts cells of the overlap once."""
    volume = loaded(body, supports=[]).case.volume
    assert loaded(body).case.volume is None  # nothing moves freely
    assert volume.sum() / 3 == pytest.approx(np.prod(body[0]), rel=ROUND_OFF)


# --- supports --------------------------------------------------------------------------------------------


def test_support_on_a_face_takes_nodes_of_elements_and_layers_of_points():
    """On elements the nodes of the face, on peridynamic cells the points of the layers beneath it."""
    body = loaded(COUPLED, supports=[Support(face="y-", y=0.0), HOLD])
    nodes, x = on_nodes(body, body.case.fixed)
    np.testing.assert_array_equal(nodes[:, 1], np.isclose(x[:, 1], 0.0) | np.isclose(x[:, 0], 0.0))
    points = body.case.fixed[: 3 * body.model.unknowns.n_points].reshape(-1, 3, 4)
    assert np.count_nonzero(points[:, 1]) == 8 * 3 * 2  # one layer: 3 x 2 cells
    assert not points[:, [0, 2]].any()


def test_prescribed_displacements_are_those_of_the_deck():
    body = loaded(COUPLED, supports=[Support(face="x+", layers=2, x=0.25), HOLD])
    case, length = body.case, body.model.units.length
    points = slice(0, 3 * body.model.unknowns.n_points)
    assert np.count_nonzero(case.fixed[points]) == 2 * 4 * 8
    np.testing.assert_array_equal(case.prescribed[points][case.fixed[points]] * length, 0.25)
    assert not case.prescribed[~case.fixed].any()


def test_supports_that_contradict_name_both_values_and_the_count():
    (sentence,) = refused(ELEMENTS, [], [HOLD, Support(face="y-", x=0.125)])
    assert sentence.startswith("supports.1.x = 0.125 contradicts 0, prescribed by an earlier support at 3 of")


def test_supports_may_agree():
    case = loaded(ELEMENTS, supports=[HOLD, Support(face="y-", x=0.0)]).case
    assert np.count_nonzero(case.fixed) == 9 * 3 + (15 - 3)


def test_prescribed_ends_strain_elements_uniformly():
    """Ends of x prescribed, sides free to contract on symmetry planes: u_x = eps x, u_y = -nu eps y."""
    supports = [
        Support(face="x-", x=0.0),
        Support(face="x+", x=0.004),
        Support(face="y-", y=0.0),
        Support(face="z-", z=0.0),
    ]
    body = loaded(ELEMENTS, supports=supports, tolerance=SOLVER_TOLERANCE, poissons_ratio=0.3)
    case, state = body.case, body.state
    state.u[case.fixed] = case.prescribed[case.fixed]
    adr.solve(body.forces, state, case.external, case.fixed, SOLVER_TOLERANCE, 5000)
    u, x = on_nodes(body, state.u * body.model.units.length)
    expected = 0.001 * x * np.array([1.0, -0.3, -0.3])
    np.testing.assert_allclose(u, expected, rtol=0, atol=SOLVED * 0.004)


def test_region_names_select_their_cells():
    scene = make_scene((4, 2, 2), 0, regions=(Region(name="all", model="peridynamics"),), loads=())
    support = Support(region="all", x=0.5)
    body = build(scene.model_copy(update={"supports": (support,)}))
    assert np.count_nonzero(body.case.fixed) == 8 * 16


@pytest.mark.parametrize("correction", ["none", "virial", "fitted"])
@pytest.mark.parametrize("cells", [(4, 2, 2), (1, 2, 2)])
def test_tractions_on_bonds_are_as_large_as_they_say(cells, correction):
    """The points behind a face are pushed back; in one cell both faces pull at the same points."""
    loads = tuple(Traction(kind="traction", face=f, total=(t, 0.0, 0.0)) for f, t in (("x-", -9.0), ("x+", 9.0)))
    scene = make_scene(cells, loads=loads, correction=correction, solver="cg", tolerance=1e-10)
    row = Simulation(scene).solve(0.5)
    assert row["reaction"] == pytest.approx(4.5, rel=1e-12)
    if correction == "fitted" and cells[0] > 1:  # whose faces move apart as those of elements
        area = cells[1] * cells[2]
        assert row["displacement"] == pytest.approx(4.5 / area / YOUNGS_MODULUS * cells[0], rel=1e-6)
