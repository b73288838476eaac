"""When a state counts as equilibrium: once what its residual leaves open does not matter any more.

Two things are read from a state: which bonds break in it, and at which load the next one does. Both hang on stretches
relative to their limits, and how far a residual moves these cannot be told beforehand: by the body, its surface
correction and where the residual sits, one of 1e-3 moved the largest by 4e-4 or by 2 %. So the residual is lowered
tenfold and the state is looked at again: what the largest ratio moved by tells what it may still move by.

Looks follow one another by the residuals they find, not by the deck's tolerance: a tighter one takes the same looks and
some more, and so the same way.
"""

from __future__ import annotations

from collections.abc import Callable

#: The load of the next break is read once a tenfold smaller residual moved it by no more than this, relative.
MOST_DRIFT = 5e-4
#: What a residual is lowered by before the state is looked at again, and the part of the last move that may be left:
#: errors that fall with the residual leave a ninth.
TENFOLD, LEFT = 0.1, 0.25
#: Relative residuals above these are not worth a look on the way down: where the state decides which bonds break at
#: the load it is scaled to, and where an avalanche stops, whose relaxation goes no further between batches. (Wider
#: relaxation takes other bonds: at 1e-3 the peak of a plate with a hole came out 2 % too high.)
FIRST_LOOK, LOOSE = 1e-3, 1e-4
#: Relative residuals below this are not asked for beyond the deck's tolerance: round-off begins some decades below.
LEAST_RESIDUAL = 1e-8
#: A residual that did not even halve is as small as it gets.
STAGNATION = 0.5
#: What ``program`` keeps here: the ``ratio`` and the residual of the ``looser`` state that was looked at before (0: of
#: none), and the ``goal`` of the relaxation under way (0: `LOOSE`).
NUMBERS = ("ratio", "looser", "goal")


def is_settled(
    program: dict[str, float], ratio: float, tolerance: float, first: float, decides: Callable[[float], bool]
) -> bool:
    """Whether the state may be taken for the equilibrium; if not, ``program["goal"]`` is the residual to go to.

    Parameters
    ----------
    program : dict
        Numbers of the load program; ``relative`` is the residual.
    ratio : float, dimension 1
        Largest stretch over its critical one.
    tolerance : float, dimension 1
        The deck's, of the relative residual.
    first : float, dimension 1
        `FIRST_LOOK` or `LOOSE`.
    decides : callable
        Whether ratios that move by so much decide otherwise about some bond. Collective.
    """
    relative, before = program["relative"], program["ratio"]
    enough = relative <= tolerance
    if enough and (ratio == 0.0 or relative <= least(tolerance)):
        return True
    if before and relative > program["goal"]:
        return enough and relative > STAGNATION * program["looser"]
    drift = abs(ratio - before)
    if enough and before and drift <= MOST_DRIFT * ratio and not decides(LEFT * drift):
        return True
    program["ratio"], program["looser"] = ratio, relative
    program["goal"] = next_goal(relative, tolerance, first)
    return False


def next_goal(relative: float, tolerance: float, first: float) -> float:
    """The relative residual at which the next look is taken."""
    return max(min(first, TENFOLD * relative), least(tolerance))


def least(tolerance: float) -> float:
    """The smallest relative residual that is ever asked for."""
    return min(tolerance, LEAST_RESIDUAL)


def forget(program: dict[str, float]) -> None:
    """Bonds broke, or the load changed: the next state is another one."""
    program.update(dict.fromkeys(NUMBERS, 0.0))
