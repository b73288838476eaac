"""Which load program a scene follows."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from pdfem_mpi.deck.programs import Events, Ramp
from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.measure.strains import measure_elements
from pdfem_mpi.model.loads import LoadCase
from pdfem_mpi.model.not_finite import NotFinite
from pdfem_mpi.model.state import State
from pdfem_mpi.peridynamics.failure import Failure
from pdfem_mpi.solvers.convergence import NotConverged, Progress
from pdfem_mpi.solvers.equilibrium import EquilibriumSolver
from pdfem_mpi.stepping.events import follow_events
from pdfem_mpi.stepping.ramp import follow_ramp
from pdfem_mpi.stepping.report import Report
from pdfem_mpi.stepping.steps import follow_steps


def follow_load_program(
    scene: Scene,
    solve: EquilibriumSolver,
    failure: Failure | None,
    state: State,
    case: LoadCase,
    watch: Callable[[int, Progress], None] = lambda step, progress: None,
) -> Iterator[Report]:
    """Follow the scene's load program from the state on, and yield its rows. Collective.

    Parameters
    ----------
    scene : Scene
    solve : EquilibriumSolver
    failure : Failure or None
        Needed by ramps and events.
    state : State
        Changed; whole at each yield, and whenever ``solve.stop_requests`` are asked: between steps, batches of an
        avalanche and iterations of relaxation.
    case : LoadCase
    watch : callable
        Told of the step and the progress of every iteration, on every rank.

    Raises
    ------
    NotConverged, NotFinite, Stopped
    """
    stepping = scene.stepping
    follow = follow_steps
    if isinstance(stepping, Ramp):
        follow = follow_ramp
    elif isinstance(stepping, Events):
        follow = follow_events
    try:
        yield from follow(stepping, solve, failure, state, case, watch)
    except (NotConverged, NotFinite) as error:
        elements = measure_elements(solve.forces.model, state.u)
        if elements is None or not elements.refusal or elements.refusal in str(error):
            raise
        raise type(error)(f"{error} By then {elements.refusal}") from error
