"""One run, from scene to run folder: the one place that sees every stage."""

from __future__ import annotations

from collections.abc import Iterable
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.deck.table import SceneError
from pdfem_mpi.measure.geometry import Geometry
from pdfem_mpi.parallel.comm import NotWritten, broadcast, on_root, sum_integers
from pdfem_mpi.parallel.stop_requests import Stopped, StopRequests
from pdfem_mpi.parallel.watchdog import NoWatchdog, Watchdog, patience
from pdfem_mpi.results.cursor import unchecked
from pdfem_mpi.results.log import RunLog
from pdfem_mpi.runs.checkpoints import CheckpointWriter
from pdfem_mpi.runs.claimed_folder import ClaimedFolder
from pdfem_mpi.runs.compilation import not_compiled
from pdfem_mpi.runs.finishing import finish
from pdfem_mpi.runs.identity import identity
from pdfem_mpi.runs.libraries import load_libraries
from pdfem_mpi.runs.march import March
from pdfem_mpi.runs.memory_report import features_of
from pdfem_mpi.runs.notes import describe_body, describe_bonds, describe_nothing, examine, headline
from pdfem_mpi.runs.output import Place
from pdfem_mpi.runs.outputs import Outputs, geometry_of, make_outputs
from pdfem_mpi.runs.prepare import count_sizes, fit_folders, prepare, warm_up
from pdfem_mpi.runs.read_columns import all_columns
from pdfem_mpi.runs.reporter import LoggedReporter, NullReporter, Reporter
from pdfem_mpi.runs.restart_point import Refused, RestartPoint, RunOptions, compare
from pdfem_mpi.runs.restoring import read_turned, restore, restore_late
from pdfem_mpi.runs.simulation import Simulation
from pdfem_mpi.runs.stopwatch import phase
from pdfem_mpi.runs.summary import sha256
from pdfem_mpi.system.exit_codes import EXIT_FINISHED, EXIT_NOT_WRITTEN, EXIT_STOPPED
from pdfem_mpi.system.garbage import no_search_for_garbage
from pdfem_mpi.system.heap import APART_BESIDE_BONDS, large_arrays_apart
from pdfem_mpi.system.process_memory import MemoryWatch


def run(
    scene: Scene,
    comm,
    out: Path,
    deck_text: str,
    overwrite: bool,
    reporter: Reporter,
    options: RunOptions | None = None,
) -> int:
    """Solve the scene and write the run folder, from the beginning or from a checkpoint. Collective.

    Returns
    -------
    int
        Exit code: 0 finished, 73 results cannot be written, 74 not converged, 75 stopped with a checkpoint.

    Raises
    ------
    SceneError, Refused
        On all ranks.
    """
    if comm.rank > 0:
        reporter = NullReporter()
    try:
        return Run(scene, comm, out, deck_text, overwrite, reporter, options or RunOptions()).go()
    except NotWritten as error:
        reporter.line(f"pdfem: {error} Free space or choose another folder with --out.")
        return EXIT_NOT_WRITTEN


