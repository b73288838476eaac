"""One sequence of preconditioned conjugate gradients for a linear, or linearised, residual force."""

from __future__ import annotations

import math

import numpy as np

from pdfem_mpi.kernels.exact_sums import SIZE, value
from pdfem_mpi.kernels.krylov import finish_product, take_step
from pdfem_mpi.model.bounds import power_above
from pdfem_mpi.model.forces import Forces
from pdfem_mpi.model.mechanisms import describe_motion
from pdfem_mpi.model.not_finite import NotFinite, describe_not_finite
from pdfem_mpi.parallel.comm import largest, sum_integers
from pdfem_mpi.solvers.convergence import Breakdown, NotConverged
from pdfem_mpi.solvers.energy_error import Coefficients
from pdfem_mpi.solvers.preconditioner.preconditioner import Preconditioner

#: A residual this much above the best of its solve is round-off growing, once the solve has lowered it so far or began
#: this near to round-off; before that, a body that hangs together by little raises it.
DRIFT, LOWERED, NEAR_ROUND_OFF = 100.0, 1e-3, 1e4
#: Eigenvalues of the preconditioned stiffness below this belong to mechanisms. Bodies had 0.16 and more, one with a
#: crack through half its width 0.009.
NO_STIFFNESS = 1e-6
#: Bounds are lowered when the residual has fallen by the one, and keep the other as room for rougher directions.
MOST_ROOM, ROOM = 64.0, 4.0


