"""The error in the energy norm, estimated from the coefficients of conjugate gradients.

A step lowers the square of the error's energy norm by exactly ``alpha_j gamma_j``, with ``gamma_j = r_j . P r_j``
(Hestenes & Stiefel), and these numbers hold in finite precision too (Strakos & Tichy). What is left after the last step
is the tail of their sum. It is not computed, which would cost more steps, but continued as a geometric series at the
rate of the last few steps. So the result is an estimate, not a bound: where convergence pauses, it is too small before
the pause. The residual stays what convergence is declared on.

References
----------
Hestenes & Stiefel, Methods of conjugate gradients for solving linear systems, J. Res. Nat. Bur. Standards 49, 1952.
Strakos & Tichy, On error estimation in the conjugate gradient method and why it works in finite precision computations,
Electron. Trans. Numer. Anal. 13, 2002.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

#: Steps that the rate is taken over, and the slowest rate that is believed.
STEPS, SLOWEST = 4, 0.9

#: Halvings of the interval with the smallest eigenvalue: to the last digit.
HALVINGS = 60


def smallest_eigenvalue(diagonal: list[float], squares: list[float]) -> float:
    """That of a symmetric tridiagonal matrix with ``squares`` of the entries beside its diagonal, by halving.

    A shift is below it when all pivots of the elimination are positive (Sturm's sequence).
    """
    roots = [math.sqrt(square) for square in squares]
    around = [a + b for a, b in zip([0.0, *roots], [*roots, 0.0], strict=True)]
    low, high = min(d - a for d, a in zip(diagonal, around, strict=True)), min(diagonal)
    for _ in range(HALVINGS):
        middle, pivot, below = 0.5 * (low + high), 1.0, True
        for d, square in zip(diagonal, [0.0, *squares], strict=True):
            pivot = d - middle - square / pivot
            if not pivot > 0.0:
                below = False
                break
        low, high = (middle, high) if below else (low, middle)
    return 0.5 * (low + high)


@dataclass
class Coefficients:
    """Coefficients of the steps made so far.

    Attributes
    ----------
    alpha, beta, gamma : list of float
        Step lengths; share of the last direction in that of the step, 0 where there is none; ``r_j . P r_j``.
    """

    alpha: list[float] = field(default_factory=list)
    beta: list[float] = field(default_factory=list)
    gamma: list[float] = field(default_factory=list)

    def add(self, alpha: float, beta: float, gamma: float) -> None:
        """Append a step."""
        self.alpha.append(alpha)
        self.beta.append(beta)
        self.gamma.append(gamma)

    def smallest_ritz(self) -> float:
        """Smallest eigenvalue of the Lanczos matrix of the steps, an estimate of that of ``P K``; dimension 1."""
        alpha, beta = np.array(self.alpha), np.array(self.beta)
        diagonal = 1.0 / alpha
        diagonal[1:] += beta[1:] / alpha[:-1]
        beside = np.sqrt(beta[1:]) / alpha[:-1]
        return smallest_eigenvalue(diagonal.tolist(), (beside**2).tolist())

    def square_error(self) -> float | None:
        """Estimated square of the energy norm of the error after the last step; None after a single one."""
        lowered = [a * g for a, g in zip(self.alpha[-STEPS - 1 :], self.gamma[-STEPS - 1 :], strict=True)]
        if len(lowered) < 2:
            return None
        rate = min((lowered[-1] / lowered[0]) ** (1.0 / (len(lowered) - 1)), SLOWEST)
        return lowered[-1] * rate / (1.0 - rate)
