"""A scene made ready on this rank: body, equations, state and solver, stepped through its loads."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from pdfem_mpi.body.share import Share
from pdfem_mpi.deck.loads import Load, Support
from pdfem_mpi.deck.programs import Steps
from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.deck.table import SceneError
from pdfem_mpi.measure.probed import ProbeReader
from pdfem_mpi.model.breaking import make_failure
from pdfem_mpi.model.forces import Forces
from pdfem_mpi.model.loads import make_load_case
from pdfem_mpi.model.model import build_model
from pdfem_mpi.model.parts import positions
from pdfem_mpi.model.state import new_state
from pdfem_mpi.parallel.comm import world
from pdfem_mpi.parallel.stop_requests import NO_STOP_REQUESTS
from pdfem_mpi.peridynamics.bonds import total_bonds
from pdfem_mpi.runs.history_rows import history_row
from pdfem_mpi.runs.memory_estimate import Need
from pdfem_mpi.runs.memory_report import features_of
from pdfem_mpi.runs.prepare import cut_again, prepare, warm_up
from pdfem_mpi.runs.read_columns import make_gauges
from pdfem_mpi.runs.readings import Readings
from pdfem_mpi.runs.region_watch import RegionTooSmall, RegionWatch
from pdfem_mpi.runs.switching import switch
from pdfem_mpi.solvers.convergence import Progress
from pdfem_mpi.solvers.equilibrium import EquilibriumSolver, make_solver
from pdfem_mpi.stepping import Report, follow_load_program
from pdfem_mpi.stepping.steps import follow_steps

Note = Callable[[str], None]
Watch = Callable[[int, Progress], None]


def ignore(*words: Any) -> None:
    """Do nothing with what is reported."""


class Simulation(Readings):
    """One scene on the ranks of a communicator; no file is read but the deck's mesh, and none is written.

    All methods are collective: every rank of the communicator calls them. Lengths and forces are in the deck's units.

    Parameters
    ----------
    scene : Scene
    comm : mpi4py.MPI.Intracomm, optional
        By default all ranks of the world.
    prepared, caches, evaluations
        What a run knows already: the body from `prepare`, folders of fitted factors, evaluations of earlier starts.

    Attributes
    ----------
    share, need, model, case, state, forces, failure, solver
        Its parts: the rank's share of the body and what memory it needs, this rank's equations, loads, unknowns and
        forces, the books of broken bonds (None where none can break), and the solver (None before it is needed).
    gauges : Gauges
        What is read off each state for the columns of probes and named supports.
    region_watch : RegionWatch or None
        Where the run finds by itself where bonds are needed.
    observers : list
        Of switches: their ``let_go()`` is called before one, and ``take(simulation)`` after it.

    Raises
    ------
    SceneError
        On all ranks.

    Examples
    --------
    >>> simulation = pdfem_mpi.Simulation(pdfem_mpi.read_deck("jobs/bar_exact.toml"))     # doctest: +SKIP
    >>> row = simulation.solve(load_factor=0.5)
    >>> row["reaction"], simulation.fields().u_nodes
    """

    def __init__(
        self,
        scene: Scene,
        comm: Any = None,
        *,
        prepared: tuple[Share, Need] | None = None,
        caches: Sequence[Path] = (),
        evaluations: int = 0,
    ):
        self.scene = scene
        self.comm = world() if comm is None else comm
        if prepared is None:
            warm_up(self.comm, features_of(scene))
            prepared = prepare(scene, self.comm)
        self._caches, self.need = caches, prepared[1]
        self.build(prepared[0])
        self.state = new_state(self.model)
        self._known: dict[str, Any] = {"evaluations": evaluations}
        self.observers: list[Any] = []
        self._words: tuple[Note, Any] = (ignore, NO_STOP_REQUESTS)
        self.assemble()

    def build(self, share: Share) -> None:
        """Make the equations of a share of the body. Collective."""
        self.model = build_model(self.scene, share, self.comm, self._caches)
        self.share = replace(share, boundaries=None)  # the whole body goes here
        self.case = make_load_case(self.scene, self.share, self.model)

    def assemble(self) -> None:
        """Make what works on the equations, for the state as it is. Collective."""
        scene, share, model = self.scene, self.share, self.model
        self.forces = Forces(model, self.state.bounds, **self._known)
        self.failure = make_failure(scene, share, model)
        self.gauges = make_gauges(scene, share, model)
        self.probe_reader = ProbeReader(scene, share, model)
        self.region_watch = RegionWatch.of(self) if share.found else None
        self.solver: EquilibriumSolver | None = None
        self._evaluated = False

    def let_go(self) -> None:
        """Let go of all that hangs on where bonds are, before it is made anew."""
        for observer in self.observers:
            observer.let_go()
        forces = self.forces
        self._known = {"evaluations": forces.evaluations, "swept": forces.swept, "seconds": forces.seconds}
        self.model = self.case = self.forces = self.failure = self.solver = None
        self.gauges = self.probe_reader = self.region_watch = None

    def prepare_solver(self, note: Note | None = None, stop_requests: Any = None) -> EquilibriumSolver:
        """Set up the scene's solver for the loads as they are; ``note`` is called with remarks for the user."""
        self._words = note or self._words[0], stop_requests or self._words[1]
        solver = make_solver(self.scene, self.share, self.forces, self.case, *self._words)
        if self.region_watch:
            solver = replace(solver, look_at_region=self.region_watch.look)
        self.solver = solver
        return solver

    def follow(self, watch: Watch = ignore) -> Iterator[Report]:
        """Follow the scene's load program from the state on, in model units; see `steps`."""
        while True:
            solver, turning = self.solver or self.prepare_solver(), None
            try:
                for report in follow_load_program(self.scene, solver, self.failure, self.state, self.case, watch):
                    self._evaluated = True
                    yield report
            except RegionTooSmall as found:
                turning = found.turning
            if turning is None:
                return
            del solver
            switch(self, turning)

    def steps(self, watch: Watch = ignore) -> Iterator[dict[str, Any]]:
        """Follow the scene's load program, and yield a row at each of its equilibria: the columns of history.csv.

        ``watch`` is called with the step and the progress of every iteration. Raises NotConverged or NotFinite where
        no equilibrium is found.
        """
        for report in self.follow(watch):
            yield self.row(report)

    def solve(self, load_factor: float, watch: Watch = ignore) -> dict[str, Any]:
        """Find the equilibrium at a load factor from the state as it is, and return its row; errors as `steps`.

        Bonds beyond their critical stretch break until none is, whatever ``scene.stepping`` says.
        """
        solver = self.solver or self.prepare_solver()
        # the program counts the steps taken before, whose load factors do not matter any more
        factors = (*(0.0,) * self.state.step, float(load_factor))
        settings = Steps.model_construct(kind="steps", load_factors=factors)
        (report,) = follow_steps(settings, solver, self.failure, self.state, self.case, watch)
        self._evaluated = True
        return self.row(report)

    def change_loads(self, loads: Sequence[Load] | None = None, supports: Sequence[Support] | None = None) -> None:
        """Replace the scene's loads or supports; displacements and broken bonds stay.

        Raises SceneError on all ranks, and keeps the loads before.
        """
        changed: dict[str, Any] = {}
        if loads is not None:
            changed["loads"] = tuple(loads)
        if supports is not None:
            changed["supports"] = tuple(supports)
        scene = self.scene.model_copy(update=changed)
        if problems := scene.problems():
            raise SceneError([f"{problem.key} {problem.text}" for problem in problems])
        share = cut_again(scene, self.share)
        case = make_load_case(scene, share, self.model)
        self.scene, self.share, self.case, self.solver = scene, share, case, None
        self.gauges = make_gauges(scene, share, self.model)

    def row(self, report: Report) -> dict[str, Any]:
        """A report of the load program in the deck's units, by the columns of history.csv, at the state as it is."""
        columns = history_row(report, self.share.units, self.failure is not None)
        if self.share.found:
            columns = {"switched_energy": 0.0} | columns | {"bonds": total_bonds(self.comm, self.model.bonds)}
        return columns | self.gauges.read(self.comm, self.state.u, report)

    @property
    def parts(self) -> tuple[Any, ...]:
        """What it is made of, in the order in which memory is counted."""
        return self.share, self.model, self.case, self.state, self.forces, self.failure, self.solver

    def displace(self, field: Callable[[np.ndarray], np.ndarray]) -> None:
        """Give all points and nodes, supported ones too, the displacements ``field(x)``; bonds break in no case.

        Parameters
        ----------
        field : callable
            Of reference positions, float64, shape (n, 3); returns displacements of that shape, dimension length.
        """
        units, unknowns = self.share.units, self.model.unknowns
        places = positions(self.model) * units.length + units.origin
        rows = np.asarray(field(places), float) / units.length
        self.state.u[:] = unknowns.join(np.broadcast_to(rows, places.shape))
        self._evaluated = False
