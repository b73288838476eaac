"""Places that move as one: driven by a force they do what places do that a support drives."""

import numpy as np
import pytest

from pdfem_mpi.deck.loads import Force, Support, Traction
from pdfem_mpi.deck.peridynamics import Crack
from pdfem_mpi.deck.restraints import Tie
from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.deck.table import SceneError
from pdfem_mpi.parallel.comm import mpi
from pdfem_mpi.runs.simulation import Simulation
from support.bodies import YOUNGS_MODULUS, build, make_scene
from support.failing import failing
from support.held import beam

CELLS = (4, 2, 2)
SOLVED = 1e-7  # ten times the solver's tolerance
WALL = (Support(face="x-", x=0.0, y=0.0, z=0.0, name="wall"),)


def solved(n_elements, solver="cg", kinematics="linear", cells=CELLS, **tables):
    scene = make_scene(
        cells, n_elements, kinematics=kinematics, correction="virial", loads=(), solver=solver, tolerance=1e-8
    )
    simulation = Simulation(Scene.model_validate({**dict(scene), **tables}), mpi().COMM_SELF)
    return simulation, simulation.solve(1.0)


@pytest.mark.parametrize("solver", ["cg", "adr"])
@pytest.mark.parametrize("kinematics", ["linear", "finite"])
@pytest.mark.parametrize("n_elements", [0, 2, 4])
def test_a_force_on_a_tie_does_what_a_support_does(n_elements, kinematics, solver):
    """A platen that is pushed at one corner moves by u; a support that moves it by u takes that force, alike."""
    push = (Force(kind="force", line=((4.0, 2.0, 0.0), (4.0, 2.0, 2.0)), total=(0.0, -3.0, 0.0)),)
    platen = (Tie(face="x+", along=("y",), name="pin"),)
    tied, row = solved(n_elements, solver, kinematics, supports=WALL, loads=push, ties=platen)
    driven = (*WALL, Support(face="x+", y=row["pin.u_y"], name="pin"))
    other, there = solved(n_elements, solver, kinematics, supports=driven)
    assert there["pin.force_y"] == pytest.approx(-3.0, rel=SOLVED)
    assert row["wall.force_y"] == pytest.approx(3.0, rel=SOLVED)
    size = np.abs(other.state.u).max()
    np.testing.assert_allclose(tied.state.u, other.state.u, rtol=0, atol=SOLVED * size)
    (group,) = tied.model.ties.groups
    assert np.ptp(tied.state.u[group.index]) <= 1e-15 * size
    assert row["force_balance"] < 1e-12 and row["moment_balance"] < 1e-12


def test_a_guided_beam():
    """A cantilever whose end cannot turn: F L^3 / (12 E I) and the shear of a rectangle."""
    length, height, depth = 8.0, 1.0, 0.5
    scene = make_scene((32, 4, 2), 32, loads=(), solver="cg", tolerance=1e-8)
    mesh = scene.mesh.model_copy(update={"upper": (length, height, depth), "spacing": 0.25})
    regions = (scene.regions[0].model_copy(update={"upper": None, "lower": None}),)
    tables = {
        "mesh": mesh,
        "regions": regions,
        "supports": WALL,
        "loads": (Traction(kind="traction", face="x+", total=(0.0, 1.0, 0.0)),),
        "ties": (Tie(face="x+", along=("x", "y"), name="end"),),
    }
    row = Simulation(Scene.model_validate({**dict(scene), **tables}), mpi().COMM_SELF).solve(1.0)
    inertia, shear = depth * height**3 / 12.0, YOUNGS_MODULUS / 2.5 * height * depth / 1.2
    expected = length**3 / (12.0 * YOUNGS_MODULUS * inertia) + length / shear
    assert row["end.u_y"] == pytest.approx(expected, rel=0.05)  # 4.1 % too stiff: four linear elements
    assert row["end.u_x"] == pytest.approx(0.0, abs=1e-9)


