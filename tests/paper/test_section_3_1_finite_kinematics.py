"""Sec. 3.1 with sec. 2: elements beside bonds in finite kinematics turn and strain as the bonds do.

Printed elements are linear (eq. 15); bonds beside them are not (eqs 2, 3), and a coupled body whose elements turned had
moments that did not balance.
"""

import json
from unittest.mock import patch

import numpy as np
import pytest
from unit.kernels.bodies_of_elements import turn

from pdfem_mpi.deck.loads import BodyForce, Support, Traction
from pdfem_mpi.deck.outputs import Output
from pdfem_mpi.deck.programs import Steps
from pdfem_mpi.deck.toml import parse_deck
from pdfem_mpi.measure.strains import WARNING_STRAIN, measure_elements
from pdfem_mpi.parallel.comm import mpi
from pdfem_mpi.runs.run import run
from pdfem_mpi.stepping import follow_load_program, make_solver
from pdfem_mpi.stepping.report import balance
from pdfem_mpi.system.exit_codes import EXIT_NOT_CONVERGED
from support import total_lagrangian
from support.bodies import Silence, build, make_scene

#: Moments over the sums of their magnitudes: promised; some 1e-14 are found.
BALANCED = 1e-10
#: Forces of a rotation over those of a strain of 1e-2: round-off of positions over the strain.
NO_FORCE = 1e-12
#: Displacements over the largest, against an independent program; both are solved to 1e-11 of the load.
SAME = 1e-6
#: Of a difference of energies over steps of 1e-5 of random displacements.
ENERGY = 1e-7

COUPLINGS = {
    "reading B": {},
    "reading A, overlap 2": {"coupling": "paper_a", "overlap": 2},
    "exact": {"coupling": "exact", "correction": "fitted"},
    "virial": {"correction": "virial"},
}
CLAMPED = (Support(face="x-", x=0.0, y=0.0, z=0.0),)

#: A random deck in which elements turn by more than 30 degrees.
TURNED = """
[mesh]
kind = "box"
lower = [0.0, 0.0, 100.0]
upper = [5.0, 1.0, 101.0]
spacing = 1.0
[material]
youngs_modulus = 10000.0
[peridynamics]
kinematics = "finite"
surface_correction = "none"
[coupling]
kind = "paper_a"
[solver]
kind = "cg"
tolerance = 1e-09
[[regions]]
name = "f1"
model = "finite_elements"
lower = [2.0, 0.0, 100.0]
upper = [5.0, 1.0, 101.0]
[[regions]]
name = "p1"
model = "peridynamics"
lower = [0.0, 0.0, 100.0]
upper = [2.0, 1.0, 101.0]
[[cracks]]
polygon = [[2.1, -1.0, 99.0], [2.1, 0.6, 99.0], [2.1, 0.6, 102.0], [2.1, -1.0, 102.0]]
[[loads]]
kind = "body_force"
face = "x+"
total = [1.69669, 24.1921, -35.5748]
[[loads]]
kind = "body_force"
region = "p1"
density = [-0.198705, 2.23913, 5.11863]
[[loads]]
kind = "traction"
face = "x+"
total = [5.90952, -59.6205, 59.6476]
nodal = "equal"
[[supports]]
face = "x-"
x = 0.0
y = 0.0
z = 0.0
"""


def coupled(name):
    return build(make_scene((6, 2, 2), 3, kinematics="finite", **COUPLINGS[name]))


def rows_of(scene):
    body = build(scene)
    solve = make_solver(scene, body.share, body.forces, body.case, print)
    return body, list(follow_load_program(scene, solve, None, body.state, body.case))


def random(body, size, seed=0):
    """Displacements of points and nodes, drawn evenly."""
    return size * np.random.default_rng(seed).uniform(-1.0, 1.0, body.model.n_unknowns)


def turned(body, degrees):
    return body.of_positions(lambda x: x @ turn(degrees).T - x)


def cantilever(tip, **options):
    """Elements alone, clamped at one end and pulled sideways at the other."""
    loads = (Traction(kind="traction", face="x+", total=(0.0, 0.0, tip)),)
    return make_scene((10, 1, 1), 10, kinematics="finite", loads=loads, supports=CLAMPED, solver="cg", **options)


def test_moments_balance_where_elements_turn():
    """Elements that stayed linear left 0.38 of the sums of the magnitudes of all moments in this deck."""
    _, (row,) = rows_of(parse_deck(TURNED, "turned.toml", ()))
    assert row.force_balance == 0.0
    assert row.moment_balance <= BALANCED


@pytest.mark.parametrize("name", COUPLINGS)
def test_moments_balance_at_any_displacements(name):
    """Turned by half a right angle, and every point and node moved at random by up to a tenth of a cell."""
    body = coupled(name)
    body.state.u[:] = turned(body, 45.0) + random(body, 0.1)
    _, force, moment = balance(body.forces, body.state, body.case, body.internal(body.state.u))
    assert force == 0.0
    assert moment <= BALANCED


@pytest.mark.parametrize("name", COUPLINGS)
@pytest.mark.parametrize("degrees", [10.0, 90.0])
def test_rotations_of_a_coupled_body_give_no_force(name, degrees):
    body = coupled(name)
    strained = np.abs(body.internal(body.of_positions(lambda x: 0.01 * x * (1.0, 0.0, 0.0)))).max()
    assert np.abs(body.internal(turned(body, degrees))).max() <= NO_FORCE * strained
    assert body.forces.stored_energy(turned(body, degrees)) <= NO_FORCE * strained


