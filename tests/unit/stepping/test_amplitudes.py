"""Load factors over a pseudo-time: bodies that are loaded, unloaded and loaded again."""

import numpy as np
import pytest

import pdfem_mpi as pdfem
from pdfem_mpi.deck.programs import Events, Steps
from pdfem_mpi.deck.toml import parse_deck
from support.failing import followed, strip
from support.softening import soft_strip
from support.tiny import TINY

#: Of the reaction's and the displacements' secants: equilibria to 1e-10.
SECANT = 1e-9
OVERSHOOT = 1.02


def cycle(*factors, increments=None):
    times = tuple(float(k) for k in range(1, len(factors) + 1))
    return Steps(load_factors=factors, times=times, increments=increments)


@pytest.fixture(scope="module")
def first():
    """The load of the first break."""
    return followed(strip(), 1).rows[0].load_factor


@pytest.mark.parametrize("solver", ["cg", "adr"])
def test_broken_bonds_retrace_the_secant(first, solver):
    """Down to nothing and up again: reaction over load stays what it was after the breaks, and nothing breaks anew."""
    top = OVERSHOOT * first
    program = cycle(top, 0.4 * top, 0.0, 0.7 * top, 0.999 * top)
    tolerance = 1e-10
    rows = followed(strip(solver=solver, tolerance=tolerance, stepping=program)).rows
    assert rows[0].broken > 0 and {row.broken for row in rows} == {rows[0].broken}
    assert [row.time for row in rows] == [1.0, 2.0, 3.0, 4.0, 5.0]
    assert rows[2].reaction == 0.0 and rows[2].stored == 0.0
    secants = np.array([row.reaction / row.load_factor for row in rows if row.load_factor])
    np.testing.assert_allclose(secants, secants[0], rtol=SECANT)
    energies = np.array([row.stored / row.load_factor**2 for row in rows if row.load_factor])
    np.testing.assert_allclose(energies, energies[0], rtol=SECANT)


def test_softened_bonds_retrace_the_secant():
    """What has softened keeps what is left of its stiffness on the way down and up again."""
    rows = followed(soft_strip(tolerance=1e-10, crack=(-1.0, 2.1), stepping=cycle(0.6, 0.2, 0.0, 0.59))).rows
    assert rows[0].softened > 0 and {row.softened for row in rows} == {rows[0].softened}
    secants = np.array([row.reaction / row.load_factor for row in rows if row.load_factor])
    np.testing.assert_allclose(secants, secants[0], rtol=SECANT)


def test_further_load_breaks_further_bonds(first):
    rows = followed(strip(stepping=cycle(OVERSHOOT * first, 0.0, 1.1 * OVERSHOOT * first))).rows
    assert rows[2].broken > rows[1].broken == rows[0].broken


def test_increments_lie_on_straight_lines():
    schedule = Steps(load_factors=(1.0, -1.0), times=(2.0, 3.0), increments=4).schedule
    assert [time for time, _ in schedule] == [0.5, 1.0, 1.5, 2.0, 2.25, 2.5, 2.75, 3.0]
    assert [factor for _, factor in schedule] == [0.25, 0.5, 0.75, 1.0, 0.5, 0.0, -0.5, -1.0]


def tiny(*overrides):
    return parse_deck(TINY, "tiny.toml", (*overrides, "output.figures=false"))


def test_a_cycle_goes_on_from_a_checkpoint(tmp_path):
    """Times are columns of the history and those of frames; a longer cycle continues a shorter one to the same bits."""
    short = {"stepping.times": [1.0, 2.0], "stepping.load_factors": [1.0, -0.5], "stepping.increments": 2}
    longer = short | {"stepping.times": [1.0, 2.0, 4.0], "stepping.load_factors": [1.0, -0.5, 0.25]}
    first, whole = (
        pdfem.run(tiny(*(f"{name}={value}" for name, value in keys.items())), tmp_path / name)
        for name, keys in (("part", short), ("whole", longer))
    )
    resumed = pdfem.resume(first.path, longer)
    for run in (resumed, whole):
        np.testing.assert_array_equal(run.history["time"], [0.5, 1.0, 1.5, 2.0, 3.0, 4.0])
        np.testing.assert_array_equal(run.history["load_factor"], [0.5, 1.0, 0.25, -0.5, -0.125, 0.25])
    assert resumed.summary["fields_sha256"] == whole.summary["fields_sha256"]


