"""Conjugate gradients: the same equilibrium as relaxation, true residuals, breakdowns told by name."""

import numpy as np
import pytest

from pdfem_mpi.deck.displacements import Rotation
from pdfem_mpi.deck.loads import BodyForce, Support
from pdfem_mpi.deck.peridynamics import Crack
from pdfem_mpi.model.forces import Forces
from pdfem_mpi.peridynamics.clusters import point_rows
from pdfem_mpi.solvers import cg
from pdfem_mpi.solvers.convergence import Breakdown, NotConverged
from pdfem_mpi.solvers.preconditioner.preconditioner import make_preconditioner
from pdfem_mpi.stepping import make_solver
from support.bodies import build, make_scene

TOLERANCE = 1e-9
AGREEMENT = 1e-6  # of the largest displacement: the softest mode is some 1e3 softer than the stiffest


def solved(scene, solver, notes=None, factor=1.0):
    """Body and convergence after one load step."""
    body = build(scene)
    body.state.u[body.case.fixed] = factor * body.case.prescribed[body.case.fixed]
    solve = make_solver(scene, body.share, body.forces, body.case, (notes or []).append)
    return body, solve(body.state, factor * body.case.external, lambda progress: None)


HELD = {
    "loads": (BodyForce(kind="body_force", face="x+", total=(0.3, 0.1, 0.2)),),
    "supports": (Support(face="x-", x=0.0, y=0.0, z=0.0),),
}
PULLED = {"loads": (), "supports": (Support(face="x-", x=0.0, y=0.0, z=0.0), Support(face="x+", x=0.01))}


@pytest.mark.parametrize("kinematics", ["linear", "finite"])
@pytest.mark.parametrize("options", [HELD, PULLED], ids=["loads", "displacements"])
@pytest.mark.parametrize("n_elements", [0, 4, 8])
def test_same_equilibrium_as_relaxation(n_elements, options, kinematics):
    """Both solvers find the displacements of the same equilibrium."""
    found = [
        solved(
            make_scene((8, 3, 2), n_elements, kinematics=kinematics, solver=kind, tolerance=TOLERANCE, **options), kind
        )[0].state.u
        for kind in ("adr", "cg")
    ]
    assert np.abs(found[0] - found[1]).max() <= AGREEMENT * np.abs(found[0]).max()


def test_reported_residual_is_the_true_one():
    """The residual of the convergence is that of one more evaluation at the displacements."""
    body, convergence = solved(make_scene((8, 3, 2), 4, solver="cg"), "cg")
    force = np.empty_like(body.state.u)
    body.forces.evaluate_surely(body.state.u, body.case.external, force)
    assert convergence.residual == pytest.approx(np.linalg.norm(force) / np.linalg.norm(body.case.external), rel=1e-6)
    assert convergence.residual <= 1e-6


def test_warm_start_at_the_solution_costs_one_evaluation():
    """From an equilibrium nothing is left to do but to look at it."""
    body, _ = solved(make_scene((8, 3, 2), 4, solver="cg", tolerance=1e-8), "cg")
    preconditioner = make_preconditioner(body.share, body.model, body.case)
    again = cg.solve(body.forces, body.state, body.case.external, body.case.fixed, 1e-7, 100, preconditioner)
    assert again.evaluations == 1


SHEARED = HELD | {"loads": (BodyForce(kind="body_force", face="x+", total=(0.0, 0.0, 1e-3)),)}


@pytest.mark.parametrize(
    "scene",
    [((8, 3, 2), 0, {}), ((8, 3, 2), 4, {}), ((8, 3, 2), 8, {}), ((16, 4, 4), 0, SHEARED), ((16, 4, 4), 8, SHEARED)],
    ids=["peridynamics", "coupled", "elements", "sheared", "coupled, sheared"],
)
def test_no_sweep_is_wasted(scene):
    """From rest: one evaluation an iteration and one for the true residual, which then has the digits to pass."""
    cells, n_elements, options = scene
    body = build(make_scene(cells, n_elements, solver="cg", tolerance=1e-9, **options))
    seen = []
    solve = make_solver(body.scene, body.share, body.forces, body.case, pytest.fail)
    convergence = solve(body.state, body.case.external, seen.append)
    assert convergence.evaluations == seen[-1].iteration + 1


@pytest.mark.parametrize("n_elements", [0, 8], ids=["peridynamics", "coupled"])
def test_newton_steps_cost_little(n_elements):
    """Finite kinematics, ends pulled apart by a third of a per cent: hardly more evaluations than linear kinematics."""
    pulled = {"loads": (), "supports": (PULLED["supports"][0], Support(face="x+", x=0.05))}

    def evaluations(kinematics):
        scene = make_scene((16, 4, 4), n_elements, kinematics=kinematics, solver="cg", **pulled)
        return solved(scene, "cg")[1].evaluations

    assert evaluations("finite") <= evaluations("linear") + 6  # 8 and 9 when the first step goes to 1e-3


