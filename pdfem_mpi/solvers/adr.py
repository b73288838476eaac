"""Adaptive dynamic relaxation with Underwood's global damping coefficient: sec. 3.3, eqs (31)-(35)."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from pdfem_mpi.kernels.exact_sums import SIZE, value
from pdfem_mpi.kernels.relaxation import add_damping_sums, advance
from pdfem_mpi.model.forces import Forces
from pdfem_mpi.model.mechanisms import describe_motion
from pdfem_mpi.model.model import Model
from pdfem_mpi.model.not_finite import NotFinite, describe_not_finite
from pdfem_mpi.model.state import State
from pdfem_mpi.parallel.comm import sum_integers
from pdfem_mpi.parallel.stop_requests import NO_STOP_REQUESTS, NoStopRequests, StopRequests
from pdfem_mpi.parallel.sums import exact_dots
from pdfem_mpi.peridynamics.failure import Failure
from pdfem_mpi.solvers.convergence import Convergence, NotConverged, Progress

#: A damping coefficient of 2 or more would reverse velocities (eq. 33): it is set to this instead.
LARGEST_DAMPING = 1.9
#: A residual this many times the reference, or the load (reactions grow as residuals do), is beyond recovery.
DIVERGED = 1e8

N_SUMS = 4


def damping_coefficient(work: float, square: float) -> float:
    """``c_n = 2 sqrt(U^T K U / U^T U)`` (eq. 31), 0 where that is undefined, below 2 for stability.

    Parameters
    ----------
    work, square : float
        ``U^T K U`` with the local stiffness (32), and ``U^T U``.
    """
    if not work > 0.0 or not square > 0.0:
        return 0.0
    damping = 2.0 * math.sqrt(work / square)
    return damping if damping < 2.0 else LARGEST_DAMPING


def describe_divergence(model: Model, found: str) -> str:
    """What to say of a relaxation that diverged: what was found, why that can be, and a remedy."""
    if model.finite:
        cause = (
            "The masses bound the stiffness of the body at rest; with much stretch between them bonds get stiffer. "
            'Raise the load in smaller steps (stepping), or use solver.kind = "cg".'
        )
    else:
        cause = (
            "The masses bound the stiffness of any body, so that only bond factors of negative sign make it grow: use "
            'peridynamics.signs = "bounded", or solver.kind = "cg".'
        )
    return f"relaxation diverged: {found}. {cause}"


@dataclass(frozen=True)
class Sums:
    """What one evaluation found.

    Attributes
    ----------
    relative, residual : float
        Norm of the residual force on the free unknowns, relative to ``reference`` and absolute.
    reference : float, dimension force
        Norm of the external force or, where larger, of the reactions.
    damping : float
        Coefficient of eq. (31).
    """

    relative: float
    residual: float
    reference: float
    damping: float


class Relaxation:
    """Iterations of relaxation on a state; all methods are collective.

    Parameters
    ----------
    forces : Forces
    fixed : bool, shape (n_unknowns,)
    stop_requests : StopRequests
        Its votes travel with the sums of an evaluation.

    Attributes
    ----------
    force : float64, shape (n_unknowns,)
        Residual force of the last evaluation.
    first : float, dimension force
        Norm of the first residual force that was not 0.
    grown : float, dimension 1
        That of the last one, relative to the first.
    """

    def __init__(
        self, forces: Forces, fixed: np.ndarray, stop_requests: StopRequests | NoStopRequests = NO_STOP_REQUESTS
    ):
        mass = forces.model.mass
        self.forces, self.stop_requests, self.votes = forces, stop_requests, (0, 0)
        self.inverse_mass = np.where(fixed | (mass == 0.0), 0.0, 1.0 / np.maximum(mass, 1e-300))
        self.force = np.empty_like(mass)
        self.first = self.grown = 0.0
        self.root_share = np.sqrt(forces.model.own_part) if len(forces.model.rollers) else None

    def evaluate(self, state: State, external: np.ndarray, load: float, failure: Failure | None = None) -> Sums:
        """Evaluate the forces, bonds breaking if a ``failure`` is given; ``load`` is the norm of ``external``.

        Raises
        ------
        NotFinite
            On all ranks alike: what the relaxation began with.
        NotConverged
            On all ranks alike: what it made of it.
        """
        try:
            sums = self._evaluate(state, external, load, failure)
        except NotFinite as error:
            if not self.grown > DIVERGED:  # NaN in the state or in the loads
                raise
            text = f"after {state.iteration} iterations {str(error).rstrip('.')}"
            raise NotConverged(describe_divergence(self.forces.model, text)) from error
        self.first = self.first or sums.residual
        self.grown = sums.residual / self.first if self.first else 0.0
        return sums

    def _evaluate(self, state: State, external: np.ndarray, load: float, failure: Failure | None) -> Sums:
        forces = self.forces
        u, v, previous_force = state.u, state.v, state.previous_force
        while True:
            forces.evaluate(u, external, self.force, failure)
            digits = np.zeros((N_SUMS, SIZE), np.int64)
            shared = u if self.root_share is None else self.root_share * u  # sums over the whole body
            add_damping_sums(shared, v, self.force, previous_force, self.inverse_mass, digits)
            votes = forces.flags() + self.stop_requests.votes()
            joined = sum_integers(forces.model.comm, np.concatenate([digits.reshape(-1), votes]))
            if forces.check_bounds(joined[-5:-2]):
                break
        self.votes = joined[-2:]
        work, square, residual, reaction = (value(row) for row in joined[:-5].reshape(N_SUMS, SIZE))
        if math.isnan(square) or math.isnan(residual) or math.isnan(load):
            raise NotFinite(describe_not_finite(forces.model, u, self.force))
        residual, reference = math.sqrt(residual), max(load, math.sqrt(reaction))
        relative = residual / reference if reference > 0.0 else residual
        return Sums(relative, residual, reference, damping_coefficient(work, square))

    def advance(self, state: State, damping: float) -> None:
        """Take one step; the state is whole after it."""
        u, v, previous_force = state.u, state.v, state.previous_force
        advance(u, v, self.force, previous_force, self.inverse_mass, damping, state.iteration == 0)
        state.iteration += 1

    def pause(self, state: State) -> None:
        """Keep a checkpoint or stop, if the ranks wished it at the last evaluation.

        Raises
        ------
        Stopped
            On all ranks.
        """
        self.stop_requests.act(self.votes, state)


def solve(
    forces: Forces,
    state: State,
    external: np.ndarray,
    fixed: np.ndarray,
    tolerance: float,
    max_evaluations: int,
    watch: Callable[[Progress], None] = lambda progress: None,
    stop_requests: StopRequests | NoStopRequests = NO_STOP_REQUESTS,
) -> Convergence:
    """Relax the state to equilibrium under constant loads. Collective.

    A relaxation that was stopped goes on from its state as if it had not been: the same bits follow.

    Parameters
    ----------
    forces : Forces
    state : State
        Displacements of the fixed unknowns are set already; all fields are overwritten. A new relaxation begins with
        ``iteration`` and ``spent`` 0.
    external : float64, shape (n_unknowns,), dimension force
    fixed : bool, shape (n_unknowns,)
    tolerance : float
        Of the relative residual.
    max_evaluations : int
    watch : callable
        Told of every iteration, on every rank.
    stop_requests : StopRequests
        Asked after every step.

    Raises
    ------
    NotConverged, NotFinite, Stopped
        On all ranks alike.
    """
    relaxation = Relaxation(forces, fixed, stop_requests)
    (square,) = exact_dots(forces.model.comm, [(external, external)])
    load = math.sqrt(square)
    before = forces.evaluations - state.spent
    while True:
        sums = relaxation.evaluate(state, external, load)
        used = state.spent = forces.evaluations - before
        watch(Progress(state.iteration, sums.relative, sums.damping, (relaxation,)))
        if sums.relative <= tolerance:
            return Convergence(used, sums.relative)
        if sums.relative > DIVERGED or sums.residual > DIVERGED * load > 0.0:
            times = max(sums.residual / (load or math.inf), sums.relative)
            text = f"after {used} evaluations the residual is {times:.3g} times the load"
            text += f". Still moving: {describe_motion(forces.model, state.v)}"
            raise NotConverged(describe_divergence(forces.model, text))
        if used >= max_evaluations:
            raise NotConverged(
                f"solver.max_evaluations = {max_evaluations} were used up at a relative residual of "
                f"{sums.relative:.3g}, above solver.tolerance = {tolerance:.3g}. Allow more evaluations or a larger "
                f"tolerance. Still moving: {describe_motion(forces.model, state.v)}."
            )
        relaxation.advance(state, sums.damping)
        relaxation.pause(state)