@pytest.mark.parametrize(
    ("overrides", "sentence"),
    [
        (("stepping.times=[1.0, 1.0]", "stepping.load_factors=[1.0, 0.5]"), "has 1.0 after 1.0, but must"),
        (("stepping.times=[-1.0]",), "has -1.0 after 0.0, but must strictly rise from 0. Use a number above 0.0."),
        (("stepping.times=[1.0, 2.0]",), "has 2 numbers, and load_factors has 1. Give a load factor at each time."),
        (("stepping.load_factors=[1.0, 0.5]",), "or give times for a load that comes and goes."),
        (("stepping.increments=3",), "stepping.increments = 3 divides the time"),
    ],
)
def test_amplitudes_out_of_order_are_told(overrides, sentence):
    with pytest.raises(pdfem.DeckError) as error:
        tiny(*overrides)
    assert sentence in str(error.value)


def events(*factors, **settings):
    times = tuple(float(k) for k in range(1, len(factors) + 1))
    return Events(kind="events", times=times, load_factors=factors, **settings)


def test_events_retrace_the_secant_and_go_on_breaking(first):
    """Over the first break, down to nothing, to the other side, and over the second break."""
    rows = followed(strip(stepping=events(OVERSHOOT * first, 0.0, -0.3 * first, 1.1 * OVERSHOOT * first))).rows
    assert [row.event for row in rows[:2]] == ["critical", "arrest"]
    turn, nothing, other = (row for row in rows if row.event == "turn")
    assert rows[0].load_factor == pytest.approx(first, rel=1e-6)
    assert rows[0].time == pytest.approx(1.0 / OVERSHOOT, rel=1e-6)
    assert (turn.load_factor, nothing.load_factor, other.load_factor) == (OVERSHOOT * first, 0.0, -0.3 * first)
    assert (turn.time, nothing.time, other.time) == (1.0, 2.0, 3.0)
    assert nothing.reaction == nothing.stored == 0.0
    assert turn.broken == nothing.broken == other.broken > 0
    assert other.reaction / 0.3 == pytest.approx(turn.reaction / OVERSHOOT, rel=SECANT)
    assert other.stored / 0.09 == pytest.approx(turn.stored / OVERSHOOT**2, rel=SECANT)
    assert rows[-1].event == "end" and rows[-1].broken > other.broken
    assert all(abs(row.ledger_error) < 1e-9 for row in rows if row.work)


def test_events_along_a_way_are_those_of_a_rising_load(first):
    """A way that only rises breaks what a rising load does."""
    along = followed(strip(stepping=events(OVERSHOOT * first))).rows
    rising = followed(strip(stepping=Events(kind="events", end_load_factor=OVERSHOOT * first))).rows
    assert [(row.event, row.broken) for row in along] == [(row.event, row.broken) for row in rising]
    assert along[0].load_factor == pytest.approx(rising[0].load_factor, rel=1e-9)


@pytest.mark.parametrize(
    ("settings", "sentence"),
    [
        ({"times": (1.0,)}, "events take both times and load_factors"),
        ({"times": (1.0,), "load_factors": (1.0,), "end_load_factor": 2.0}, "times say how it goes"),
        ({"times": (1.0,), "load_factors": (1.0,), "control": "energy"}, "times prescribe it"),
        ({"times": (2.0, 1.0), "load_factors": (1.0, 0.0)}, "must strictly rise from 0"),
    ],
)
def test_events_with_other_ends_are_told(settings, sentence):
    with pytest.raises(ValueError, match=sentence):
        Events(kind="events", **settings)


def test_events_over_time_need_linear_kinematics():
    with pytest.raises(ValueError, match="scales states with the load, which finite kinematics do not"):
        strip(kinematics="finite", stepping=events(1.0))


def test_the_first_break_is_told_at_its_load(first):
    """As without times: the state before the break, and not the one after it; the peak is the largest of all states."""
    plain, along = followed(strip()), followed(strip(stepping=events(OVERSHOOT * first, 0.0, 0.8 * first)))
    names = ("first_reaction", "first_displacement", "first_row")
    for name in names:
        assert along.body.state.program[name] == pytest.approx(plain.body.state.program[name], rel=1e-6)
    whole = followed(strip(stepping=events(0.3 * first, -0.6 * first, 0.5 * first)))
    program, turns = whole.body.state.program, [row for row in whole.rows if row.event == "turn"]
    assert program["first_row"] == 0.0
    assert program["peak_row"] == 2.0
    assert program["peak"] == pytest.approx(turns[1].reaction, rel=SECANT)
    assert program["peak_displacement"] == turns[1].displacement
