"""Opening control: the load follows the opening of a crack, which never shrinks; a notched strip that snaps back."""

import numpy as np
import pytest

from pdfem_mpi.deck.outputs import OpeningProbe, Output
from pdfem_mpi.deck.programs import Events
from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.deck.table import SceneError
from pdfem_mpi.model.gauges import gauge_of
from pdfem_mpi.solvers.convergence import NotConverged
from support.bodies import build
from support.failing import GRIPS, WEIGHT, failing, opened, strip
from support.held import beam
from support.restarts import StopAt, alone, differing, outcome

CLOSED = 1e-10  # of the work; 1e-14 is found
#: Load factors of one state that two programs come to by different ways: each reads it once a tenfold smaller residual
#: moves it by at most 5e-4 (`arrest.MOST_DRIFT`); 1e-5 is found.
SAME_STATE = 1e-4
CELLS = (10, 3, 1)
STOPPED = 75  # exit code
MOUTH = {"one": (4.5, 0.0, 0.5), "two": (5.5, 0.0, 0.5)}


def notched(control="opening", probe=None, **options):
    """A strip of ten cells by three with a crack from its lower edge, pulled at its ends."""
    tables = {name: options.pop(name) for name in ("kinematics", "supports", "elements") if name in options}
    scene = strip(crack=(-1.0, 1.1), cells=CELLS, **tables)
    probe = probe or OpeningProbe(kind="opening", name="cmod", **MOUTH)
    given = {"report_every": 1, "end_reaction": 0.02, "opening": "cmod" if control == "opening" else None} | options
    events = Events(kind="events", control=control, **given)
    return Scene.model_validate({**dict(scene), "stepping": events, "probes": (probe,)})


def follow(scene, rows=None):
    """The rows, and the opening at each."""
    run = failing(scene)
    gauge = gauge_of(run.body.share, run.body.model, run.body.share.probes["cmod.opening"])
    openings = [gauge.read(run.body.model.comm, run.body.state.u) for _ in run.follow(rows)]
    return run, np.array(openings)


@pytest.fixture(scope="module")
def both():
    return {control: follow(notched(control)) for control in ("load", "opening")}


def test_the_opening_never_shrinks(both):
    """And some loads do: the strip snaps back. The books close."""
    run, openings = both["opening"]
    assert (np.diff(openings) >= -1e-9 * openings[:-1]).all()
    loads = np.array([row.load_factor for row in run.rows])
    assert (np.diff(loads) < 0.0).sum() > 5 and loads.min() < 0.95 * loads[0]
    assert max(abs(row.ledger_error) for row in run.rows) <= CLOSED
    assert run.rows[-1].event == "end" and run.rows[-1].broken == both["load"][0].rows[-1].broken


def test_stable_states_are_those_of_load_control(both):
    """Wherever as many bonds are broken at a critical state of both programs, it is the same state."""
    found = {name: {r.broken: r for r in run.rows if r.event == "critical"} for name, (run, _) in both.items()}
    common = sorted(set(found["load"]) & set(found["opening"]))
    assert len(common) >= 5 and common[0] == 0
    for broken in common:
        one, other = found["load"][broken], found["opening"][broken]
        assert other.load_factor == pytest.approx(one.load_factor, rel=SAME_STATE)
        assert other.reaction == pytest.approx(one.reaction, rel=SAME_STATE)
        assert other.stored == pytest.approx(one.stored, rel=4 * SAME_STATE)


def test_it_follows_what_load_control_jumps_over(both):
    """Between the first break and the arrest of the avalanche that follows it at a held load."""
    run, openings = both["load"]
    arrest = next(k for k, row in enumerate(run.rows) if row.event == "arrest")
    first, last = openings[0], openings[arrest]
    rows, at = both["opening"][0].rows, both["opening"][1]
    between = [row for row, x in zip(rows, at, strict=True) if first < x < last and row.event == "critical"]
    assert len(between) > 5
    assert all(0 < row.broken < run.rows[arrest].broken for row in between)
    assert max(row.load_factor for row in between) < run.rows[arrest].load_factor


@pytest.mark.parametrize(
    "options", [{}, {"kinematics": "finite"}, {"elements": 2}], ids=["linear", "finite", "elements"]
)
def test_critical_states_are_stable(options):
    """At each of them the most stretched bond is at its limit and no bond beyond it."""
    run = failing(notched(**options))
    ratios = [run.ratio() for row in run.follow(8) if row.event == "critical"]
    assert len(ratios) >= 3
    assert ratios == pytest.approx([1.0] * len(ratios), abs=2e-6)


