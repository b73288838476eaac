"""Bounds of what forces meet, on which the quanta of their sums rest."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np

#: Bounds are powers of two, at least this much above what was met, so that they are rarely met again.
HEADROOM = 2.0
#: A bound this much above what is met is lowered: it costs digits.
SLACK = 2.0**8
#: An evaluation with a bound this much above the fitting one lacks digits.
COARSE = 2.0**16
#: Numbers from here on count as infinite: their products would be.
LARGEST = 2.0**400


@dataclass
class Bounds:
    """What the quanta of the order-independent sums rest on; equal on all ranks, part of the state.

    Attributes
    ----------
    bond : float
        Bound of ``|e|`` (finite kinematics, dimension 1), of ``|K' eta . xi|`` (linear, force / length), or of a
        component of a bond's force (tangent, force).
    element : float
        Bound of the differences of displacements within an element (linear, length), or of a component of an element's
        force (finite kinematics and tangent, force).
    parts : dict of Bounds
        Those of other forces that a run keeps: the preconditioner's cycle, a tangent. See `part`.

    They start generous: the first evaluations then count, with fewer digits.
    """

    bond: float = 2.0**-3
    element: float = 2.0**-3
    parts: dict[str, Bounds] = field(default_factory=dict)

    def part(self, name: str) -> Bounds:
        """The bounds of other forces; new ones if they were not asked for before."""
        return self.parts.setdefault(name, Bounds())

    def fill(self, saved: dict[str, Any]) -> None:
        """Set the bounds in place, to what ``dataclasses.asdict`` made of them: forces and solvers have them too."""
        self.bond, self.element = saved["bond"], saved["element"]
        for name, part in saved["parts"].items():
            self.part(name).fill(part)

    def expect(self, change: np.ndarray, from_rest: bool) -> None:
        """Make room for displacements that change by what meets at most ``change``, in the order of `Forces.met`."""
        self.bond, self.element = (
            power_above(float(more) + (0.0 if from_rest else bound))
            for more, bound in zip(change, (self.bond, self.element), strict=True)
        )

    def scale(self, factor: float) -> None:
        """Follow displacements that have become larger by a power of two, and with them what they meet."""
        self.bond, self.element = max(factor * self.bond, 2.0**-199), max(factor * self.element, 2.0**-199)

    def votes(self, met: np.ndarray) -> tuple[int, int, int]:
        """A rank's votes on what its evaluation met, to be added over all ranks.

        Parameters
        ----------
        met : float64, shape (2,)
            What it met, bonds first.

        Returns
        -------
        beyond : int
            1 if it met more than a bound: the evaluation does not count on any rank.
        near_bond, near_element : int
            1 unless so little was met that the bound wastes digits.
        """
        bond, element = met
        beyond = not (bond <= self.bond and element <= self.element)
        return int(beyond), int(bond * SLACK >= self.bond), int(element * SLACK >= self.element)

    def lower(self, met: np.ndarray) -> None:
        """Lower bounds that are more than `HEADROOM` above what was met on all ranks; ``met``, shape (2,)."""
        self.bond, self.element = (
            min(bound, power_above(HEADROOM * float(most))) if most > 0.0 else bound
            for bound, most in zip((self.bond, self.element), met, strict=True)
        )

    def fit(self, met: np.ndarray) -> None:
        """Raise bounds that were met, and lower those far above; ``met``, shape (2,), is that of all ranks."""
        self.bond = _fitted(self.bond, float(met[0]))
        self.element = _fitted(self.element, float(met[1]))


def power_above(x: float) -> float:
    """The smallest power of two above ``x``; above 2^-199."""
    return 2.0 ** math.frexp(max(x, 2.0**-199))[1]


def _fitted(bound: float, met: float) -> float:
    if met > bound or met * SLACK < bound:
        return power_above(HEADROOM * met)
    return bound
