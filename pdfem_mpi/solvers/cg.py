"""Preconditioned conjugate gradients on the scene's exact tangent.

Linear kinematics need one solve, finite kinematics inexact Newton steps on the tangent of the finite bond forces. Each
solve ends where the tangent is no longer good enough, judged by how far true and recursive residual differed after the
last step.

The recurrences are those of Chronopoulos and Gear, whose dot products of an iteration are taken together after the one
sweep; the norm of the next residual is summed while the vectors are updated, so that convergence is noticed without
another sweep. Sums are exact, so iterates have the same bits on any number of ranks. The recursive residual is
never trusted alone: convergence is declared on the true one.

References
----------
Chronopoulos & Gear, s-step iterative methods for symmetric linear systems, J. Comput. Appl. Math. 25, 1989.
Eisenstat & Walker, Choosing the forcing terms in an inexact Newton method, SIAM J. Sci. Comput. 17, 1996.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext

import numpy as np

from pdfem_mpi.model.forces import Forces
from pdfem_mpi.model.not_finite import NotFinite, describe_not_finite
from pdfem_mpi.model.state import State
from pdfem_mpi.parallel.comm import largest
from pdfem_mpi.parallel.sums import exact_dots
from pdfem_mpi.solvers.convergence import Breakdown, Convergence, NotConverged, Progress
from pdfem_mpi.solvers.preconditioner.preconditioner import Preconditioner
from pdfem_mpi.solvers.sequence import Sequence

#: A solve aims at this fraction of the tolerance, so that the true residual passes with the recursive one.
SAFETY = 0.9
#: A linear solve goes no further than this fraction of its first residual: its recursive residual drifts away.
LINEAR_REDUCTION = 1e-9
#: The first Newton step goes to this fraction of its first residual; later ones to where the last one's disagreement of
#: true and recursive residual, which falls with the residual, says that the tangent stops being true; within limits.
FIRST_FORCING, LEAST_FORCING, MOST_FORCING = 1e-2, 1e-6, 1e-1
#: The true residual must at least halve from one solve to the next, in a Newton step below `NEWTON_FLOOR` only.
STAGNATION, NEWTON_FLOOR = 0.5, 1e-8
#: What turns moves on a circle, and Newton's straight step stretches it: residuals rise before they fall. So many steps
#: in a row may leave a residual above the one before the first of them.
MOST_RISES = 6
#: Residuals are relative to at least this fraction of the largest load or reaction met on the way: a part that its
#: supports only carry along comes to rest without any force.
FORCELESS = 1e-7
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
    u, finite, start = state.u, forces.model.finite, forces.evaluations
    tangent = _tangent_of(forces)
    sequence = Sequence(tangent, fixed, preconditioner, np.zeros_like(u))
    balance, rise, forcing = _Balance(forces, external, fixed), _Rise(), LINEAR_REDUCTION
    at_rest = float(largest(forces.model.comm, np.array([np.abs(u).max(initial=0.0)]))[0]) == 0.0
    while True:
        with rise.guarded(u):
            balance.look(u, at_rest)
        norm, relative = balance.norm, balance.relative
        watch(Progress(state.iteration, relative, 0.0, (sequence, balance.residual)))
        if relative <= tolerance and not at_rest:
            energy_error = sequence.relative_energy_error(balance.energy)
            return Convergence(forces.evaluations - start, relative, energy_error)
        if at_rest and norm == 0.0:
            return Convergence(forces.evaluations - start, 0.0, 0.0)
        newton = finite and relative > NEWTON_FLOOR
        if newton:
            rise.follow(u, sequence.x, balance)
        elif norm > STAGNATION * balance.before:
            if balance.sharpen():
                continue
            raise NotConverged(_describe_stagnation(relative, tolerance, sequence))
        if finite:
            forcing = _next_forcing(sequence, norm)
            tangent.linearise(u, 0.0 if at_rest else forces.bounds.bond)
        goal = max(SAFETY * tolerance * balance.reference, forcing * norm)
        left = max_evaluations - (forces.evaluations - start)
        observe = _observer(watch, state, balance.reference)
        with _counted_by(forces, tangent), rise.guarded(u):
            sequence.run(balance.residual, norm, goal, left, ROUND_OFF * balance.reference, observe)
        u += sequence.x
        if not finite:
            forces.bounds.expect(sequence.reach(), at_rest)
        at_rest = False


def _describe_stagnation(relative: float, tolerance: float, sequence: Sequence) -> str:
    """A sentence about a residual that solves lower no further. Collective."""
    return (
        f"conjugate gradients stagnate at a relative residual of {relative:.3g}, above solver.tolerance = "
        f"{tolerance:.3g}: {sequence.obstacle() or 'round-off. Allow a larger tolerance.'}"
    )


def _tangent_of(forces: Forces) -> Forces:
    """Forces that the sequences work on: linear ones on the same table, or the tangent of finite ones."""
    if forces.model.finite:
        return Forces(forces.model, tangent=True, seconds=forces.seconds, swept=forces.swept)
    return forces.with_own_bounds()


@contextmanager
def _counted_by(forces: Forces, tangent: Forces) -> Iterator[None]:
    """Count the evaluations of the tangent inside as the forces' own."""
    try:
        yield
    finally:
        forces.evaluations += tangent.evaluations
        tangent.evaluations = 0