def test_a_run_ends_at_an_opening():
    """Linear kinematics: the last state has it to round-off."""
    run, openings = follow(notched(end_opening=7.3e-3))
    assert run.rows[-1].event == "end"
    assert openings[-1] * run.body.share.units.length == pytest.approx(7.3e-3, rel=1e-6)


def test_a_load_that_closes_the_opening_is_named():
    probe = OpeningProbe(kind="opening", name="cmod", direction=(-1.0, 0.0, 0.0), **MOUTH)
    with pytest.raises(NotConverged, match=r'"cmod" is -.* at load factor .*: the load closes it. Reverse'):
        follow(notched(probe=probe))


def test_an_opening_is_that_of_its_points():
    """A linear field on bonds, elements and across both: the difference of the places' displacements."""
    gradient = np.array([[1.0, 0.5, -0.25], [0.125, -0.5, 2.0], [-1.0, 0.75, 0.25]])
    for elements in (0, 3):
        for one, two in (((4.5, 0.0, 0.5), (5.5, 0.3, 0.5)), ((0.0, 1.0, 0.0), (10.0, 3.0, 1.0))):
            probe = OpeningProbe(kind="opening", name="cmod", one=one, two=two, direction=(0.0, 3.0, 4.0))
            body = build(notched(probe=probe, elements=elements))
            gauge = gauge_of(body.share, body.model, body.share.probes["cmod.opening"])
            u = body.of_positions(lambda x: x @ gradient.T)
            expected = (gradient @ (np.array(two) - np.array(one))) @ (0.0, 0.6, 0.8)
            assert gauge.read(body.model.comm, u) * body.model.units.length == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize(
    ("places", "says"),
    [
        ({"one": (4.5, -2.0, 0.5), "two": (5.5, 0.0, 0.5)}, r"probes\.0\.one = .* lies outside of the body, 2 away"),
        ({"one": (4.2, 0.5, 0.5), "two": (4.8, 0.5, 0.5)}, r"probes\.0 measures an opening across nothing"),
    ],
)
def test_an_opening_of_nothing_is_named(places, says):
    with pytest.raises(SceneError, match=says):
        build(notched(probe=OpeningProbe(kind="opening", name="cmod", **places)))


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"opening": None}, 'control = "opening" needs to know which'),
        ({"opening": "cmd"}, '= "cmd" is not the name of a probe of kind "opening". Did you mean cmod'),
        ({"control": "load", "opening": "cmod"}, 'opening = "cmod" goes with control = "opening"'),
        ({"control": "energy", "end_opening": 1.0}, 'end_opening = 1.0 goes with control = "opening"'),
    ],
)
def test_a_deck_that_does_not_say_which_opening_is_refused(options, says):
    with pytest.raises(ValueError, match=says):
        notched(**options)


def test_two_points_at_one_place_are_refused():
    with pytest.raises(ValueError, match="an opening across nothing"):
        OpeningProbe(kind="opening", name="cmod", one=(1.0, 2.0, 3.0), two=(1.0, 2.0, 3.0))


def test_stops_change_nothing(tmp_path):
    """Beside a constant load: history and fields of a run in pieces are those of a straight one, in every bit."""
    scene = opened(loads=(WEIGHT,), supports=GRIPS)
    assert alone(scene, tmp_path / "straight") == 0
    stops = 0
    while (code := alone(scene, tmp_path / "pieces", requests=StopAt(9))) == STOPPED:
        stops += 1
    assert code == 0 and stops >= 2
    assert not differing(outcome(tmp_path / "pieces"), outcome(tmp_path / "straight"))


def test_stops_change_nothing_of_a_beam_that_is_held_in_every_way(tmp_path):
    """Springs, ties, rollers, constant and growing loads between mirror planes: columns, history and fields."""
    scene = beam(end_opening=4.8e-3).model_copy(update={"output": Output(figures=False)})
    assert alone(scene, tmp_path / "straight") == 0
    stops = 0
    while (code := alone(scene, tmp_path / "pieces", requests=StopAt(5))) == STOPPED:
        stops += 1
    assert code == 0 and stops >= 2
    assert not differing(outcome(tmp_path / "pieces"), outcome(tmp_path / "straight"))


def test_other_controls_keep_their_numbers():
    """No number of the new control is in the state of another."""
    run = failing(notched("load"))
    next(run.follow(1))
    assert "opening" not in run.body.state.program
    assert run.body.case.opening is None