class Sequence:
    """Conjugate gradients on one tangent after the other.

    Attributes
    ----------
    x : float64, shape (n_unknowns,)
        Displacement of the last `run`.
    first_norm, norm : float
        Of the recursive residual at the start and at the end of the last `run`.
    met : list of float64, shape (2,)
        What this rank's evaluations of the last `run` met, as `Forces.met`.
    """

    def __init__(self, forces: Forces, fixed: np.ndarray, preconditioner: Preconditioner, x: np.ndarray):
        self.forces, self.fixed, self.preconditioner, self.x = forces, fixed, preconditioner, x
        self.p, self.s, self.z, self.w, self.nothing = (np.zeros(forces.model.n_unknowns) for _ in range(5))
        self.coefficients = Coefficients()
        self.met: list[np.ndarray] = []
        self.first_norm, self.norm = 0.0, 0.0
        self._size = 0.0  # the power of two above the residual's norm that bounds were set for

    def relative_energy_error(self, energy: float) -> float | None:
        """Estimated energy norm of the error over that of the displacements, None without steps to judge by."""
        square = self.coefficients.square_error()
        return math.sqrt(square / energy) if square is not None and energy > 0.0 else None

    def reach(self) -> np.ndarray:
        """Bounds of what the evaluation of ``x`` can meet, as `Forces.met`; shape (2,). Collective.

        The largest of each evaluation is taken over all ranks before directions are summed up: sums of each rank's own
        would depend on how the body is shared out.
        """
        met = largest(self.forces.model.comm, np.array(self.met).reshape(-1, 2))
        steps = slice(len(self.coefficients.alpha) - len(met), None)
        total, direction = np.zeros(2), np.zeros(2)
        for row, alpha, beta in zip(met, self.coefficients.alpha[steps], self.coefficients.beta[steps], strict=True):
            direction = row + beta * direction
            total += alpha * direction
        return total

    def obstacle(self) -> str:
        """A sentence about the motion that meets hardly any resistance; empty where there is none. Collective."""
        if not self.coefficients.alpha or self.coefficients.smallest_ritz() > NO_STIFFNESS:
            return ""
        return self._moving()

    def _remedy(self) -> str:
        fitted = self.forces.model.body_fit
        if fitted is None or fitted.fit is None or fitted.fit.signs != "free":
            return ""
        return (
            " Fitted bond factors of both signs may leave a body without stable equilibrium, thin or skewed ones above "
            'all: use peridynamics.signs = "bounded" or surface_correction = "virial".'
        )

    def _moving(self) -> str:
        return (
            f"{describe_motion(self.forces.model, self.x)}, with hardly any resistance: a mechanism, or too few "
            "supports. Hold that part, or join it to the rest."
        )

    def run(self, r, norm, goal, max_evaluations, round_off, observe, stop=False) -> None:
        """``K x = r`` until the recursive residual's norm is at most ``goal``; ``r`` is overwritten. Collective.

        ``norm`` is that of ``r``. An indefinite direction met below ``round_off`` ends the run quietly: the true
        residual decides. With ``stop`` it ends quietly after so many steps too, whatever evaluations they took: one is
        repeated where it does not fit its bounds, and last digits decide whether it does.
        """
        forces = self.forces
        self.x[:] = 0.0
        self.met.clear()
        limit = forces.evaluations + max_evaluations
        self.first_norm = self.norm = best = norm
        trusted = max(LOWERED * norm, NEAR_ROUND_OFF * round_off)
        gamma = curvature = length = 0.0
        while True:
            if stop and len(self.met) >= max_evaluations:
                return
            if not stop and forces.evaluations >= limit:
                raise NotConverged(
                    "solver.max_evaluations were used up before the tolerance was reached. "
                    + (self.obstacle() or "Allow more evaluations or a larger tolerance.")
                )
            self._precondition(r)
            gamma_old, (gamma, delta) = gamma, self._sweep(r)
            if math.isnan(gamma) or math.isnan(delta):
                raise NotFinite(describe_not_finite(forces.model, self.z, self.w))
            beta = gamma / gamma_old if gamma_old else 0.0
            curvature = delta - beta * beta * curvature
            length = gamma + beta * beta * length  # p . P^-1 p
            if gamma <= 0.0 or curvature <= 0.0:
                if self.norm <= round_off:
                    return
                if gamma > 0.0 and curvature >= -NO_STIFFNESS * length and not forces.tangent:
                    np.add(self.z, beta * self.p, out=self.x)
                    raise NotConverged(f"conjugate gradients find no equilibrium: {self._moving()}")
                what = "preconditioner" if gamma <= 0.0 else "stiffness"
                reason = f"the {what} is not positive definite along a search direction: the body is unstable."
                if gamma > 0.0 and not forces.tangent:  # whatever the load: relaxation would fare no better
                    raise NotConverged(f"{reason}{self._remedy()}")
                np.add(self.z, beta * self.p, out=self.x)
                raise Breakdown(f"{reason} Along it {describe_motion(forces.model, self.x)}.")
            alpha = gamma / curvature
            self.coefficients.add(alpha, beta, gamma)
            digits = np.zeros(SIZE, np.int64)
            take_step(self.z, self.w, alpha, beta, self.p, self.s, self.x, r, digits)
            self.norm = math.sqrt(value(sum_integers(forces.model.comm, digits)))
            self.met.append(forces.met.copy())
            observe(self.norm)
            best = min(best, self.norm)
            if self.norm <= goal or (self.norm > DRIFT * best and best <= trusted):
                return

    def _precondition(self, r) -> None:
        """``z = P r``; whether the first one counts is seen at once, that of later ones after the sweep. Collective.

        Bounds follow the residual, which ``z`` is proportional to: lowering them by what was met takes a reduction.
        """
        size = power_above(self.norm)
        if self.met:
            self.preconditioner.apply(r, self.norm, self.z)
        else:
            self.preconditioner.apply_surely(r, self.norm, self.z)
        if not self.coefficients.alpha:
            self.forces.guess_bounds(self.z)
            self._size = size
        elif size > self._size or size < self._size / MOST_ROOM:
            size = max(size, min(ROOM * size, self._size))
            self.forces.bounds.scale(size / self._size)
            self._size = size

    def _sweep(self, r) -> list[float]:
        """``w = K z``, and the products ``r.z`` and ``z.w`` in one reduction, with all votes on bounds. Collective."""
        forces, preconditioner = self.forces, self.preconditioner
        while True:
            before = forces.bounds.bond, forces.bounds.element
            forces.evaluate(self.z, self.nothing, self.w)
            digits = np.zeros((2, SIZE), np.int64)
            finish_product(self.w, self.fixed, self.z, r, digits)
            votes = forces.flags() + preconditioner.flags()
            joined = sum_integers(forces.model.comm, np.concatenate([digits.reshape(-1), votes]))
            if not preconditioner.check_bounds(joined[-3:]):
                preconditioner.apply_surely(r, self.norm, self.z)
                continue
            counts = forces.check_bounds(joined[-6:-3])
            if before != (forces.bounds.bond, forces.bounds.element):
                self._size = power_above(self.norm)
            if counts:
                return [value(row) for row in joined[:-6].reshape(2, SIZE)]
