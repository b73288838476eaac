"""Springs to ground: their stiffness, their forces, what they store, and bodies that nothing else holds."""

import numpy as np
import pytest

from pdfem_mpi.deck.loads import Force, Support, Traction
from pdfem_mpi.deck.programs import Events
from pdfem_mpi.deck.restraints import Spring
from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.deck.table import SceneError
from pdfem_mpi.parallel.comm import mpi
from pdfem_mpi.runs.simulation import Simulation
from support.bodies import YOUNGS_MODULUS, build, make_scene
from support.failing import failing, strip

CELLS = (4, 2, 2)
SOLVED = 1e-7  # ten times the solver's tolerance
CLOSED = 1e-10  # of the work


def pulled(n_elements, springs, solver="cg", kinematics="linear", loads=None, supports=None, cells=CELLS):
    """A bar that springs hold along x, pulled by a force of 2 at its other end: the simulation and its row."""
    scene = make_scene(
        cells,
        n_elements,
        kinematics=kinematics,
        correction="virial",
        loads=(Traction(kind="traction", face="x+", total=(2.0, 0.0, 0.0)),) if loads is None else loads,
        supports=(Support(face="y-", y=0.0), Support(face="z-", z=0.0)) if supports is None else supports,
        solver=solver,
        tolerance=1e-8,
    )
    simulation = Simulation(Scene.model_validate({**dict(scene), "springs": springs}), mpi().COMM_SELF)
    return simulation, simulation.solve(1.0)


@pytest.mark.parametrize("solver", ["cg", "adr"])
@pytest.mark.parametrize("kinematics", ["linear", "finite"])
def test_a_bar_of_elements_on_a_spring(solver, kinematics):
    """u = F / k + F x / (E A), the spring spread over the end by area; finite strains are of order 5e-4."""
    simulation, row = pulled(4, (Spring(face="x-", name="base", stiffness=(50.0, 0.0, 0.0)),), solver, kinematics)
    x, u = simulation.nodes, simulation.fields().u_nodes
    expected = 2.0 / 50.0 + 2.0 * x[:, 0] / (YOUNGS_MODULUS * 4.0)
    bent = SOLVED if kinematics == "linear" else 1e-3
    np.testing.assert_allclose(u[:, 0], expected, rtol=bent)
    assert row["base.force_x"] == pytest.approx(-2.0, rel=SOLVED)
    assert row["reaction_x"] == row["base.force_x"]
    assert row["force_balance"] < 1e-12


@pytest.mark.parametrize(
    "place", [{"face": "x-"}, {"line": ((0.0, 0.0, 0.0), (0.0, 2.0, 0.0))}, {"point": (0.0, 1.0, 1.0)}]
)
@pytest.mark.parametrize("n_elements", [0, 2, 4])
def test_the_whole_of_a_spring_is_its_stiffness(n_elements, place):
    """However it is spread, over nodes or points: all of its parts add up, and none is negative."""
    body = build(Scene.model_validate({
        **dict(make_scene(CELLS, n_elements)),
        "springs": (Spring(stiffness=(7.0, 0.0, 3.0), **place),),
    }))  # fmt: skip
    springs, units = body.model.springs, body.model.units
    along = body.model.unknowns.components()[springs.index]
    total = [springs.stiffness[along == d].sum() * units.force / units.length for d in range(3)]
    assert total == pytest.approx([7.0, 0.0, 3.0], rel=1e-11)
    assert (springs.stiffness > 0.0).all()
    assert springs.of_nodes.sum(axis=0) * units.force / units.length == pytest.approx(total, rel=1e-11)


@pytest.mark.parametrize("n_elements", [0, 2, 4])
def test_springs_alone_hold_a_body(n_elements):
    """Soft and stiff ones at three corners: as many iterations as a held body takes, and their forces are the load."""
    corners = {"a": (0.0, 0.0, 0.0), "b": (0.0, 2.0, 0.0), "c": (0.0, 0.0, 2.0)}
    push = (Force(kind="force", point=(4.0, 1.0, 1.0), total=(0.3, -1.0, 0.5)),)
    for stiffness in (0.3, 10.0, 1e5):
        springs = tuple(
            Spring(name=name, point=at, stiffness=(stiffness, stiffness, stiffness)) for name, at in corners.items()
        )
        simulation, row = pulled(n_elements, springs, loads=push, supports=())
        assert not len(simulation.case.free_motions)
        total = [sum(row[f"{name}.force_{axis}"] for name in corners) for axis in "xyz"]
        assert total == pytest.approx([-0.3, 1.0, -0.5], abs=SOLVED)
        assert row["evaluations"] < 120


