"""Adaptive dynamic relaxation with Underwood's global damping coefficient: sec. 3.3, eqs (31)-(35)."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from pdfem_mpi.forces import Forces, NotFinite
from pdfem_mpi.kernels.exact_sums import SIZE, value
from pdfem_mpi.kernels.relaxation import add_damping_sums, advance
from pdfem_mpi.loading import exact_dots
from pdfem_mpi.parallel.comm import sum_integers
from pdfem_mpi.solvers.convergence import Convergence, NotConverged, Progress
from pdfem_mpi.state import State

#: A damping coefficient of 2 or more would reverse velocities (eq. 33): it is set to this instead.
LARGEST_DAMPING = 1.9
#: A residual this many times the reference is beyond recovery.
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


def solve(
    forces: Forces,
    state: State,
    external: np.ndarray,
    fixed: np.ndarray,
    tolerance: float,
    max_evaluations: int,
    watch: Callable[[Progress], None] = lambda progress: None,
) -> Convergence:
    """Relax the state to equilibrium under constant loads. Collective.

    Parameters
    ----------
    forces : Forces
    state : State
        Displacements of the fixed unknowns are set already; all fields are overwritten.
    external : float64, shape (n_unknowns,), dimension force
    fixed : bool, shape (n_unknowns,)
    tolerance : float
        Of the relative residual.
    max_evaluations : int
    watch : callable
        Told of every iteration, on every rank.

    Raises
    ------
    NotConverged, NotFinite
        On all ranks alike.
    """
    u, v, previous_force = (state.fields[name] for name in ("u", "v", "previous_force"))
    inverse_mass = np.where(
        fixed | (forces.model.mass == 0.0), 0.0, 1.0 / np.maximum(forces.model.mass, 1e-300)
    )
    force = np.empty_like(u)
    (load,) = exact_dots(forces.model.comm, [(external, external)])
    before = forces.evaluations
    while True:
        forces.evaluate(u, external, force)
        sums = np.zeros((N_SUMS, SIZE), np.int64)
        add_damping_sums(u, v, force, previous_force, inverse_mass, sums)
        joined = sum_integers(forces.model.comm, np.concatenate([sums.reshape(-1), forces.flags()]))
        used = forces.evaluations - before
        if not forces.check_bounds(joined[-3:]):
            continue
        work, square, residual, reaction = (value(row) for row in joined[:-3].reshape(N_SUMS, SIZE))
        if math.isnan(square) or math.isnan(residual) or math.isnan(load):
            raise NotFinite(forces.describe_not_finite(u, force))
        reference = math.sqrt(max(load, reaction))
        relative = math.sqrt(residual) / reference if reference > 0.0 else math.sqrt(residual)
        damping = damping_coefficient(work, square)
        watch(Progress(state.iteration, relative, damping))
        if relative <= tolerance:
            return Convergence(used, relative)
        if relative > DIVERGED:
            raise NotConverged(
                f"relaxation diverged: the relative residual is {relative:.3g} after {used} evaluations. Eq. (11) "
                'does not bound every body (rods one cell thick, for one): solver.kind = "cg" does not need it.'
            )
        if used >= max_evaluations:
            raise NotConverged(
                f"solver.max_evaluations = {max_evaluations} were used up at a relative residual of {relative:.3g}, "
                f"above solver.tolerance = {tolerance:.3g}. Allow more evaluations or a larger tolerance."
            )
        advance(u, v, force, previous_force, inverse_mass, damping, state.iteration == 0)
        state.iteration += 1