class Run:
    """One start of a run: it takes the folder, makes the simulation and follows the load program."""

    def __init__(self, scene, comm, out, deck_text, overwrite, reporter, options):
        self.scene, self.comm, self.out, self.deck_text = scene, comm, out, deck_text
        self.overwrite, self.reporter, self.options = overwrite, reporter, options
        self.seconds: dict[str, float] = {}
        self.claimed: ClaimedFolder | None = None  # on rank 0 alone
        self.outputs: Outputs | None = None  # on rank 0 alone
        self.started = perf_counter()

    def go(self) -> int:
        """Take the folder, run, and let the folder go. Collective."""
        try:
            start, refusal = broadcast(self.comm, on_root(self.comm, self._enter))
            if refusal:
                raise Refused(*refusal)
            hang = self.out / f"run.r{self.comm.rank}.hang"
            with Watchdog(self.comm, hang, patience()) if self.options.watched else NoWatchdog():
                return self._go(start)
        except (SceneError, Refused):
            if self.claimed:
                self.claimed.withdraw()
            raise
        except Stopped as stop:
            if self.claimed:
                self.claimed.end(EXIT_STOPPED)
            self.reporter.line(f"pdfem: stopped: {stop}. The same command starts again.")
            return EXIT_STOPPED
        finally:
            if self.claimed:
                self.claimed.release()

    def _enter(self) -> tuple[RestartPoint | None, tuple[int, str] | None]:
        """Take the folder, and decide where to start."""
        try:
            self.claimed = ClaimedFolder(
                self.out, self.deck_text, self.overwrite, self.options, self.comm.size, self.started
            )
        except Refused as error:
            return None, (error.code, str(error))
        self.claimed.start.notes += unchecked(self.claimed.start.results)
        return self.claimed.start, None

    def _stop_if_asked(self) -> None:
        """End a start that was asked to stop before its load program began. Collective.

        Raises
        ------
        Stopped
            On all ranks.
        """
        if sum_integers(self.comm, np.array([self.options.requests.stop_in_set_up()]))[0]:
            raise Stopped("asked to stop before the first step: nothing was done", kept=True)

    def _go(self, start: RestartPoint) -> int:
        with phase(self.seconds, "compile"):
            load_kernels(self.scene, self.comm, self.reporter)
        self._stop_if_asked()
        memory = MemoryWatch()
        if not (prepared := self._prepare(start)):
            return EXIT_FINISHED
        memory.look()
        simulation, broken, sizes = prepared
        self._stop_if_asked()
        on_root(self.comm, self._open_folder)
        self._lines(describe_body(simulation))
        checkpoints, stop_requests = self._make_checkpoints(simulation, start)
        with phase(self.seconds, "setup"), large_arrays_apart(APART_BESIDE_BONDS):
            simulation.prepare_solver(self.reporter.line, stop_requests)
            if start.path:
                restore_late(start, broken, simulation.state, simulation.failure, simulation.solver)
        memory.look()
        self._lines(headline(simulation, sizes, self.seconds["setup"]))
        with phase(self.seconds, "setup"):
            findings = examine(simulation, start.path is not None)
        self._lines([*findings.notes, *(f"note: {note}" for note in start.notes)])
        if start.path:
            stop_requests.resumed(state := simulation.state)
            self.reporter.line(f"going on from {start.path.name}: step {state.step}, iteration {state.iteration}")
        else:
            simulation.state.began = perf_counter()
        self._lines(describe_bonds(simulation, findings))
        on_root(self.comm, partial(self._open_outputs, simulation, geometry_of(simulation), start))
        self.options.requests.setting_up = False
        start_up = perf_counter() - self.started
        march = March(simulation, self.outputs, self.reporter, checkpoints, stop_requests, start.changed)
        simulation.observers += [checkpoints, march]
        ended = march.follow()
        if ended.did_nothing and self.claimed:
            ended.reason += describe_nothing(start_up, self.claimed.starts.idle)
        return finish(self, march, start, findings, sizes, memory)

    def _prepare(self, start: RestartPoint) -> tuple[Simulation, np.ndarray | None, dict[str, int]] | None:
        """The simulation in the state of the start, its broken bonds, and its sizes; None for a run that is finished
        already. Collective.
        """
        scene, comm = self.scene, self.comm
        with phase(self.seconds, "setup"), large_arrays_apart():
            prepared = prepare(scene, comm, read_turned(start, scene, comm))
            if start.path:
                start.notes += compare(start, identity(scene, prepared.share), self.options.force)
            if start.finished and not start.changed:
                self.reporter.line(f"pdfem: {self.out} is finished already; --set a longer program to go on.")
                if self.claimed:
                    self.claimed.withdraw()
                return None
            self._stop_if_asked()
            known = {"caches": fit_folders(self.out), "evaluations": start.header.get("evaluations", 0)}
            simulation = Simulation(scene, comm, prepared=prepared, **known)
            broken = None
            if start.path:
                broken = restore(start, simulation.share, simulation.model, simulation.state)
            return simulation, broken, count_sizes(simulation.share, simulation.model)

    def _open_folder(self) -> None:
        self.claimed.commit()
        self.reporter = LoggedReporter(self.reporter, RunLog(self.claimed.written.new("run.log")))

    def _make_checkpoints(self, simulation: Simulation, start: RestartPoint) -> tuple[CheckpointWriter, StopRequests]:
        """Who writes checkpoints, and who says when. Collective."""
        checkpoints = CheckpointWriter(
            self.scene, simulation.share, simulation.forces, simulation.failure, self.out, self._flush,
            self.reporter.line, start, self.started,
        )  # fmt: skip
        options = self.options
        return checkpoints, StopRequests(self.comm, options.requests, checkpoints, self.scene.checkpoint, options.end)

    def _flush(self) -> dict[str, dict[str, Any]]:
        self.claimed.starts.note(perf_counter() - self.started)
        return self.outputs.flush()

    def _open_outputs(self, simulation: Simulation, geometry: Geometry | None, start: RestartPoint) -> None:
        def note(text):
            start.notes.append(text)
            self._warn(text)

        place = Place(
            self.scene, geometry, self.claimed.written, sha256(self.deck_text), start.results,
            start.other_fields, note, self._warn,
        )  # fmt: skip
        self.outputs = make_outputs(place, all_columns(simulation))
        self.outputs.open()

    def _lines(self, lines: Iterable[str]) -> None:
        for text in lines:
            self.reporter.line(text)

    def _warn(self, text: str) -> None:
        self.reporter.line(f"warning: {text}")


def load_kernels(scene: Scene, comm, reporter: Reporter) -> None:
    """Compile or load the kernels that the scene calls, and load libraries for rank 0. Collective."""
    features = features_of(scene)
    if missing := on_root(comm, lambda: not_compiled(features)):
        reporter.line(f"compiling {missing} kernels, once on this machine (up to 30 s)")
    with no_search_for_garbage():
        warm_up(comm, features)
        load_libraries(scene, comm)