def test_a_spring_is_a_diagonal_entry_of_the_stiffness():
    """The residual beside springs less that without them is -k u, of any displacement and in finite kinematics."""
    for kinematics in ("linear", "finite"):
        scene = make_scene(CELLS, 2, kinematics=kinematics)
        held = Spring(face="x-", stiffness=(7.0, 2.0, 3.0))
        with_it = build(Scene.model_validate({**dict(scene), "springs": (held, held)}))
        without = build(scene)
        u = 1e-3 * np.random.default_rng(2).standard_normal(with_it.model.n_unknowns)
        found, other = np.empty_like(u), np.empty_like(u)
        with_it.forces.evaluate_surely(u, np.zeros_like(u), found)
        without.forces.evaluate_surely(u, np.zeros_like(u), other)
        k = np.zeros_like(u)
        k[with_it.model.springs.index] = with_it.model.springs.stiffness
        np.testing.assert_allclose(found - other, -k * u, rtol=0, atol=1e-12 * np.abs(k * u).max())
        stored = with_it.forces.stored_energy(u) - without.forces.stored_energy(u)
        assert stored == pytest.approx(0.5 * (k * u * u).sum(), rel=1e-9)


@pytest.mark.parametrize("control", ["load", "energy"])
def test_ledgers_count_the_energy_of_springs(control):
    """A strip pulled through springs: books close, and without the springs' energy they would be far off."""
    pull = (Traction(kind="traction", face="x+", total=(1.0, 0.0, 0.0)),)
    scene = strip(loads=pull, supports=(), stepping=Events(kind="events", control=control, end_reaction=0.6))
    springs = (Spring(name="base", face="x-", stiffness=(2e3, 10.0, 10.0)),)
    run = failing(Scene.model_validate({**dict(scene), "springs": springs}))
    rows = list(run.follow(6))
    assert rows[-1].broken > 0
    assert max(abs(row.ledger_error) for row in rows) <= CLOSED
    of_springs = run.body.model.springs.energy(run.body.model.comm, run.body.state.u)
    assert of_springs > 0.05 * rows[-1].stored
    (base,) = rows[0].of_springs
    assert base[0] == pytest.approx(-rows[0].load_factor / run.body.model.units.force, rel=SOLVED)


@pytest.mark.parametrize(
    ("spring", "says"),
    [
        ({"face": "x-", "stiffness": (0.0, 0.0, 0.0)}, r"\[0.0, 0.0, 0.0\] holds nothing"),
        ({"face": "x-", "stiffness": (1.0, -2.0, 0.0)}, r"would push a body away from its place"),
        ({"stiffness": (1.0, 0.0, 0.0)}, r"must say where by exactly one of point, line, face, set or lower/upper"),
        ({"face": "x-", "point": (0.0, 0.0, 0.0), "stiffness": (1.0, 0.0, 0.0)}, "and has point and face"),
    ],
)
def test_springs_that_cannot_be_are_refused_by_their_deck(spring, says):
    with pytest.raises(ValueError, match=says):
        Spring(**spring)


@pytest.mark.parametrize(
    ("place", "says"),
    [
        ({"point": (0.5, 0.0, 0.0)}, r"springs\.0\.point has no node of the mesh on it; the nearest is 0\.5 away"),
        ({"lower": (9.0, 0.0, 0.0)}, r"springs\.0 selects no face of the boundary"),
    ],
)
def test_springs_at_nothing_are_named(place, says):
    spring = Spring(stiffness=(1.0, 0.0, 0.0), **place)
    with pytest.raises(SceneError, match=says):
        build(Scene.model_validate({**dict(make_scene(CELLS, 4)), "springs": (spring,)}))
