"""The paper's load program (sec. 4.2): the load rises a little at each iteration of the relaxation."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from pdfem_mpi.deck.programs import Ramp
from pdfem_mpi.model.loads import LoadCase, without_loads_on_loose_parts
from pdfem_mpi.model.model import Model
from pdfem_mpi.model.state import State
from pdfem_mpi.parallel.sums import exact_dots
from pdfem_mpi.peridynamics.failure import Failure
from pdfem_mpi.solvers import adr
from pdfem_mpi.solvers.adr import Relaxation
from pdfem_mpi.solvers.convergence import Convergence, Progress
from pdfem_mpi.solvers.equilibrium import EquilibriumSolver
from pdfem_mpi.stepping.report import Report, Reporter


def follow_ramp(
    settings: Ramp,
    solve: EquilibriumSolver,
    failure: Failure,
    state: State,
    case: LoadCase,
    watch: Callable,
) -> Iterator[Report]:
    """Yield a row every ``report_every`` iterations, and the last one. Collective.

    Bonds break in the sweep of each iteration. The work of loads and supports is summed by the trapezoidal rule; what
    it exceeds the stored and the dissipated energy by is kinetic, or damped away. The ramp ends early where the
    reaction has fallen, or at the row that finds next to all loads on parts of the body that nothing holds any more.

    ``state.program`` keeps the work so far, the generalised force of the supports and the largest reaction.

    Raises
    ------
    NotConverged, NotFinite, Stopped
    """
    forces, program = solve.forces, state.program
    relaxation = Relaxation(forces, case.fixed, solve.stop_requests)
    load = _norm(forces.model, case.external)
    reporter = Reporter(forces, case, failure)
    last = round(settings.end_load_factor / settings.increment)
    for name in ("work", "pull", "peak"):
        program.setdefault(name, 0.0)
    _preload(solve, state, case, watch)
    ahead = case.prescribed[case.fixed]
    before = np.empty_like(state.u)
    while state.iteration < last:
        iteration = state.iteration + 1
        state.load_factor = settings.increment * iteration
        external = case.forces(state.load_factor)
        state.u[case.fixed] = state.load_factor * ahead
        norm = abs(state.load_factor) * load if case.constant is None else _norm(forces.model, external)
        sums = relaxation.evaluate(state, external, norm, failure)
        failure.close(forces.model.comm)
        failure.take()
        (pull,) = exact_dots(forces.model.comm, [(-relaxation.force[case.fixed], ahead)])
        program["work"] += 0.5 * settings.increment * (program["pull"] + float(pull))
        program["pull"] = float(pull)
        watch(1, Progress(state.iteration, sums.relative, sums.damping, (relaxation, external, before)))
        if case.load:
            before[:] = state.u
        relaxation.advance(state, sums.damping)
        if case.load:
            (work,) = exact_dots(forces.model.comm, [(external, state.u - before)])
            program["work"] += float(work)
        if iteration % settings.report_every == 0 or iteration == last:
            state.step += 1
            event = "end" if iteration == last else "ramp"
            row = reporter.report(state, event, Convergence(settings.report_every, sums.relative), program["work"])
            program["peak"] = max(program["peak"], row.reaction)
            ended = failure.count and row.reaction < settings.end_reaction * program["peak"]
            came_apart = row.new_broken and case.load and _came_apart(settings, solve, case)
            yield row
            if ended or came_apart:
                return
        relaxation.pause(state)


def _norm(model: Model, external: np.ndarray) -> float:
    """Euclidean norm of forces. Collective."""
    return float(np.sqrt(exact_dots(model.comm, [(external, external)])[0]))


def _preload(solve: EquilibriumSolver, state: State, case: LoadCase, watch: Callable) -> None:
    """Come to rest under constant loads, before anything grows; their work is the energy stored then. Collective.

    Raises
    ------
    NotConverged, NotFinite, Stopped
    """
    if case.constant is None or state.program.get("preloaded"):
        return
    forces, settings, external = solve.forces, solve.settings, case.forces(0.0)
    common = forces, state, external, case.fixed, settings.tolerance, settings.max_evaluations
    adr.solve(*common, lambda progress: watch(1, progress), solve.stop_requests)
    forces.evaluate_surely(state.u, external, np.empty_like(external))
    state.program["work"] = forces.stored_energy(state.u)
    state.program["preloaded"] = 1.0
    state.iteration = state.spent = 0
    state.v[:] = 0.0


def _came_apart(settings: Ramp, solve: EquilibriumSolver, case: LoadCase) -> bool:
    """Whether next to all loads are on parts of the body that nothing holds any more. Collective."""
    rest, torn = without_loads_on_loose_parts(solve.forces.model, case)
    if not torn or rest.load >= settings.end_reaction * case.load:
        return False
    solve.note(f"the body came apart under its loads, and the ramp ends: {torn[0].text} is loose")
    return True