def test_a_tie_holds_the_motions_that_it_does_not_follow():
    """A face whose places have one displacement along x turns about x alone."""
    scene = make_scene(CELLS, 4, loads=())
    body = build(Scene.model_validate({**dict(scene), "ties": (Tie(face="x+", along=("x",)),)}))
    assert len(body.case.free_motions) == 4 and len(body.case.untied_motions) == 6
    assert np.abs(body.case.free_motions[:, [4, 5]]).max() < 1e-9


def test_a_tie_holds_no_part_that_moves_with_it():
    """Half of a bar that a crack cuts off: the tie on its end keeps it from turning about y and z, and no more."""
    crack = {"cracks": (Crack(polygon=((8.0, -1.0, -1.0), (8.0, 9.0, -1.0), (8.0, 9.0, 9.0), (8.0, -1.0, 9.0))),)}
    scene = make_scene((12, 3, 2), 0, loads=(), supports=WALL)
    tables = crack | {"ties": (Tie(face="x+", along=("x",)),)}
    body = build(Scene.model_validate({**dict(scene), **tables}))
    (part,) = body.case.unsupported
    assert len(part.motions) == 4
    assert np.abs(part.motions[:, [4, 5]]).max() < 1e-9
    (both,) = build(Scene.model_validate({**dict(scene), **crack})).case.unsupported
    assert len(both.motions) == 6


def test_the_states_of_a_tied_beam_are_in_balance():
    """Every support, spring and load of one failing beam: forces add up at every row, and the books close."""
    run = failing(beam())
    rows = list(run.follow(6))
    assert rows[-1].broken > 0
    units = run.body.model.units
    for row in rows:
        loads = -1.1 * row.load_factor - 1e-3 * 38.0  # half of a middle of 5 x 4 x 2 cells less the notch of 2
        assert (row.resultant[1] * units.force) == pytest.approx(-loads, rel=1e-6)
        assert abs(row.ledger_error) < 1e-9


@pytest.mark.parametrize(
    ("ties", "says"),
    [
        ((Tie(face="x-", along=("y",)),), r"ties\.0\.along = y ties 9 places, and 9 of them are held along y by"),
        ((Tie(point=(4.0, 0.0, 0.0), along=("y",)),), r"ties\.0\.along = y ties one place to itself"),
        (
            (Tie(face="x+", along=("y", "z")), Tie(face="y+", along=("x", "y"))),
            r"ties\.1\.along = y ties .* places.*",
        ),
        ((Tie(line=((9.0, 0.0, 0.0), (9.0, 2.0, 0.0)), along=("y",)),), r"ties\.0\.line has no node of the mesh on it"),
        ((Tie(lower=(9.0, 0.0, 0.0), along=("y",)),), r"ties\.0 selects no cell of the mesh"),
    ],
)
def test_ties_that_cannot_be_are_named(ties, says):
    with pytest.raises(SceneError, match=says):
        build(Scene.model_validate({**dict(make_scene(CELLS, 4, supports=WALL, loads=())), "ties": ties}))


@pytest.mark.parametrize(
    ("tie", "says"),
    [
        ({"face": "x+", "along": ()}, "along"),
        ({"face": "x+", "along": ("y", "y")}, "has a direction twice"),
        ({"along": ("y",)}, "must say where by exactly one of region, face, set, point, line or lower/upper"),
    ],
)
def test_ties_of_nothing_are_refused_by_their_deck(tie, says):
    with pytest.raises(ValueError, match=says):
        Tie(**tie)


def test_displacements_that_a_script_gives_are_tied():
    """Nothing later would tie them: steps of the solver are tied, and so is what they are added to."""
    simulation, _ = solved(4, supports=WALL, ties=(Tie(face="x+", along=("x",), name="pin"),))
    simulation.displace(lambda x: 0.01 * x[:, ::-1] * x[:, :1])
    pin = np.abs(simulation.nodes[:, 0] - 4.0) < 1e-9
    assert np.ptp(simulation.fields().u_nodes[pin, 0]) <= 1e-15