def test_a_part_that_is_only_carried_along_comes_to_rest():
    """Cut off and moved by its support: no force is left that the residual could be relative to."""
    crack = Crack(polygon=((4.0, -1.0, -1.0), (4.0, 9.0, -1.0), (4.0, 9.0, 9.0), (4.0, -1.0, 9.0)))
    scene = make_scene((8, 2, 2), solver="cg", cracks=(crack,), **PULLED)
    body, _ = solved(scene, "cg")
    far = point_rows(body.model.points.x)[:, 0] > 0.0
    u = point_rows(body.state.u)[:, 0]
    np.testing.assert_allclose(u[far], 0.01, rtol=1e-5)
    np.testing.assert_allclose(u[~far], 0.0, atol=1e-7)


def test_no_load_is_an_equilibrium():
    """Zero load: no displacement, no evaluation."""
    loads = (BodyForce(kind="body_force", face="x+", total=(0.0, 0.0, 0.0)),)
    body, convergence = solved(make_scene((4, 2, 2), loads=loads, solver="cg"), "cg")
    assert convergence.evaluations == 0
    assert (body.state.u == 0.0).all()


def test_tolerance_below_round_off_is_named():
    """Nothing can reach 1e-16: the stagnation is told, with the residual that was reached, below 1e-10."""
    with pytest.raises(NotConverged, match=r"stagnate at a relative residual of [0-9.]+e-1[1-9]"):
        solved(make_scene((12, 2, 2), 6, solver="cg", tolerance=1e-16), "cg")


@pytest.mark.parametrize("axis", [(0.0, 0.0, 1.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (1.0, 1.0, 1.0)])
@pytest.mark.parametrize("poissons_ratio", [0.25, 0.3])
def test_a_body_turned_at_both_ends_comes_to_rest_without_force(axis, poissons_ratio):
    """Its residual is compared with the rounding of its elements' forces, at bounds as low as they can be."""
    turn = Rotation(axis=axis, point=(4.0, 1.5, 0.0), angle=0.01)
    scene = make_scene(
        (8, 3, 3), 4, correction="virial", loads=(), poissons_ratio=poissons_ratio, solver="cg",
        supports=tuple(Support(face=face, rotation=turn) for face in ("x-", "x+")),
    )  # fmt: skip
    body, convergence = solved(scene, "cg")
    assert convergence.residual <= 1e-6
    internal = np.empty_like(body.state.u)
    body.forces.evaluate_surely(body.state.u, np.zeros_like(internal), internal)
    assert np.abs(internal).max() <= 1e-14  # model units; the largest displacement is 0.04


def test_too_few_evaluations_are_named():
    """The limit holds within a solve."""
    with pytest.raises(NotConverged, match="max_evaluations"):
        solved(make_scene((8, 3, 2), solver="cg", max_evaluations=5), "cg")


@pytest.mark.parametrize("wrong", ["preconditioner", "stiffness"])
def test_indefinite_operators_are_named(wrong, monkeypatch):
    """A negative preconditioner is a breakdown; a negative stiffness, which relaxation cannot mend, the end."""
    body = build(make_scene((6, 2, 2), solver="cg"))
    preconditioner = make_preconditioner(body.share, body.model, body.case)
    if wrong == "preconditioner":
        apply = preconditioner.apply

        def negative(r, size, z):
            apply(r, size, z)
            z *= -1.0

        monkeypatch.setattr(preconditioner, "apply", negative)
    else:
        for rows in body.model.bonds.rows:
            rows.data[:] *= -1.0
    error = Breakdown if wrong == "preconditioner" else NotConverged
    with pytest.raises(error, match=f"the {wrong} is not positive definite"):
        cg.solve(body.forces, body.state, body.case.external, body.case.fixed, 1e-6, 100, preconditioner)


def test_relaxation_goes_on_after_a_breakdown():
    """A strut compressed by a tenth buckles for Newton's method; relaxation finds an equilibrium, with a note."""
    loads = (BodyForce(kind="body_force", face="x+", total=(-800.0, 0.0, 0.0)),)
    scene = make_scene(
        (16, 2, 2), kinematics="finite", loads=loads, supports=HELD["supports"], solver="cg", tolerance=1e-4
    )
    notes = []
    body = build(scene)
    solve = make_solver(scene, body.share, body.forces, body.case, notes.append)
    convergence = solve(body.state, body.case.external, lambda progress: None)
    assert convergence.residual <= 1e-4
    assert "conjugate gradients broke down" in notes[0]


def test_steps_are_counted_whatever_sums_do_not_fit(monkeypatch):
    """Last digits decide whether an evaluation fits its bounds and counts; how far a state is relaxed does not."""
    body = build(make_scene((6, 3, 2), 2, solver="cg", **HELD))
    solve = make_solver(body.scene, body.share, body.forces, body.case, lambda text: None)

    def improved():
        residual, step = body.case.external.copy(), np.zeros_like(body.state.u)
        before = body.forces.evaluations
        cg.improve(body.forces, residual, body.case.fixed, 0.0, 5, solve.preconditioner, step)
        return step, body.forces.evaluations - before

    generous, sweeps = improved()
    guess = Forces.guess_bounds

    def tight(forces, u):
        guess(forces, 1e-3 * u)

    monkeypatch.setattr(Forces, "guess_bounds", tight)
    repeated, more = improved()
    assert more > sweeps == 5
    assert np.abs(repeated - generous).max() <= 1e-9 * np.abs(generous).max()
