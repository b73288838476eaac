"""What a solver reports, and how it fails."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True)
class Convergence:
    """How equilibrium was reached.

    Attributes
    ----------
    evaluations : int
        Force evaluations of this solve.
    residual : float, dimension 1
        Norm of the residual force on the free unknowns, relative to the external force or, where larger, to the
        reactions.
    energy_error : float or None, dimension 1
        Estimated energy norm of the error, relative to that of the displacements; None where a solver has no estimate.
    """

    evaluations: int
    residual: float
    energy_error: float | None = None


@dataclass(frozen=True)
class Progress:
    """State of a solve, for whoever watches it.

    ``work`` are the arrays that the solver holds while it works: to be counted, and not to be changed.
    """

    iteration: int
    residual: float
    damping: float
    work: tuple[Any, ...] = field(default=(), compare=False)


class NotConverged(Exception):
    """No equilibrium: diverged, or the allowed evaluations are used up. Raised on all ranks alike."""


class Breakdown(NotConverged):
    """A method cannot go on, where a slower one still may. Raised on all ranks alike."""
