"""Adaptive dynamic relaxation: its damping, how it ends, and what it tells."""

import dataclasses
import math

import numpy as np
import pytest

from pdfem_mpi.deck.loads import BodyForce, Support
from pdfem_mpi.model.not_finite import NotFinite
from pdfem_mpi.solvers import adr
from pdfem_mpi.solvers.adr import LARGEST_DAMPING, damping_coefficient
from pdfem_mpi.solvers.convergence import NotConverged
from support.bodies import build, make_scene

ROUND_OFF = 1e-12  # relative

BODIES = {"peridynamics": ((6, 2, 2), 0), "coupled": ((8, 2, 2), 4), "elements": ((6, 2, 2), 6)}


def body_of(name, **options):
    cells, n_elements = BODIES[name]
    return build(make_scene(cells, n_elements, **options))


def relax(body, tolerance=1e-6, max_evaluations=5000, watch=lambda progress: None):
    case = body.case
    return adr.solve(body.forces, body.state, case.external, case.fixed, tolerance, max_evaluations, watch)


@pytest.mark.parametrize(
    ("work", "square", "damping"),
    [
        (1.0, 4.0, 1.0),
        (0.9, 1.0, 2 * math.sqrt(0.9)),
        (1.0, 1.0, LARGEST_DAMPING),  # 2 or more would reverse velocities
        (5.0, 1.0, LARGEST_DAMPING),
        (-1.0, 1.0, 0.0),
        (0.0, 1.0, 0.0),
        (1.0, 0.0, 0.0),
        (0.0, 0.0, 0.0),
        (math.inf, 1.0, LARGEST_DAMPING),
    ],
)
def test_damping_coefficient(work, square, damping):
    """Eq. 31 with its guards: c = 2 sqrt(work / square); 0 where that is undefined; below 2."""
    assert damping_coefficient(work, square) == pytest.approx(damping, rel=ROUND_OFF)


def test_one_iteration_by_hand():
    """Eqs 35, 34, 32, 31, 33: two steps of central differences from rest."""
    body = body_of("peridynamics")
    case, mass = body.case, body.model.mass
    seen = []

    def stop_after_two(progress):
        seen.append(progress)
        if progress.iteration == 2:
            raise StopIteration

    with pytest.raises(StopIteration):
        relax(body, watch=stop_after_two)
    force0 = case.external
    v = 0.5 * force0 / mass
    u = v.copy()
    force1 = case.external + body.internal(u)
    with np.errstate(invalid="ignore", divide="ignore"):
        stiffness = -(force1 - force0) / mass / v
    stiffness[~np.isfinite(stiffness)] = 0.0
    damping = 2 * math.sqrt((u * stiffness * u).sum() / (u * u).sum())
    v = ((2 - damping) * v + 2 * force1 / mass) / (2 + damping)
    assert seen[0].damping == 0.0
    assert seen[1].damping == pytest.approx(damping, rel=ROUND_OFF)
    np.testing.assert_allclose(body.state.fields["v"], v, rtol=0, atol=ROUND_OFF * np.abs(v).max())
    np.testing.assert_allclose(body.state.u, u + v, rtol=0, atol=ROUND_OFF * np.abs(u).max())


@pytest.mark.parametrize("name", BODIES)
def test_relaxation_ends_in_equilibrium(name):
    """Internal forces balance the loads to the tolerance; every iteration was told of, the last one ends it."""
    body = body_of(name)
    seen = []
    found = relax(body, 1e-8, watch=seen.append)
    residual = body.case.external + body.internal(body.state.u)
    relative = np.linalg.norm(residual) / np.linalg.norm(body.case.external)
    assert found.residual <= 1e-8
    assert relative == pytest.approx(found.residual, rel=1e-3)  # the forces have another quantum now
    assert [progress.iteration for progress in seen] == list(range(len(seen)))
    assert seen[-1].residual == found.residual
    assert len(seen) <= found.evaluations  # some are repeated when a bound is met


def test_relaxation_under_prescribed_displacements_is_relative_to_the_reactions():
    supports = Support(face="x-", x=0.0, y=0.0, z=0.0), Support(face="x+", x=0.006)
    body = body_of("elements", loads=(), supports=supports)
    case, state = body.case, body.state
    state.u[case.fixed] = case.prescribed[case.fixed]
    found = relax(body)
    force = body.internal(state.u)
    free, held = np.linalg.norm(force[~case.fixed]), np.linalg.norm(force[case.fixed])
    assert found.residual == pytest.approx(free / held, rel=1e-3)
    np.testing.assert_array_equal(state.u[case.fixed], case.prescribed[case.fixed])


