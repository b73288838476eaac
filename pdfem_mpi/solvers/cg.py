"""Preconditioned conjugate gradients on the scene's exact tangent, one fused reduction an iteration.

Linear kinematics need one solve, finite kinematics Newton's method with the tangent of the finite bond forces. The
recurrences are those of Chronopoulos and Gear: the three dot products of an iteration are taken together, after
the one sweep. They are exact sums, so iterates have the same bits on any number of ranks. The recursive residual
is never trusted alone: convergence is declared on the true one.

References
----------
Chronopoulos & Gear, s-step iterative methods for symmetric linear systems, J. Comput. Appl. Math. 25, 1989.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from pdfem_mpi.forces import Forces, NotFinite
from pdfem_mpi.kernels.exact_sums import SIZE, add_products, value
from pdfem_mpi.loading import exact_dots
from pdfem_mpi.parallel.comm import largest, sum_integers
from pdfem_mpi.solvers.convergence import Breakdown, Convergence, NotConverged, Progress
from pdfem_mpi.solvers.multilevel import Preconditioner
from pdfem_mpi.state import State

#: A solve aims at this fraction of the tolerance, so that the true residual passes with the recursive one.
SAFETY = 0.9
#: A solve goes no further than this fraction of its first residual: Newton steps, and linear solves, whose recursive
#: residual drifts away from the true one.
NEWTON_REDUCTION, LINEAR_REDUCTION = 1e-3, 1e-9
#: A residual this much above the best of its solve is round-off growing.
DRIFT = 100.0
#: The true residual must at least halve from one solve to the next.
STAGNATION = 0.5
#: Below this relative residual an indefinite direction is round-off.
ROUND_OFF = 1e-10
#: Room for the residual's growth between two reductions, in the quanta of the restriction.
GROWTH = 2.0**10


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
        On all ranks alike: an indefinite tangent or preconditioner, or a Newton step that leads away. The state is
        left at the best displacements found.
    NotConverged
        On all ranks alike: a residual that stagnates, or too many evaluations.
    NotFinite
        On all ranks alike.
    """
    u, comm = state.u, forces.model.comm
    finite = bool(forces.model.bonds and forces.model.bonds.finite)
    tangent = Forces(forces.model, tangent=True, seconds=forces.seconds) if finite else forces
    residual, step = np.empty_like(u), np.empty_like(u)
    start = forces.evaluations
    relative = math.inf

    at_rest = float(largest(comm, np.array([np.abs(u).max(initial=0.0)]))[0]) == 0.0
    while True:
        if at_rest:
            residual[:] = external  # no internal forces: nothing to evaluate
        else:
            forces.evaluate_surely(u, external, residual)
        reaction = np.where(fixed, residual, 0.0)
        residual[fixed] = 0.0
        square, load, held = exact_dots(comm, [(a, a) for a in (residual, external, reaction)])
        if not math.isfinite(square):
            raise NotFinite(forces.describe_not_finite(u, residual))
        reference = math.sqrt(max(load, held)) or 1.0
        before, relative = relative, math.sqrt(square) / reference
        watch(Progress(state.iteration, relative, 0.0))
        if relative <= tolerance and not at_rest:
            return Convergence(forces.evaluations - start, relative)
        if at_rest and square == 0.0:
            return Convergence(forces.evaluations - start, 0.0)
        if finite and relative > before:
            u -= step
            raise Breakdown(
                f"a Newton step raised the relative residual from {before:.3g} to {relative:.3g}: the load is too "
                "large for one step, or the body is unstable."
            )
        if relative > STAGNATION * before:
            raise NotConverged(
                f"conjugate gradients stagnate at a relative residual of {relative:.3g}, above solver.tolerance = "
                f"{tolerance:.3g}: round-off, or a part that nothing holds. Allow a larger tolerance."
            )
        reduction = NEWTON_REDUCTION if finite else LINEAR_REDUCTION
        goal = max(SAFETY * tolerance * reference, reduction * math.sqrt(square))
        if finite:
            tangent.linearise(u)
        _solve_linear(
            tangent, residual, fixed, goal, max_evaluations - (forces.evaluations - start), preconditioner, step,
            ROUND_OFF * reference,
            lambda norm: _told(watch, state, norm / reference),  # noqa: B023 - called within this turn of the loop
        )  # fmt: skip
        if finite:
            forces.evaluations += tangent.evaluations
            tangent.evaluations = 0
        u += step
        at_rest = False


