"""Constant loads beside those that grow: first breaks by superposition, closed books, every program and control."""

import numpy as np
import pytest

from pdfem_mpi.deck.loads import Support
from pdfem_mpi.deck.outputs import OpeningProbe
from pdfem_mpi.deck.programs import Events, Ramp, Solver, Steps
from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.deck.table import SceneError
from pdfem_mpi.solvers.convergence import NotConverged
from support.failing import CHIP, EDGE, GRIPS, WEIGHT, chipped, failing, followed, strip

CLOSED = 1e-10  # of the work
SUPERPOSED = 1e-8  # relative, of the load of the first break
PROBE = OpeningProbe(kind="opening", name="cmod", one=(3.5, 0.0, 0.5), two=(4.5, 0.0, 0.5))


def weighed(loads=(WEIGHT,), supports=GRIPS, stepping=None, **options):
    solver = Solver(kind=options.pop("solver", "cg"), tolerance=1e-10)
    scene = strip(crack=EDGE, supports=supports, loads=loads, **options)
    given = {"probes": (PROBE,), "solver": solver, "stepping": stepping or scene.stepping}
    return Scene.model_validate(dict(scene) | given)


def solution(loads, supports):
    """Displacements at load factor 1 of some loads alone."""
    run = failing(weighed(loads, supports, Steps(load_factors=(1.0,))))
    run.body.case.displace(run.body.state.u, 1.0)
    run.solve(run.body.state, run.body.case.forces(1.0))  # no bond breaks
    return run.body.state.u.copy()


def superposed():
    """The load factor of the first break, from the two solutions by themselves."""
    still = tuple(support.model_copy(update={"x": 0.0}) for support in GRIPS)
    grows, weight = solution((), GRIPS), solution((WEIGHT.model_copy(update={"constant": False}),), still)
    run = failing(weighed())

    def ratio(factor):
        run.body.internal(weight + factor * grows)
        return run.body.forces.largest_ratio(run.failure)

    low, high = 0.0, 4.0
    assert ratio(low) < 1.0 < ratio(high)
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if ratio(middle) < 1.0 else (low, middle)
    return low


def test_the_first_break_is_that_of_superposed_solutions():
    """Under load and energy control; not the load without the weight, by far."""
    expected = superposed()
    for control in ("load", "energy"):
        first = followed(weighed(control=control, report_every=1), 1).rows[0]
        assert (first.event, first.broken) == ("critical", 0)
        assert first.load_factor == pytest.approx(expected, rel=SUPERPOSED)
    without = followed(weighed(()), 1).rows[0].load_factor
    assert abs(without - expected) > 1e-3 * expected


@pytest.mark.parametrize("control", ["load", "energy", "opening"])
def test_ledger_closes_beside_constant_loads(control):
    """W counts what the constant loads do as well."""
    opening = "cmod" if control == "opening" else None
    events = Events(kind="events", control=control, report_every=1, opening=opening)
    run = followed(weighed(stepping=events), 12)
    assert max(abs(row.ledger_error) for row in run.rows) <= CLOSED
    assert run.rows[-1].broken > 0 and min(row.released for row in run.rows) >= 0.0


def test_finite_kinematics_bracket_it():
    run = followed(weighed(kinematics="finite"), 1)
    assert run.rows[0].event == "critical"
    assert run.ratio() == pytest.approx(1.0, abs=2e-6)


def test_a_ramp_begins_at_rest_under_constant_loads():
    """The first iterations find the weight's own equilibrium; the books begin with its energy."""
    ramp = Ramp(kind="ramp", increment=1e-6, report_every=10, end_load_factor=1e-5)
    still = tuple(support.model_copy(update={"x": 1e-9 if support.face == "x+" else 0.0}) for support in GRIPS)
    scene = weighed(supports=still, stepping=ramp, solver="adr")
    run = followed(scene)
    weight = solution((WEIGHT.model_copy(update={"constant": False}),), still)
    size = np.abs(weight).max()
    np.testing.assert_allclose(run.body.state.u, weight, rtol=0, atol=1e-5 * size)
    assert run.rows[0].work == pytest.approx(run.rows[0].stored, rel=1e-5)


def test_constant_loads_that_break_bonds_alone_are_named():
    heavy = WEIGHT.model_copy(update={"density": (0.0, -4.0, 0.0)})
    with pytest.raises(NotConverged, match=r"constant = true alone stretch a bond to .* times its critical stretch"):
        followed(weighed((heavy,)), 1)


def test_nothing_that_grows_is_named():
    with pytest.raises(ValueError, match="nothing loads the body"):
        weighed(supports=GRIPS[:1])


def test_constant_loads_out_of_balance_are_named():
    with pytest.raises(SceneError, match="not in balance"):
        failing(weighed(supports=(Support(face="x-", x=-0.01), Support(face="x+", x=0.01))))


@pytest.mark.parametrize("kinematics", ["linear", "finite"])
def test_a_run_ends_where_all_that_grows_is_torn_off(kinematics):
    """What stays are constant loads, which no load factor changes: the body carries nothing of what grew."""
    still = tuple(support.model_copy(update={"x": 0.0}) for support in GRIPS)
    scene = chipped(loads=(*CHIP, WEIGHT), kinematics=kinematics).model_copy(update={"supports": still})
    run = followed(scene)
    last = run.rows[-1]
    assert (last.event, last.reaction) == ("end", 0.0)
    assert last.broken > 0
    assert run.body.case.constant.any()
