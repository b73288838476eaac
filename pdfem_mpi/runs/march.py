"""Following a load program to its end: rows go to the outputs, a stop or a failure becomes an exit code."""

from __future__ import annotations

from dataclasses import dataclass
from time import perf_counter
from typing import Any

import numpy as np

from pdfem_mpi.measure.closing import measure_closing
from pdfem_mpi.measure.fields import Fields, digest_fields, gather_damage
from pdfem_mpi.model.not_finite import NotFinite
from pdfem_mpi.parallel.comm import on_root
from pdfem_mpi.parallel.stop_requests import Stopped, StopRequests, place_of
from pdfem_mpi.parallel.traffic import TRAFFIC, join
from pdfem_mpi.peridynamics.damage import Remaining
from pdfem_mpi.runs.checkpoints import CheckpointWriter
from pdfem_mpi.runs.energy_release import energy_releases
from pdfem_mpi.runs.history_rows import probe_row
from pdfem_mpi.runs.memory_report import Watched
from pdfem_mpi.runs.outputs import Outputs, geometry_of
from pdfem_mpi.runs.region_notes import describe_switch
from pdfem_mpi.runs.reporter import Reporter
from pdfem_mpi.runs.simulation import Simulation
from pdfem_mpi.solvers.convergence import NotConverged
from pdfem_mpi.stepping import Report
from pdfem_mpi.system.exit_codes import EXIT_FINISHED, EXIT_NOT_CONVERGED, EXIT_NOT_WRITTEN, EXIT_STOPPED


@dataclass
class Ending:
    """How a load program ended.

    Attributes
    ----------
    code : int
        Exit code.
    reason : str or None
    fields : Fields or None
        The last ones, on rank 0, where something asks for them.
    damage : float64, shape (n_points,) or, where bonds soften, (n_points, 3), or None
    digest : str or None
        Of the fields, where nothing asks for them.
    did_nothing : bool
        The time was over before the first step.
    communication : dict or None
        What the ranks sent and waited, on rank 0; None on one rank.
    """

    code: int = EXIT_FINISHED
    reason: str | None = None
    fields: Fields | None = None
    damage: np.ndarray | None = None
    digest: str | None = None
    did_nothing: bool = False
    communication: dict[str, Any] | None = None


class March:
    """One start of a load program.

    Parameters
    ----------
    simulation : Simulation
    outputs : Outputs or None
        On rank 0 alone.
    reporter : Reporter
    checkpoints : CheckpointWriter
    stop_requests : StopRequests
    changed : bool
        The deck is not that of the checkpoint: a load program that had ended may go on.
    """

    def __init__(
        self,
        simulation: Simulation,
        outputs: Outputs | None,
        reporter: Reporter,
        checkpoints: CheckpointWriter,
        stop_requests: StopRequests,
        changed: bool,
    ):
        self.simulation, self.outputs, self.reporter = simulation, outputs, reporter
        self.checkpoints, self.stop_requests, self.changed = checkpoints, stop_requests, changed
        self.wanted = bool(simulation.scene.output.fields or simulation.scene.probes)
        self.watched = Watched(simulation.forces, *simulation.parts, checkpoints)
        self.remaining, self.ended = Remaining(), Ending()
        self.energy_error: float | None = None
        self.seconds = self.seconds_of_output = 0.0
        self._warned_of_strains = False
        self.first_break: float | None = None
        comes_back = getattr(simulation.scene.stepping, "times", None) is not None
        self._looks_for_overlap = comes_back and simulation.failure is not None

    def let_go(self, comes_back: bool) -> None:
        """Hold nothing of a body that is about to be made anew; what was read off it stays, if that comes back."""
        self.watched = None
        if not comes_back:
            self.ended.fields = self.ended.damage = None

    def take(self, simulation: Simulation, came_back: bool) -> None:
        """Go on with the body as a simulation has it now. Collective."""
        self.watched = Watched(simulation.forces, *simulation.parts, self.checkpoints)
        self.remaining = Remaining()
        if came_back:
            return
        geometry = geometry_of(simulation)
        self.reporter.line(describe_switch(simulation))
        on_root(simulation.comm, lambda: self.outputs.follow(geometry))

    @property
    def arrays(self) -> tuple[Any, ...]:
        """What this holds beside the simulation's own arrays."""
        return self.ended.fields, self.ended.damage, self.remaining, self.outputs

    def follow(self) -> Ending:
        """Follow the load program to its end. Collective."""
        simulation, ended = self.simulation, self.ended
        state, began, timed = simulation.state, perf_counter(), False
        evaluations = simulation.forces.evaluations
        TRAFFIC.clear()
        over, first = state.program.pop("over", 0) and not self.changed, place_of(state)
        try:
            rows = 0
            for rows, report in enumerate(() if over else simulation.follow(self._watch), start=1):  # noqa: B007
                self._write(report)
            if not rows:  # nothing was left to do: the fields are those of the last step
                simulation.evaluate()
            if not self.wanted:
                ended.digest = digest_fields(simulation.share, simulation.forces, state.u)
            elif not rows:
                ended.fields = simulation.fields(probes=simulation.probe_reader)
            state.program["over"] = 1
            self.stop_requests.save(state)
            released = energy_releases(simulation, lambda text: self.reporter.line(f"warning: {text}"))
            if ended.fields is not None:
                ended.fields.probed.update(released)
        except (NotConverged, NotFinite) as error:
            ended.code, ended.reason = EXIT_NOT_CONVERGED, str(error)
            self.checkpoints.save_good()
        except Stopped as stop:
            ended.code, ended.reason = EXIT_STOPPED, str(stop)
            if not stop.kept:
                ended.code, ended.reason = EXIT_NOT_WRITTEN, f"{stop}, and not kept"
            timed = not stop.asked
        ended.did_nothing = ended.code == EXIT_STOPPED and timed and place_of(state) == first
        self.seconds = perf_counter() - began - self.seconds_of_output
        evaluations = simulation.forces.evaluations - evaluations
        ended.communication = join(simulation.comm, TRAFFIC.copy(), perf_counter() - began, evaluations)
        return ended

    def _watch(self, step, progress) -> None:
        self.watched.observe(progress)
        scene = self.simulation.scene
        self.reporter.progress(step, scene.stepping.n_steps, progress, scene.solver.tolerance)

    def _write(self, report: Report) -> None:
        """Give a row of the load program to the outputs. Collective."""
        simulation, ended = self.simulation, self.ended
        self.energy_error = report.convergence.energy_error
        if report.elements and report.elements.warning and not self._warned_of_strains:
            self.reporter.line(report.elements.warning)
            self._warned_of_strains = True
        if self._looks_for_overlap and simulation.failure.count:
            closing = measure_closing(simulation.share, simulation.forces, simulation.failure)
            if closing.warning:
                self.reporter.line(closing.warning)
                self._looks_for_overlap = False
        began = perf_counter()
        if self.wanted:
            ended.fields = simulation.fields(*simulation.scene.output.mechanical, probes=simulation.probe_reader)
        columns = simulation.row(report)
        columns |= probe_row(simulation.scene.probes, ended.fields.probed if ended.fields else {})
        if self.first_break is None and (report.event == "critical" or report.new_broken):
            began_here = report.broken == report.new_broken
            self.first_break = report.load_factor if began_here else 1.0  # an earlier start has told
        body = simulation.share, simulation.model
        ended.damage = gather_damage(*body, self.remaining, simulation.failure, parts=True)
        on_root(simulation.comm, lambda: self.outputs.write(columns, ended.fields, ended.damage))
        self.reporter.row(columns)
        self.seconds_of_output += perf_counter() - began
