"""Preconditioned conjugate gradients on the scene's exact tangent.

Linear kinematics need one solve, finite kinematics inexact Newton steps on the tangent of the finite bond forces: each
solve ends where the tangent stops being true, as the last step's disagreement of true and recursive residual tells.

The recurrences are those of Chronopoulos and Gear, whose dot products of an iteration are taken together after the one
sweep; the norm of the next residual is summed while the vectors are updated, so that no sweep is spent on finding that
nothing is left to do. Sums are exact, so iterates have the same bits on any number of ranks. The recursive residual is
never trusted alone: convergence is declared on the true one.

References
----------
Chronopoulos & Gear, s-step iterative methods for symmetric linear systems, J. Comput. Appl. Math. 25, 1989.
Eisenstat & Walker, Choosing the forcing terms in an inexact Newton method, SIAM J. Sci. Comput. 17, 1996.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np

from pdfem_mpi.kernels.exact_sums import SIZE, value
from pdfem_mpi.kernels.krylov import finish_product, take_step
from pdfem_mpi.model.forces import Forces
from pdfem_mpi.model.not_finite import NotFinite, describe_not_finite
from pdfem_mpi.model.parts import describe_motion
from pdfem_mpi.model.state import State
from pdfem_mpi.parallel.comm import largest, sum_integers
from pdfem_mpi.parallel.sums import exact_dots
from pdfem_mpi.solvers.convergence import Breakdown, Convergence, NotConverged, Progress
from pdfem_mpi.solvers.energy_error import Coefficients
from pdfem_mpi.solvers.preconditioner.preconditioner import Preconditioner

#: A solve aims at this fraction of the tolerance, so that the true residual passes with the recursive one.
SAFETY = 0.9
#: A linear solve goes no further than this fraction of its first residual: its recursive residual drifts away.
LINEAR_REDUCTION = 1e-9
#: The first Newton step goes to this fraction of its first residual; later ones to where the last one's disagreement of
#: true and recursive residual, which falls with the residual, says that the tangent stops being true; within limits.
FIRST_FORCING, LEAST_FORCING, MOST_FORCING = 1e-2, 1e-6, 1e-1
#: A residual this much above the best of its solve is round-off growing, once the solve has lowered it so far or began
#: this near to round-off; before that, a body that hangs together by little raises it.
DRIFT, LOWERED, NEAR_ROUND_OFF = 100.0, 1e-3, 1e4
#: The true residual must at least halve from one solve to the next, in a Newton step below `NEWTON_FLOOR` only.
STAGNATION, NEWTON_FLOOR = 0.5, 1e-8
#: What turns moves on a circle, and Newton's straight step stretches it: residuals rise before they fall. So many steps
#: in a row may leave a residual above the one before the first of them.
MOST_RISES = 6
#: Residuals are relative to at least this fraction of the largest load or reaction met on the way: a part that its
#: supports only carry along comes to rest without any force.
FORCELESS = 1e-7
#: Eigenvalues of the preconditioned stiffness below this belong to mechanisms. Bodies had 0.16 and more, one with a
#: crack through half its width 0.009.
NO_STIFFNESS = 1e-6
#: Below this relative residual an indefinite direction is round-off.
ROUND_OFF = 1e-10


def solve(
    forces: Forces,
    state: State,
    external: np.ndarray,
    fixed: np.ndarray,
    tolerance: float,
    max_evaluations: int,
    preconditioner: Preconditioner,
    watch: Callable[[Progress], None] = lambda progress: None,
) -> Convergence:
    """Bring the state to equilibrium under constant loads, from where it is. Collective.

    Parameters are those of `adr.solve`, with the preconditioner.

    Raises
    ------
    Breakdown
        On all ranks alike: an indefinite tangent or preconditioner, or Newton steps that lead away. The state is
        left at the best displacements found.
    NotConverged
        On all ranks alike: a residual that stagnates, or too many evaluations.
    NotFinite
        On all ranks alike.
    """
    u, comm = state.u, forces.model.comm
    finite = forces.model.finite
    if finite:
        tangent = Forces(forces.model, tangent=True, seconds=forces.seconds, swept=forces.swept)
    else:
        tangent = forces.with_own_bounds()
    residual = np.empty_like(u)
    start, norm, forcing, largest_met = forces.evaluations, math.inf, FIRST_FORCING, 0.0
    sequence = Sequence(tangent, fixed, preconditioner, np.zeros_like(u))
    rise = _Rise()

    at_rest = float(largest(comm, np.array([np.abs(u).max(initial=0.0)]))[0]) == 0.0
    while True:
        if at_rest:
            residual[:] = external  # no internal forces: nothing to evaluate
        else:
            with rise.guarded(u):
                forces.evaluate_surely(u, external, residual)
        internal = external - residual
        reaction = np.where(fixed, residual, 0.0)
        residual[fixed] = 0.0
        square, load, held, energy = exact_dots(
            comm, [(residual, residual), (external, external), (reaction, reaction), (u, internal)]
        )
        if not math.isfinite(square):
            with rise.guarded(u):
                raise NotFinite(describe_not_finite(forces.model, u, residual))
        largest_met = max(largest_met, load, held)
        reference = math.sqrt(max(load, held, FORCELESS**2 * largest_met)) or 1.0
        before, norm = norm, math.sqrt(square)
        relative = norm / reference
        watch(Progress(state.iteration, relative, 0.0, (sequence, residual, internal, reaction)))
        if relative <= tolerance and not at_rest:
            return Convergence(forces.evaluations - start, relative, sequence.relative_energy_error(energy))
        if at_rest and square == 0.0:
            return Convergence(forces.evaluations - start, 0.0, 0.0)
        if finite and relative > NEWTON_FLOOR:
            rise.follow(u, sequence.x, before, norm, reference)
        if norm > STAGNATION * before and not (finite and relative > NEWTON_FLOOR):
            raise NotConverged(
                f"conjugate gradients stagnate at a relative residual of {relative:.3g}, above solver.tolerance = "
                f"{tolerance:.3g}: {sequence.obstacle() or 'round-off. Allow a larger tolerance.'}"
            )
        if finite:
            if sequence.first_norm:
                forcing = abs(norm - sequence.norm) * norm / sequence.first_norm**2
                forcing = min(max(forcing, LEAST_FORCING), MOST_FORCING)
            tangent.linearise(u, 0.0 if at_rest else forces.bounds.bond)
        goal = max(SAFETY * tolerance * reference, (forcing if finite else LINEAR_REDUCTION) * norm)
        try:
            with rise.guarded(u):
                sequence.run(
                    residual, norm, goal, max_evaluations - (forces.evaluations - start), ROUND_OFF * reference,
                    lambda norm: _told(watch, state, norm / reference),  # noqa: B023 - called within this turn
                )  # fmt: skip
        finally:
            forces.evaluations += tangent.evaluations
            tangent.evaluations = 0
        u += sequence.x
        if not finite:
            forces.bounds.expect(sequence.reach(), at_rest)
        at_rest = False


class _Rise:
    """Steps in a row that left the residual above what it was before them, and the displacements then."""

    def __init__(self) -> None:
        self.count, self.norm, self.u = 0, math.inf, np.empty(0)

    def follow(self, u: np.ndarray, step: np.ndarray, before: float, norm: float, reference: float) -> None:
        """Look at the residual after a step.

        Raises
        ------
        Breakdown
            It stayed above for too long; ``u`` is what it was before.
        """
        if not norm > (self.norm if self.count else before):
            self.count = 0
            return
        if not self.count:
            self.norm, self.u = before, u - step
        self.count += 1
        if self.count > MOST_RISES:
            u[:] = self.u
            raise Breakdown(
                f"Newton steps raised the relative residual from {self.norm / reference:.3g} to "
                f"{norm / reference:.3g}: the load is too large for one step, or the body is unstable."
            )

    @contextmanager
    def guarded(self, u: np.ndarray) -> Iterator[None]:
        """What goes wrong inside while the residual is up is a breakdown, and ``u`` is what it was before."""
        try:
            yield
        except (Breakdown, NotFinite) as error:
            if not self.count:
                raise
            u[:] = self.u
            raise Breakdown(str(error)) from error


def improve(
    forces: Forces,
    residual: np.ndarray,
    fixed: np.ndarray,
    goal: float,
    sweeps: int,
    preconditioner: Preconditioner,
    step: np.ndarray,
) -> tuple[float, float]:
    """Lower the residual by some iterations on the tangent. Collective.

    Parameters
    ----------
    forces : Forces
        Linear, or linearised.
    residual : float64, shape (n_unknowns,), dimension force
        0 on fixed unknowns; becomes that of the tangent after the step.
    fixed : bool, shape (n_unknowns,)
    goal : float, dimension force
        Norm of the residual that is good enough.
    sweeps : int
        At most this many.
    preconditioner : Preconditioner
    step : float64, shape (n_unknowns,), dimension length
        Overwritten: what is to be added to the displacements.

    Returns
    -------
    before, after : float, dimension force length
        ``x . r`` with the residuals before and after the step ``x``. A fraction ``f`` of it lowers the potential energy
        under constant loads by ``f before - f^2 (before - after) / 2``.
    """
    before = residual.copy()
    (square,) = exact_dots(forces.model.comm, [(residual, residual)])
    own = forces if forces.tangent else forces.with_own_bounds()
    sequence = Sequence(own, fixed, preconditioner, step)
    try:
        sequence.run(residual, math.sqrt(square), goal, sweeps, math.inf, lambda norm: None, stop=True)
    finally:
        if own is not forces:
            forces.evaluations += own.evaluations
    first, last = exact_dots(forces.model.comm, [(step, before), (step, residual)])
    return float(first), float(last)


def _told(watch, state: State, relative: float) -> None:
    state.iteration += 1
    watch(Progress(state.iteration, relative, 0.0))


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

    def run(self, r, norm, goal, max_evaluations, round_off, told, stop=False) -> None:
        """``K x = r`` until the recursive residual's norm is at most ``goal``; ``r`` is overwritten. Collective.

        ``norm`` is that of ``r``. An indefinite direction met below ``round_off`` ends the run quietly: the true
        residual decides. After ``max_evaluations`` it ends quietly too if ``stop`` says so.
        """
        forces = self.forces
        self.x[:] = 0.0
        self.met.clear()
        limit = forces.evaluations + max_evaluations
        self.first_norm = self.norm = best = norm
        trusted = max(LOWERED * norm, NEAR_ROUND_OFF * round_off)
        gamma = curvature = length = 0.0
        while True:
            if forces.evaluations >= limit:
                if stop:
                    return
                raise NotConverged(
                    "solver.max_evaluations were used up before the tolerance was reached. "
                    + (self.obstacle() or "Allow more evaluations or a larger tolerance.")
                )
            self.preconditioner.apply(r, self.norm, self.z)
            if not self.coefficients.alpha:
                forces.guess_bounds(self.z)
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
            told(self.norm)
            best = min(best, self.norm)
            if self.norm <= goal or (self.norm > DRIFT * best and best <= trusted):
                return

    def _sweep(self, r) -> list[float]:
        """``w = K z``, and the products ``r.z`` and ``z.w`` in one reduction. Collective."""
        forces = self.forces
        while True:
            forces.evaluate(self.z, self.nothing, self.w)
            digits = np.zeros((2, SIZE), np.int64)
            finish_product(self.w, self.fixed, self.z, r, digits)
            joined = sum_integers(forces.model.comm, np.concatenate([digits.reshape(-1), forces.flags()]))
            if forces.check_bounds(joined[-3:]):
                return [value(row) for row in joined[:-3].reshape(2, SIZE)]
