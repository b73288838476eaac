"""When a state counts as equilibrium: by what a tenfold smaller residual moves, on ratios that are given."""

import pytest

from pdfem_mpi.stepping.arrest import (
    FIRST_LOOK,
    LEAST_RESIDUAL,
    LOOSE,
    MOST_DRIFT,
    NUMBERS,
    TENFOLD,
    forget,
    is_settled,
    next_goal,
)

TOLERANCE = 1e-3


def looks(states, tolerance=TOLERANCE, decides=lambda change: False):
    """Whether each of the states, a residual and a ratio, settles it; up to the first that does."""
    program, answers = dict.fromkeys(NUMBERS, 0.0), []
    for relative, ratio in states:
        program["relative"] = relative
        answers.append(is_settled(program, ratio, tolerance, LOOSE, decides))
        if answers[-1]:
            break
    return answers, program


def test_one_look_is_never_enough():
    """Whatever its residual, above round-off: the next goes to a tenth of it."""
    answers, program = looks([(5e-5, 0.9)])
    assert answers == [False]
    assert program["goal"] == pytest.approx(5e-6) and program["ratio"] == 0.9


def test_a_ratio_that_does_not_move_settles_it():
    """Moves are relative to the ratio."""
    quiet = 0.9 * (1.0 + 0.9 * MOST_DRIFT)
    assert looks([(5e-5, 0.9), (4e-6, quiet)])[0] == [False, True]
    assert looks([(5e-5, 0.9), (4e-6, 0.9 * (1.0 + 1.1 * MOST_DRIFT)), (4e-7, 0.9)])[0] == [False, False, False]


def test_what_the_ratio_may_still_move_by_decides():
    """A bond that it might bring to its limit is waited for: a quarter of the last move is left."""

    def near_limit(change):
        return 0.9989 + change > 0.999

    states = [(5e-5, 0.9985), (4e-6, 0.9989), (3e-7, 0.99891)]
    assert looks(states, decides=near_limit)[0] == [False, True]
    assert looks(states, decides=lambda change: 0.99895 + change > 0.999)[0] == [False, False, True]


@pytest.mark.parametrize("tolerance", [1e-4, 1e-5, 1e-6])
def test_a_tighter_tolerance_takes_the_same_looks(tolerance):
    """It goes on where the looser one stops."""
    states = [(2e-3, 0.9), (0.8e-4, 0.91), (7e-6, 0.91001), (6e-7, 0.91001), (5e-8, 0.91001)]
    goals = []
    for wanted in (TOLERANCE, tolerance):
        program = dict.fromkeys(NUMBERS, 0.0)
        goals.append([])
        for relative, ratio in states:
            program["relative"] = relative
            if is_settled(program, ratio, wanted, LOOSE, lambda change: False):
                break
            goals[-1].append(program["goal"])
        assert relative <= wanted
    assert goals[1][: len(goals[0])] == goals[0]


def test_above_the_tolerance_nothing_settles():
    """However quiet the ratio."""
    assert looks([(5e-3, 0.9), (4e-4, 0.9), (3e-5, 0.9)], tolerance=1e-4)[0] == [False, False, True]


def test_round_off_is_not_chased():
    """A residual that does not halve within the tolerance, or is small already, is as good as it gets."""
    assert looks([(5e-5, 0.9), (4e-5, 0.99)])[0] == [False, True]
    assert looks([(5e-5, 0.9), (2e-5, 0.99)])[0] == [False, False]  # on its way to the goal
    assert looks([(LEAST_RESIDUAL, 0.9)])[0] == [True]
    assert looks([(5e-3, 0.9), (4e-3, 0.9)], tolerance=1e-3)[0] == [False, False]
    assert looks([(1e-9, 0.9)], tolerance=1e-9)[0] == [True]


def test_goals_of_the_looks():
    """Not above where looking pays, then a tenth at a time, and not below round-off."""
    assert next_goal(0.5, TOLERANCE, FIRST_LOOK) == FIRST_LOOK
    assert next_goal(1e-4, TOLERANCE, FIRST_LOOK) == TENFOLD * 1e-4
    assert next_goal(2e-8, TOLERANCE, FIRST_LOOK) == LEAST_RESIDUAL
    assert next_goal(2e-8, 1e-9, FIRST_LOOK) == pytest.approx(2e-9)


def test_what_broke_is_forgotten():
    """A body with fewer bonds is another one."""
    _, program = looks([(5e-5, 0.9)])
    forget(program)
    assert all(program[name] == 0.0 for name in NUMBERS)
