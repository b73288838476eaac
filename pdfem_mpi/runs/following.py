"""Following a load program on a body that is made anew on the way: with more bonds, or the same again."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

from pdfem_mpi.runs.region_watch import RegionTooSmall
from pdfem_mpi.runs.switching import switch
from pdfem_mpi.runs.widening import estimate_error, goes_first
from pdfem_mpi.solvers.convergence import Progress
from pdfem_mpi.stepping import Report, follow_load_program

if TYPE_CHECKING:
    from pdfem_mpi.runs.simulation import Simulation


def follow(simulation: Simulation, watch: Callable[[int, Progress], None]) -> Iterator[Report]:
    """Follow the load program of a simulation from its state on, and yield its rows. Collective.

    Before the body is made anew the program is left, which holds parts of it; it begins again from the state, as after
    a restart. The error of a row is estimated once whoever takes the rows has read what they want of it.
    """
    while True:
        solver, state = simulation.solver or simulation.prepare_solver(), simulation.state
        program = follow_load_program(simulation.scene, solver, simulation.failure, state, simulation.case, watch)
        del solver
        turning = None
        try:
            for report in program:
                yield report
                if simulation.region_watch and simulation.region_watch.asks_for_error(report):
                    if goes_first(simulation):
                        break
                    simulation.region_watch.hear_error(report, estimate_error(simulation, report.reaction))
            else:
                return
        except RegionTooSmall as found:
            turning = found.turning
        program.close()
        del program
        if turning is not None:
            switch(simulation, turning)
        else:
            error = estimate_error(simulation, report.reaction)
            simulation.region_watch.hear_error(report, error)
