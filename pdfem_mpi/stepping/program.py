"""Which load program a scene follows."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from pdfem_mpi.deck.scene import Events, Ramp, Scene
from pdfem_mpi.model.loads import LoadCase
from pdfem_mpi.model.state import State
from pdfem_mpi.peridynamics.failure import Failure
from pdfem_mpi.solvers.convergence import Progress
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
        Changed; whole at each yield, and whenever ``solve.pauses`` are asked: between steps, batches of an avalanche
        and iterations of relaxation.
    case : LoadCase
    watch : callable
        Told of the step and the progress of every iteration, on every rank.

    Raises
    ------
    NotConverged, NotFinite, Stopped
    """
    stepping = scene.stepping
    if isinstance(stepping, Ramp):
        return follow_ramp(stepping, solve, failure, state, case, watch)
    if isinstance(stepping, Events):
        return follow_events(stepping, solve, failure, state, case, watch)
    return follow_steps(stepping, solve, failure, state, case, watch)