def improve(
    forces: Forces,
    residual: np.ndarray,
    fixed: np.ndarray,
    goal: float,
    sweeps: int,
    preconditioner: Preconditioner,
    step: np.ndarray,
) -> float:
    """Lower the residual by some iterations on the tangent, and tell the energy that this releases. Collective.

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
    float, dimension force length
        ``1/2 x . (r_before + r_after)``: by how much the step ``x`` lowers the potential energy under constant loads.
    """
    before = residual.copy()
    _solve_linear(forces, residual, fixed, goal, sweeps, preconditioner, step, math.inf, lambda norm: None, stop=True)
    (work,) = exact_dots(forces.model.comm, [(step, before + residual)])
    return 0.5 * float(work)


def _told(watch, state: State, relative: float) -> None:
    state.iteration += 1
    watch(Progress(state.iteration, relative, 0.0))


def _solve_linear(tangent, r, fixed, goal, max_evaluations, preconditioner, x, round_off, told, stop=False) -> None:
    """``K x = r`` until the recursive residual's norm is at most ``goal``; ``r`` is overwritten. Collective.

    An indefinite direction met below ``round_off`` ends the solve quietly: the true residual decides. After
    ``max_evaluations`` it ends quietly too if ``stop`` says so.
    """
    nothing = np.zeros_like(r)
    z, w, p, s = (np.zeros_like(r) for _ in range(4))
    x[:] = 0.0
    (square,) = exact_dots(tangent.model.comm, [(r, r)])
    limit = tangent.evaluations + max_evaluations
    gamma_old = alpha = 0.0
    best = math.inf
    while True:
        preconditioner.apply(r, GROWTH * math.sqrt(square), z)
        gamma, delta, square = _sweep(tangent, z, nothing, r, w, fixed)
        norm = math.sqrt(square)
        if math.isnan(delta) or math.isnan(norm):
            raise NotFinite(tangent.describe_not_finite(z, w))
        told(norm)
        best = min(best, norm)
        if norm <= goal or norm > DRIFT * best:
            return
        if tangent.evaluations >= limit and not stop:
            raise NotConverged(
                "solver.max_evaluations were used up before the tolerance was reached. Allow more evaluations or a "
                "larger tolerance."
            )
        beta = gamma / gamma_old if alpha else 0.0
        curvature = delta - beta * gamma / alpha if alpha else delta
        if gamma <= 0.0 or curvature <= 0.0:
            if norm <= round_off:
                return
            what = "preconditioner" if gamma <= 0.0 else "stiffness"
            raise Breakdown(f"the {what} is not positive definite along a search direction: the body is unstable.")
        alpha, gamma_old = gamma / curvature, gamma
        p *= beta
        p += z
        s *= beta
        s += w
        x += alpha * p
        r -= alpha * s
        if stop and tangent.evaluations >= limit:
            return


def _sweep(forces, z, nothing, r, w, fixed):
    """``w = K z``, and the products ``r.z``, ``z.w`` and ``r.r`` in one reduction. Collective."""
    while True:
        forces.evaluate(z, nothing, w)
        np.negative(w, out=w)
        w[fixed] = 0.0
        digits = np.zeros((3, SIZE), np.int64)
        for row, (x, y) in zip(digits, ((r, z), (z, w), (r, r)), strict=True):
            add_products(x, y, row)
        joined = sum_integers(forces.model.comm, np.concatenate([digits.reshape(-1), forces.flags()]))
        if forces.check_bounds(joined[-3:]):
            return [value(row) for row in joined[:-3].reshape(3, SIZE)]