def _next_forcing(sequence: Sequence, norm: float) -> float:
    """Reduction at which the next Newton step ends, from the last one's disagreement of true and recursive residual."""
    if not sequence.first_norm:
        return FIRST_FORCING
    forcing = abs(norm - sequence.norm) * norm / sequence.first_norm**2
    return min(max(forcing, LEAST_FORCING), MOST_FORCING)


class _Balance:
    """True residuals under constant loads, and what they are relative to.

    Attributes
    ----------
    residual : float64, shape (n_unknowns,), dimension force
        At the last displacements looked at; 0 on fixed unknowns.
    norm, before : float, dimension force
        Of the residual, and of the one looked at before.
    reference, relative : float
        What the norm is compared with, and their ratio.
    energy : float, dimension force length
        ``u . internal``.
    """

    def __init__(self, forces: Forces, external: np.ndarray, fixed: np.ndarray):
        self.forces, self.external, self.fixed = forces, external, fixed
        self._is_sharp = False
        self.residual = np.empty_like(external)
        self.norm, self._largest = math.inf, 0.0

    def look(self, u: np.ndarray, at_rest: bool) -> None:
        """Evaluate the residual at ``u``; a body at rest has no internal forces, and nothing is evaluated. Collective.

        Raises
        ------
        NotFinite
            On all ranks alike.
        """
        residual, external = self.residual, self.external
        if at_rest:
            residual[:] = external
        else:
            self.forces.evaluate_surely(u, external, residual)
        internal, reaction = external - residual, residual[self.fixed]
        residual[self.fixed] = 0.0
        pairs = (residual, residual), (external, external), (reaction, reaction), (u, internal)
        square, load, held, self.energy = exact_dots(self.forces.model.comm, pairs)
        if not math.isfinite(square):
            raise NotFinite(describe_not_finite(self.forces.model, u, residual))
        self._largest = max(self._largest, load, held)
        self.reference = math.sqrt(max(load, held, FORCELESS**2 * self._largest)) or 1.0
        self.before, self.norm = self.norm, math.sqrt(square)
        self.relative = self.norm / self.reference

    def sharpen(self) -> bool:
        """Lower the bounds to what was met, once; whether residuals have more digits from then on. Collective.

        Bounds only grow from solve to solve, and go from far above what is met to that at 256 times as much. Where a
        body is turned and comes to rest without force, those digits are all of the residual.
        """
        bounds = self.forces.bounds
        before = bounds.bond, bounds.element
        if not self._is_sharp:
            bounds.lower(largest(self.forces.model.comm, self.forces.met))
        self._is_sharp, self.norm = True, math.inf
        return before != (bounds.bond, bounds.element)


class _Rise:
    """Steps in a row that left the residual above what it was before them, and the displacements then."""

    def __init__(self) -> None:
        self.count, self.norm, self.u = 0, math.inf, np.empty(0)

    def follow(self, u: np.ndarray, step: np.ndarray, balance: _Balance) -> None:
        """Look at the residual after a step.

        Raises
        ------
        Breakdown
            It stayed above for too long; ``u`` is what it was before.
        """
        if not balance.norm > (self.norm if self.count else balance.before):
            self.count = 0
            return
        if not self.count:
            self.norm, self.u = balance.before, u - step
        self.count += 1
        if self.count > MOST_RISES:
            u[:] = self.u
            raise Breakdown(
                f"Newton steps raised the relative residual from {self.norm / balance.reference:.3g} to "
                f"{balance.relative:.3g}: the load is too large for one step, or the body is unstable."
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
    with nullcontext() if own is forces else _counted_by(forces, own):
        sequence.run(residual, math.sqrt(square), goal, sweeps, math.inf, lambda norm: None, stop=True)
    first, last = exact_dots(forces.model.comm, [(step, before), (step, residual)])
    return float(first), float(last)


def _observer(watch: Callable[[Progress], None], state: State, reference: float) -> Callable[[float], None]:
    """What counts the iterations of a sequence, and reports each."""

    def observe(norm: float) -> None:
        state.iteration += 1
        watch(Progress(state.iteration, norm / reference, 0.0))

    return observe
