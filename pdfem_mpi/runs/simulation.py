"""A scene made ready on this rank: body, equations, state and solver, stepped through its loads."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from pdfem_mpi.deck.loads import Load, Support
from pdfem_mpi.deck.programs import Steps
from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.deck.table import SceneError
from pdfem_mpi.model.loads import make_load_case
from pdfem_mpi.model.parts import positions
from pdfem_mpi.model.restraints import tie
from pdfem_mpi.model.state import new_state
from pdfem_mpi.parallel.comm import world
from pdfem_mpi.parallel.stop_requests import NO_STOP_REQUESTS
from pdfem_mpi.peridynamics.bonds import total_bonds
from pdfem_mpi.runs.assembly import Assembly, ignore
from pdfem_mpi.runs.following import follow
from pdfem_mpi.runs.history_rows import history_row
from pdfem_mpi.runs.memory_report import features_of
from pdfem_mpi.runs.prepare import Prepared, cut_again, prepare, warm_up
from pdfem_mpi.runs.read_columns import make_gauges
from pdfem_mpi.runs.region_watch import RegionTooSmall, RegionWatch
from pdfem_mpi.runs.switching import switch
from pdfem_mpi.solvers.convergence import Progress
from pdfem_mpi.stepping import Report
from pdfem_mpi.stepping.steps import follow_steps

Watch = Callable[[int, Progress], None]


class Simulation(Assembly):
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
        Of switches: their ``let_go(comes_back)`` is called before one, and ``take(simulation, came_back)`` after it.

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
        prepared: Prepared | None = None,
        caches: Sequence[Path] = (),
        evaluations: int = 0,
    ):
        self.scene = scene
        self.comm = world() if comm is None else comm
        if prepared is None:
            warm_up(self.comm, features_of(scene))
            prepared = prepare(scene, self.comm)
        self.caches, self.need, self.kept_cycle = caches, prepared.need, prepared.cycle
        self.known = {"evaluations": evaluations}
        self.words = ignore, NO_STOP_REQUESTS
        self.observers = []
        self.build(prepared.share)
        self.state = new_state(self.model)
        self.assemble()

    def follow(self, watch: Watch = ignore) -> Iterator[Report]:
        """Follow the scene's load program from the state on, in model units; see `steps`."""
        for report in follow(self, watch):
            self._evaluated = True
            yield report

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
        while True:
            try:
                (report,) = follow_steps(settings, solver, self.failure, self.state, self.case, watch)
                break
            except RegionTooSmall as found:
                turning = found.turning
            switch(self, turning)
            solver = self.solver
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
        self.kept_cycle = None  # its grid has the supports before
        self.gauges = make_gauges(scene, share, self.model)
        self.region_watch = RegionWatch.of(self) if share.found else None

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
        tie(self.model, self.state.u)
        self._evaluated = False