def test_nothing_to_do_is_done_at_once():
    """No loads and no displacements: equilibrium, at a residual of 0."""
    body = body_of("coupled", loads=())
    found = relax(body)
    assert found.residual == 0.0
    assert not body.state.u.any()


def test_too_few_evaluations_are_told_with_the_residual_and_the_keys():
    body = body_of("coupled")
    with pytest.raises(NotConverged, match=r"solver\.max_evaluations = 7 were used up at a relative residual of") as e:
        relax(body, max_evaluations=7)
    assert "solver.tolerance = 1e-06" in str(e.value)
    assert body.forces.evaluations == 7


@pytest.mark.parametrize("value", [math.nan, math.inf, 1e300], ids=str)
@pytest.mark.parametrize("kinematics", ["linear", "finite"])
def test_point_that_is_not_finite_is_named_with_its_place(kinematics, value):
    """The first of the bad points in the order of the rank, by its id and its position in the deck's units."""
    body = body_of("peridynamics", kinematics=kinematics)
    body.state.u[12 * 1 + 4 * 2 + 3] = value  # cluster 1, z, lane 3: point 7 of the first cell
    with pytest.raises(NotFinite, match=r"point 7 at \(0\.788675, 0\.788675, 0\.788675\)"):
        relax(body, max_evaluations=20)


@pytest.mark.parametrize("value", [math.nan, math.inf, 1e300], ids=str)
def test_node_that_is_not_finite_is_named_with_its_place(value):
    body = body_of("elements")
    body.state.u[3 * 9 + 1] = value  # node 9 of rows of seven
    with pytest.raises(NotFinite, match=r"node 9 at \(2, 1, 0\)"):
        relax(body, max_evaluations=20)


def test_node_of_the_overlap_that_is_not_finite_is_named():
    """The node is named, not the points that follow it."""
    body = body_of("coupled")
    body.state.u[3 * body.model.unknowns.n_points + 3 * 4] = math.nan
    with pytest.raises(NotFinite, match=r"node 4 at \(4, 0, 0\)"):
        relax(body, max_evaluations=20)


def test_diverging_relaxation_is_ended_early():
    """Masses below the limit of stability: the end comes at a residual of 1e8, not after all evaluations."""
    body = body_of("peridynamics")
    lighter = dataclasses.replace(body.model, mass=0.5 * body.model.mass)
    body.forces.model = lighter
    with pytest.raises(NotConverged, match="diverged"):
        relax(body)
    assert body.forces.evaluations < 500


@pytest.mark.parametrize("prescribed", [False, True], ids=["loads", "displacements"])
@pytest.mark.parametrize("kinematics", ["linear", "finite"])
def test_diverging_relaxation_is_told_with_a_remedy(kinematics, prescribed):
    """Reactions grow as fast as residuals do, and with prescribed displacements there is no load to compare with."""
    held = Support(face="x-", x=0.0, y=0.0, z=0.0)
    supports = (held, Support(face="x+", x=1e-3)) if prescribed else (held,)
    load = BodyForce(kind="body_force", face="x+", total=(0.1, 0.01, 0.0))
    body = body_of("peridynamics", kinematics=kinematics, supports=supports, loads=() if prescribed else (load,))
    body.state.u[body.case.fixed] = body.case.prescribed[body.case.fixed]
    body.forces.model = dataclasses.replace(body.model, mass=0.2 * body.model.mass)
    with pytest.raises(NotConverged, match="relaxation diverged: after") as found:
        relax(body)
    assert 'or use solver.kind = "cg"' in str(found.value) or 'or solver.kind = "cg"' in str(found.value)


def test_fixed_unknowns_keep_their_displacements_bit_for_bit():
    body = body_of(
        "coupled",
        loads=(BodyForce(kind="body_force", face="y+", density=(0.0, 0.5, 0.0)),),
        supports=(Support(face="x-", x=0.01, y=-0.02, z=0.03), Support(face="x+", layers=2, z=0.04)),
    )
    case, state = body.case, body.state
    state.u[case.fixed] = case.prescribed[case.fixed]
    relax(body, 1e-4)
    np.testing.assert_array_equal(state.u[case.fixed], case.prescribed[case.fixed])
