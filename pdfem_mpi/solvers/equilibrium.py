"""The scene's solver for equilibrium at a constant load."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from pdfem_mpi.body.share import Share
from pdfem_mpi.deck.programs import Solver as Settings
from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.model.forces import Forces
from pdfem_mpi.model.loads import LoadCase
from pdfem_mpi.model.model import with_stable_masses
from pdfem_mpi.model.state import State
from pdfem_mpi.parallel.stop_requests import NO_STOP_REQUESTS, NoStopRequests, StopRequests
from pdfem_mpi.peridynamics.failure import Broken
from pdfem_mpi.peridynamics.stable_masses import describe_raised
from pdfem_mpi.solvers import adr, cg
from pdfem_mpi.solvers.convergence import Breakdown, Convergence, Progress
from pdfem_mpi.solvers.preconditioner.preconditioner import Preconditioner, make_preconditioner


@dataclass(frozen=True)
class EquilibriumSolver:
    """Brings a state to equilibrium: ``solve(state, external, watch) -> Convergence``; made by `make_solver`.

    Where conjugate gradients break down, relaxation goes on from there, and ``note`` is called with a sentence.

    Attributes
    ----------
    forces : Forces
    case : LoadCase
    settings : Settings
    preconditioner : Preconditioner or None
        Of conjugate gradients.
    note : callable
    stop_requests : StopRequests
        Asked between iterations of relaxation, and by the load programs.
    look_at_region : callable
        Told of the state by the load programs, wherever bonds may be needed where there are none, and whether it is
        one that they accept. It may raise.
    """

    forces: Forces
    case: LoadCase
    settings: Settings
    preconditioner: Preconditioner | None
    note: Callable[[str], None]
    stop_requests: StopRequests | NoStopRequests = NO_STOP_REQUESTS
    look_at_region: Callable[..., None] = lambda state, accepted=True: None

    def __call__(
        self, state: State, external: np.ndarray, watch: Callable[[Progress], None] = lambda progress: None
    ) -> Convergence:
        """Find the equilibrium under constant loads; a relaxation that was stopped goes on. Collective."""
        settings, program = self.settings, state.program
        common = (self.forces, state, external, self.case.fixed, settings.tolerance, settings.max_evaluations)
        if self.preconditioner and not program.get("relaxing"):
            try:
                return cg.solve(*common, self.preconditioner, watch)
            except Breakdown as error:
                self.note(f"conjugate gradients broke down: {error} Going on with adaptive dynamic relaxation.")
        if not program.get("relaxing"):
            state.iteration = state.spent = 0
            state.v[:] = 0.0
            program["relaxing"] = 1
        if self.preconditioner:
            self.forces.model = with_stable_masses(self.forces.model)
        convergence = adr.solve(*common, watch, self.stop_requests)
        program["relaxing"] = 0
        return convergence

    def update_after_breaks(self, broken: Broken) -> None:
        """Learn which bonds broke. Collective."""
        if self.preconditioner:
            self.preconditioner.update_after_breaks(broken)


def make_solver(
    scene: Scene,
    share: Share,
    forces: Forces,
    case: LoadCase,
    note: Callable[[str], None],
    stop_requests: StopRequests | NoStopRequests = NO_STOP_REQUESTS,
) -> EquilibriumSolver:
    """The scene's solver, set up. Collective."""
    preconditioner, model = None, forces.model
    if model.raised_masses:
        note(describe_raised(model.raised_masses, 8 * share.counts.point_cells))
    if scene.solver.kind == "cg":
        preconditioner = make_preconditioner(share, model, case, forces.bounds)
    return EquilibriumSolver(forces, case, scene.solver, preconditioner, note, stop_requests)