@pytest.mark.parametrize("name", COUPLINGS)
def test_turned_bodies_answer_as_before_they_turned(name):
    """Forces turn with the body: those of a strained body, turned by 90 degrees, are the turned forces."""
    body = coupled(name)
    strain = np.array([[0.02, 0.01, 0.0], [0.0, -0.01, 0.004], [0.0, 0.0, 0.01]])
    about = turn(90.0)
    before = body.internal(body.of_positions(lambda x: x @ strain))
    after = body.internal(body.of_positions(lambda x: (x + x @ strain) @ about.T - x))
    n = 3 * body.model.unknowns.n_points
    turned_back = after[n:].reshape(-1, 3) @ about
    assert np.abs(turned_back - before[n:].reshape(-1, 3)).max() <= 1e-10 * np.abs(before).max()
    assert np.linalg.norm(after[:n]) == pytest.approx(np.linalg.norm(before[:n]), rel=1e-10)


@pytest.mark.parametrize("name", COUPLINGS)
def test_energy_is_what_the_forces_work(name):
    body = coupled(name)
    u, v, h = turned(body, 30.0) + random(body, 0.02), random(body, 1.0, 1), 1e-5
    work = -float(body.internal(u) @ v)
    energies = []
    for sign in (1.0, -1.0):
        body.internal(u + sign * h * v)
        energies.append(body.forces.stored_energy(u + sign * h * v))
    size = float(np.abs(body.internal(u)) @ np.abs(v))
    assert (energies[0] - energies[1]) / (2.0 * h) == pytest.approx(work, abs=ENERGY * size)


@pytest.mark.parametrize("steps", [1, 3])
def test_a_bent_cantilever_is_that_of_an_independent_program(steps):
    """The tip moves by 0.44 of the length, in one step or three: dense Newton's method on elements written anew."""
    factors = tuple((k + 1) / steps for k in range(steps))
    body, rows = rows_of(cantilever(2.0, tolerance=1e-11, stepping=Steps(load_factors=factors)))
    x, cells = body.share.nodes, body.share.mesh.cells
    external = body.case.external.reshape(-1, 3)
    expected = total_lagrangian.solve(x, cells, 0.4, 0.4, external, x[:, 0] == x[:, 0].min(), 4, 1e-11)
    assert np.abs(expected).max() > 4.0
    np.testing.assert_allclose(body.state.u.reshape(-1, 3), expected, rtol=0, atol=SAME * np.abs(expected).max())
    assert rows[-1].moment_balance <= BALANCED
    assert rows[-1].elements.strain < WARNING_STRAIN


def test_small_displacements_are_those_of_linear_elements():
    """Elements alone: the tip of a cantilever under a ten-thousandth of the load, to the square of its rotation."""
    scene = cantilever(2e-4, tolerance=1e-10)
    u, _ = rows_of(scene)[0].state.u, None
    linear = scene.peridynamics.model_copy(update={"kinematics": "linear"})
    expected = rows_of(scene.model_copy(update={"peridynamics": linear}))[0].state.u
    assert np.abs(u - expected).max() <= 1e-4 * np.abs(expected).max()


def test_elements_alone_are_linear_unless_the_deck_says_so():
    """Beside bonds they are what the bonds are; `peridynamics.kinematics` asks for either."""
    models = {}
    for n_elements in (0, 2, 4):
        for kinematics in (None, "linear", "finite"):
            models[n_elements, kinematics] = build(make_scene((4, 1, 1), n_elements, kinematics=kinematics)).model
    assert {key for key, model in models.items() if model.finite} == {
        (0, None), (2, None), (0, "finite"), (2, "finite"), (4, "finite"),
    }  # fmt: skip
    for (n_elements, _), model in models.items():
        if n_elements:
            assert model.elements.finite == model.finite


class Heard(Silence):
    """A reporter that keeps its lines."""

    def __init__(self):
        self.lines = []

    def line(self, text):
        self.lines.append(text)


def outcome(scene, folder):
    """Exit code, reason and lines of a run without any output."""
    heard = Heard()
    scene = scene.model_copy(update={"output": Output(fields=False, figures=False)})
    with patch("pdfem_mpi.runs.prepare.warm_up"):  # it closes the kernels to what other tests compile
        code = run(scene, mpi().COMM_SELF, folder, "", True, heard)
    return code, json.loads((folder / "summary.json").read_text())["reason"], heard.lines


def pressed(total, solver="adr"):
    """A block of elements that a body force presses into itself along x."""
    loads = (BodyForce(kind="body_force", face="x+", total=(-total, 0.0, 0.0)),)
    return make_scene(
        (3, 1, 1), 3, kinematics="finite", loads=loads, supports=CLAMPED, solver=solver, max_evaluations=5000
    )


@pytest.mark.parametrize("total", [220.0, 1000.0], ids=["found in equilibrium", "diverged"])
def test_elements_turned_inside_out_end_the_run_with_their_place(tmp_path, total):
    code, reason, _ = outcome(pressed(total), tmp_path)
    assert code == EXIT_NOT_CONVERGED
    assert "the finite element about (" in reason
    assert "is turned inside out" in reason


def test_strains_beyond_the_law_are_told_once(tmp_path):
    """Pulled by a fifth; turned alone they are not told, however far."""
    scene = pressed(-300.0, "cg").model_copy(update={"stepping": Steps(load_factors=(0.1, 0.9, 1.0))})
    code, _, lines = outcome(scene, tmp_path)
    told = [line for line in lines if line.startswith("warning: finite elements are strained by up to ")]
    assert code == 0
    assert len(told) == 1
    body = coupled("reading B")
    assert not measure_elements(body.model, turned(body, 90.0)).warning
