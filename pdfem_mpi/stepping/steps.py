"""Equilibrium at given load factors; bonds beyond their critical stretch break at each until none is."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial

import numpy as np

from pdfem_mpi.deck.programs import Steps
from pdfem_mpi.model.balance import without_equilibrium
from pdfem_mpi.model.loads import LoadCase, remove_rigid_motion
from pdfem_mpi.model.model import Model
from pdfem_mpi.model.parts import find_parts, find_unsupported
from pdfem_mpi.model.state import State
from pdfem_mpi.peridynamics.failure import Failure
from pdfem_mpi.peridynamics.weighted_failure import WeightedFailure
from pdfem_mpi.solvers.convergence import NotConverged
from pdfem_mpi.solvers.equilibrium import EquilibriumSolver
from pdfem_mpi.stepping.report import Report, Reporter


def follow_steps(
    settings: Steps, solve: EquilibriumSolver, failure: Failure | None, state: State, case: LoadCase, watch: Callable
) -> Iterator[Report]:
    """Yield the equilibrium at each load factor from where the state is. Collective.

    ``state.program`` keeps the evaluations of the step under way.

    Raises
    ------
    NotConverged, NotFinite
        From the solver.
    Stopped
        From ``solve.stop_requests``.
    """
    forces, program, stop_requests = solve.forces, state.program, solve.stop_requests
    reporter = Reporter(forces, case, failure)
    for step, (time, factor) in enumerate(settings.schedule[state.step :], start=state.step + 1):
        stop_requests.between(state)
        if time is not None and not (program.get("evaluations") or program.get("relaxing")):
            _go_along(state, factor)
        external, skipped = case.forces(factor), getattr(failure, "skipped", 0)
        case.displace(state.u, factor)
        while True:
            try:
                convergence = solve(state, external, partial(watch, step))
            except NotConverged as error:
                raise _in_pieces(forces.model, case, failure, factor, str(error)) from error
            program["evaluations"] = program.get("evaluations", 0) + convergence.evaluations
            solve.look_at_region(state)
            if failure is None or not break_bonds(solve, failure, state, external):
                break
            if case.load and without_equilibrium(forces.model, case.fixed, external)[1]:
                raise _in_pieces(forces.model, case, failure, factor, "")
            stop_requests.between(state)
        if count := getattr(failure, "skipped", 0) - skipped:
            solve.note(
                f"at load factor {factor:.6g}, {count:,} bonds passed several teeth of their softening at once. Use "
                'smaller steps, or follow failure from tooth to tooth: stepping.kind = "events".'
            )
        remove_rigid_motion(forces.model, case, state.u)
        state.step, state.load_factor = step, factor
        if time is not None:
            program["time"] = time
        evaluations, program["evaluations"] = program["evaluations"], 0
        yield reporter.report(state, "step", replace(convergence, evaluations=evaluations))


def _go_along(state: State, factor: float) -> None:
    """Along an amplitude the displacements follow the load: nothing at rest, and back on the secant."""
    if factor == 0.0:
        state.u[:] = 0.0
    elif state.load_factor != 0.0:
        np.multiply(state.u, factor / state.load_factor, out=state.u)


def _in_pieces(model: Model, case: LoadCase, failure: Failure | None, factor: float, reason: str) -> NotConverged:
    """The end of a step, with what broke and came loose before it. Collective."""
    if failure is None or not failure.count:
        return NotConverged(reason)
    parts = find_parts(model)
    unsupported = find_unsupported(model, parts, case.fixed) if parts.count > 1 else ()
    if unsupported:
        more = f", and {len(unsupported) - 1:,} parts more" if len(unsupported) > 1 else ""
        reason = f"parts of the body came loose, {unsupported[0].text}{more}."
    return NotConverged(
        f"at load factor {factor:.6g}, after {failure.count:,} broken bonds, no equilibrium was found: {reason} Use "
        'smaller steps, or follow failure from break to break: stepping.kind = "events" with solver.kind = "cg".'
    )


def break_bonds(
    solve: EquilibriumSolver,
    failure: Failure,
    state: State,
    external: np.ndarray,
    margin: float = 0.0,
    residual: np.ndarray | None = None,
) -> int:
    """Break all bonds beyond ``(1 - margin) s_0`` at the state's displacements; how many. Collective.

    ``residual``, shape (n_unknowns,), becomes the residual force of the others.
    """
    forces = solve.forces
    residual = np.empty_like(state.u) if residual is None else residual
    by_weights = isinstance(failure, WeightedFailure)  # the sweep does not know them
    forces.evaluate_surely(state.u, external, residual, None if by_weights else failure, margin)
    if by_weights:
        failure.break_at(forces.model.comm, forces.model.points, forces.model.bonds, forces.of_bonds.S, margin)
    count = failure.close(forces.model.comm)
    broken = failure.take()
    if count:
        solve.update_after_breaks(broken)
    if count and by_weights:
        forces.evaluate_surely(state.u, external, residual)
    return count
