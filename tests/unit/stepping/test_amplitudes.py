"""Load factors over a pseudo-time: bodies that are loaded, unloaded and loaded again."""

import numpy as np
import pytest

import pdfem_mpi as pdfem
from pdfem_mpi.deck.programs import Steps
from pdfem_mpi.deck.toml import parse_deck
from support.failing import followed, strip
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
