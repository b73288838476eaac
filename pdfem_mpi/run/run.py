"""One run, from scene to run folder: the one place that sees every stage."""

from __future__ import annotations

import functools
import hashlib
import math
import os
import platform
import sys
from collections.abc import Callable, Collection
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from time import perf_counter
from typing import Any, Protocol

import numpy as np

from pdfem_mpi import __version__
from pdfem_mpi.body.discretization import Discretization, ModelUnits, describe_cracked_overlap, discretize, make_mesh
from pdfem_mpi.deck.meshes import FileMesh
from pdfem_mpi.deck.outputs import BarProbe, DisplacementProbe, LineProbe
from pdfem_mpi.deck.programs import Steps
from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.deck.table import SceneError
from pdfem_mpi.measure.bar import Bar, bar_results, measure_bar
from pdfem_mpi.measure.displacement import displacement_at
from pdfem_mpi.measure.fields import Fields, digest_fields, fields_sha256, gather_damage, gather_fields, point_positions
from pdfem_mpi.measure.line import Line, measure_line
from pdfem_mpi.model.forces import Forces, NotFinite
from pdfem_mpi.model.loads import make_load_case
from pdfem_mpi.model.model import Model, build_model
from pdfem_mpi.model.parts import describe_loose
from pdfem_mpi.model.state import new_state
from pdfem_mpi.parallel.comm import NotWritten, agree, broadcast, largest, node_communicator, on_root, sum_integers
from pdfem_mpi.parallel.stop_requests import Pauses, Stopped, place_of
from pdfem_mpi.parallel.watchdog import Asleep, Watchdog, patience
from pdfem_mpi.peridynamics.bonds import count_by_material, total_bonds
from pdfem_mpi.peridynamics.damage import Remaining
from pdfem_mpi.peridynamics.failure import Failure, make_failure
from pdfem_mpi.peridynamics.fit.fit import EXPECTED_SWEEPS, SWEEP_RATE, BodyFit
from pdfem_mpi.results.cursor import continue_frames, continue_history, flushed, set_aside, unchecked
from pdfem_mpi.results.frame_digest import FrameDigest
from pdfem_mpi.results.labels import attempt
from pdfem_mpi.results.lines import write_line
from pdfem_mpi.results.log import RunLog
from pdfem_mpi.results.ownership import RESULTS, SUMMARY
from pdfem_mpi.results.summary import sealed, write_summary
from pdfem_mpi.run.compilation import compile_kernels, not_compiled
from pdfem_mpi.run.correction_notes import describe_correction
from pdfem_mpi.run.entering import Entry
from pdfem_mpi.run.failure_notes import criteria, describe_criterion, failure_summary
from pdfem_mpi.run.identity import identity
from pdfem_mpi.run.memory_estimate import Need, check_mesh, check_model, resident, show_bytes
from pdfem_mpi.run.memory_report import Watched, count_parts, describe_memory, features_of, left_out, table_of
from pdfem_mpi.run.restart import (
    EXIT_NOT_WRITTEN,
    Keeper,
    Refused,
    Start,
    Ways,
    compare,
    restore,
    restore_late,
    take_over,
)
from pdfem_mpi.run.restart import FOLDER as CHECKPOINTS
from pdfem_mpi.solvers.convergence import NotConverged, Progress
from pdfem_mpi.solvers.stability import smallest_eigenvalue
from pdfem_mpi.stepping import Report, follow_load_program, make_solver
from pdfem_mpi.system.heap import APART_BESIDE_BONDS, large_arrays_apart

EXIT_FINISHED, EXIT_NOT_CONVERGED, EXIT_STOPPED = 0, 74, 75
STATUS = {
    EXIT_FINISHED: "finished",
    EXIT_NOT_WRITTEN: "stopped without a checkpoint",
    EXIT_NOT_CONVERGED: "not converged",
    EXIT_STOPPED: "stopped",
}
SCHEMA_VERSION = 1
HISTORY = (
    "step", "event", "load_factor", "displacement", "reaction", "reaction_x", "reaction_y", "reaction_z", "evaluations",
    "relative_residual", "energy_error", "force_balance", "moment_balance",
)  # fmt: skip
#: Where bonds can break.
FAILURE_HISTORY = (
    "broken_bonds", "new_broken_bonds", "stored_energy", "dissipated_energy", "external_work", "released_energy",
    "ledger_error", "crack_x_min", "crack_x_max", "crack_y_min", "crack_y_max", "crack_z_min", "crack_z_max",
)  # fmt: skip


class Reporter(Protocol):
    """Where a run tells how it goes; only rank 0's is heard."""

    def line(self, text: str) -> None:
        """Print a line."""

    def progress(self, step: int, n_steps: int | None, progress: Progress, tolerance: float) -> None:
        """Hear of one iteration."""

    def row(self, columns: dict[str, Any]) -> None:
        """Hear of a row of the history."""

    def table(self, title: str, rows: list[tuple[str, str]]) -> None:
        """Print the table at the end."""


def draw_run(folder: Path, scene: Scene, warn: Callable[[str], None], film: bool = False) -> list[Path]:
    """Draw the figures of a run with failure from its result files, on this rank alone; the paths drawn.

    ``warn`` hears of figures that could not be drawn.
    """
    from pdfem_mpi.results.failure_plots import draw_failure

    return draw_failure(folder, scene.title, scene.units.length, scene.units.force, film, warn=warn)


def warm_up(comm, features: Collection[str] | None = None) -> None:
    """Compile the kernels that a scene with these features calls, or all of them: each rank of a node compiles a share,
    and finds those of the others. Collective.
    """
    node = node_communicator(comm)
    if node.size > 1:
        compile_kernels(features, node.rank, node.size)
        node.Barrier()
    compile_kernels(features)
    node.Free()


def fit_folders(out: Path) -> tuple[Path, ...]:
    """Where fits of bond factors are kept: the run folder, and the user's cache beside the compiled kernels."""
    cache = os.environ.get("NUMBA_CACHE_DIR")
    return (out, Path(cache)) if cache else (out,)


def prepare(scene: Scene, comm) -> tuple[Discretization, Need]:
    """The discretization of a scene that fits into memory, and what this rank will need. Collective.

    A mesh file is read by rank 0.

    Raises
    ------
    SceneError
        On all ranks.
    """
    mesh = None
    if isinstance(scene.mesh, FileMesh):
        messages = []
        if comm.rank == 0:
            try:
                mesh = make_mesh(scene)
            except SceneError as error:
                messages = error.messages
        if messages := agree(comm, messages):
            raise SceneError(messages)
        check_mesh(scene, broadcast(comm, len(mesh.cells) if mesh else 0), comm)
        mesh = broadcast(comm, mesh)
    else:
        check_mesh(scene, math.prod(scene.mesh.n_cells), comm)
    discretization = discretize(scene, mesh)
    return discretization, check_model(scene, discretization, comm)


def check_scene(scene: Scene, comm) -> dict[str, str]:
    """What a run of the scene would allocate, by name; nothing large is allocated. Collective.

    Raises
    ------
    SceneError
        Also when it would not fit into memory.
    """
    discretization, need = prepare(scene, comm)
    counts, quality = _counts(discretization, None), discretization.quality
    bonds, total = sum_integers(comm, np.array([int(need.bonds), int(need.bytes)]))
    return {
        **({"mirror planes": _describe_mirrors(scene)} if discretization.mirrors else {}),
        "cells": f"{len(discretization.mesh.cells)}",
        **({"of the mesh file": "; ".join(discretization.notes)} if discretization.notes else {}),
        "nodes": f"{counts['nodes']}",
        "edges of cells": f"{quality.shortest_edge:.4g} to {quality.longest_edge:.4g}",
        "smallest scaled Jacobian": f"{quality.smallest_scaled_jacobian:.4g}",
        "smallest Gauss volume": f"{quality.smallest_gauss_volume:.4g}",
        "elements": f"{counts['elements']}",
        "points": f"{counts['points']}",
        "undirected bonds, about": f"{bonds:.3g}",
        "memory, about": f"{show_bytes(total)} in all, of the largest rank "
        f"{show_bytes(float(largest(comm, np.array([need.bytes]))[0]))}",
    } | _fit_cost(scene, bonds, comm.size)


def _fit_cost(scene: Scene, bonds: int, ranks: int) -> dict[str, str]:
    """What the fit of bond factors would take."""
    if not bonds or scene.peridynamics.surface_correction != "fitted":
        return {}
    sweeps = EXPECTED_SWEEPS[scene.peridynamics.signs]
    seconds = sweeps * bonds / (SWEEP_RATE * ranks)
    return {"fit of bond factors, about": f"{sweeps} sweeps, {seconds:.2g} s unless it is found from before"}


def run(
    scene: Scene, comm, out: Path, deck_text: str, overwrite: bool, reporter: Reporter, ways: Ways | None = None
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
        reporter = _Silent()
    try:
        return _Run(scene, comm, out, deck_text, overwrite, reporter, ways or Ways()).go()
    except NotWritten as error:
        reporter.line(f"pdfem: {error} Free space or choose another folder with --out.")
        return EXIT_NOT_WRITTEN


class _Silent:
    def line(self, text):
        pass

    def progress(self, *args):
        pass

    def row(self, columns):
        pass

    def table(self, title, rows):
        pass


class _Logged:
    """A reporter whose lines are in run.log too."""

    def __init__(self, reporter, log):
        self.reporter, self.log = reporter, log
        self.progress = reporter.progress

    def line(self, text):
        self.log.line(text)
        self.reporter.line(text)

    def row(self, columns):
        names = ("step", "event", "load_factor", "reaction", "evaluations", "relative_residual", "broken_bonds")
        self.log.line("  ".join(f"{name} {columns[name]}" for name in names if name in columns))
        self.reporter.row(columns)

    def table(self, title, rows):
        for name, value in rows:
            self.log.line(f"{name}: {value}")
        self.reporter.table(title, rows)


class _Run:
    def __init__(self, scene, comm, out, deck_text, overwrite, reporter, ways):
        self.scene, self.comm, self.out, self.deck_text = scene, comm, out, deck_text
        self.overwrite, self.reporter, self.ways = overwrite, reporter, ways
        self.seconds: dict[str, float] = {}
        self.entry: Entry | None = None  # on rank 0 alone
        self.frame_files: dict[str, FrameDigest] = {}
        self.energy_error: float | None = None
        self.smallest_eigenvalue: float | None = None
        self.stable: bool | None = None
        self.failure_numbers: dict[str, Any] | None = None
        self.probes: dict[str, Any] = {}
        self.parts: dict[str, int] = {}
        self.bar: Bar | None = None
        self.lines: dict[str, Line] = {}
        self.started = perf_counter()

    def go(self) -> int:
        try:
            start, refusal = broadcast(self.comm, on_root(self.comm, self._enter))
            if refusal:
                raise Refused(*refusal)
            hang = self.out / f"run.r{self.comm.rank}.hang"
            with Watchdog(self.comm, hang, patience()) if self.ways.watched else Asleep():
                return self._go(start)
        except (SceneError, Refused):
            if self.entry:
                self.entry.take_back()
            raise
        except Stopped as stop:
            if self.entry:
                self.entry.end(EXIT_STOPPED)
            self.reporter.line(f"pdfem: stopped: {stop}. The same command starts again.")
            return EXIT_STOPPED
        finally:
            if self.entry:
                self.entry.leave()

    def _enter(self) -> tuple[Start | None, tuple[int, str] | None]:
        """Take the folder, and decide where to start."""
        try:
            self.entry = Entry(self.out, self.deck_text, self.overwrite, self.ways, self.comm.size, self.started)
        except Refused as error:
            return None, (error.code, str(error))
        self.entry.start.notes += unchecked(self.entry.start.results)
        return self.entry.start, None

    def _look_for_a_stop(self) -> None:
        """End a start that was asked to stop before its load program began. Collective.

        Raises
        ------
        Stopped
            On all ranks.
        """
        if sum_integers(self.comm, np.array([self.ways.requests.stop_in_set_up()]))[0]:
            raise Stopped("asked to stop before the first step: nothing was done", kept=True)

    def _go(self, start: Start) -> int:
        scene, comm = self.scene, self.comm
        with _phase(self.seconds, "compile"):
            features = features_of(scene)
            if missing := on_root(comm, lambda: not_compiled(features)):
                self.reporter.line(f"compiling {missing} kernels, once on this machine (up to 30 s)")
            warm_up(comm, features)
        self._look_for_a_stop()
        before = resident()
        with _phase(self.seconds, "setup"), large_arrays_apart():
            discretization, need = prepare(scene, comm)
            if start.path:
                start.notes += compare(start, identity(scene, discretization), self.ways.force)
            if start.finished and not start.changed:
                self.reporter.line(f"pdfem: {self.out} is finished already; --set a longer program to go on.")
                if self.entry:
                    self.entry.take_back()
                return EXIT_FINISHED
            self._look_for_a_stop()
            model = build_model(scene, discretization, comm, fit_folders(self.out))
            case = make_load_case(scene, discretization, model)
            state = new_state(model)
            broken = restore(start, discretization, model, state) if start.path else None
            forces = Forces(model, state.bounds, evaluations=start.header.get("evaluations", 0))
            failure = make_failure(scene, discretization, model)
            counts = _counts(discretization, model)
        self._look_for_a_stop()
        on_root(comm, lambda: self._open_folder(start))
        tell = self.reporter.line
        for text in discretization.notes:
            tell(f"mesh: {text}")
        for text in describe_loose(case.parts, case.loose):
            tell(text)
        if not np.isnan(case.taken).all():
            tell(_describe_taken(case.taken * discretization.units.force, scene.units.force))
        self.parts = {"count": case.parts.count, "not_held": len(case.loose)}
        keeper = Keeper(scene, discretization, forces, failure, self.out, self._flush, tell, start, self.started)
        pauses = Pauses(comm, self.ways.requests, keeper, scene.checkpoint, self.ways.end)
        with _phase(self.seconds, "setup"), large_arrays_apart(APART_BESIDE_BONDS):
            solve = make_solver(scene, discretization, forces, case, tell, pauses)
            if start.path:
                restore_late(start, broken, state, failure, solve)
        tell(_headline(scene, comm, counts, self.seconds["setup"]))
        if discretization.mirrors:
            tell(f"mirror planes {_describe_mirrors(scene)}; forces and counts are those of this part")
        for note in model.body_fit.notes if model.body_fit else ():
            tell(note)
        for note in describe_correction(scene, discretization, model):
            tell(note)
        found = criteria(scene, discretization, model)
        self.failure_numbers = failure_summary(scene, discretization, failure, found)
        for note in describe_criterion(scene, discretization, failure, found):
            tell(note)
        free = scene.peridynamics.signs == "free"
        fitted = model.body_fit and model.body_fit.fit and solve.preconditioner and not start.path
        if fitted and (free or not model.body_fit.reused):
            with _phase(self.seconds, "setup"):
                self.smallest_eigenvalue = smallest_eigenvalue(model, case.fixed, solve.preconditioner)
            self.stable = self.smallest_eigenvalue is not None
            if not self.stable:
                remedy = 'peridynamics.signs = "bounded"' if free else 'surface_correction = "virial"'
                tell(f"warning: the fitted body is unstable: some motion lowers its energy. Use {remedy}.")
        for note in start.notes:
            tell(f"note: {note}")
        first = place_of(state)
        if start.path:
            pauses.resumed(state)
            tell(f"going on from {start.path.name}: step {state.step}, iteration {state.iteration}")
        for index, cut in enumerate(model.cut):
            text = f"cuts {cut:,} bonds" if cut else "cuts no bond: it does not pass through peridynamic cells"
            tell(f"cracks.{index} {text}")
        for text in describe_cracked_overlap(scene, discretization):
            tell(text)
        by_material = count_by_material(comm, model.bonds) if model.bonds else None
        for text in _interfaces_without_bonds(scene, discretization, by_material):
            tell(text)
        writer = on_root(comm, lambda: self._open_results(discretization, failure, start))
        code, reason, fields, damage, digest, rows = EXIT_FINISHED, None, None, None, None, 0
        over = state.program.pop("over", 0) and not start.changed
        n_steps = len(scene.stepping.load_factors) if isinstance(scene.stepping, Steps) else None
        wanted, remaining = bool(scene.output.fields or scene.probes), Remaining()
        held = discretization, model, case, state, forces, failure, solve, keeper
        watched = Watched(forces, *held)

        def watch(step, progress):
            watched.hear(progress)
            self.reporter.progress(step, n_steps, progress, scene.solver.tolerance)

        if not start.path:
            state.began = perf_counter()
        self.ways.requests.setting_up = False
        start_up = perf_counter() - self.started
        solve_start, output, timed, warned = perf_counter(), 0.0, False, False
        try:
            program = () if over else follow_load_program(scene, solve, failure, state, case, watch)
            for rows, row in enumerate(program, start=1):  # noqa: B007 - asked for after the loop
                self.energy_error = row.convergence.energy_error
                warned = self._warn_of_strains(row, warned)
                output_start = perf_counter()
                fields = gather_fields(discretization, forces, state.u) if wanted else None
                columns = _history_row(row, discretization.units, failure is not None)
                damage = gather_damage(discretization, model, remaining, failure)
                on_root(comm, lambda c=columns, f=fields, d=damage: writer(c, f, d))
                self.reporter.row(columns)
                output += perf_counter() - output_start
            last = forces
            if not rows:  # nothing was left to do: the fields are those of the last step
                last = Forces(model, state.bounds)
                last.evaluate_surely(state.u, np.zeros_like(state.u), np.empty_like(state.u))
            if not wanted:
                digest = digest_fields(discretization, last, state.u)
            elif not rows:
                fields = gather_fields(discretization, last, state.u)
            state.program["over"] = 1
            pauses.save(state)
        except (NotConverged, NotFinite) as error:
            code, reason = EXIT_NOT_CONVERGED, str(error)
            keeper.save_good()
        except Stopped as stop:
            code, reason = (EXIT_STOPPED, str(stop)) if stop.kept else (EXIT_NOT_WRITTEN, f"{stop}, and not kept")
            timed = not stop.asked
        did_nothing = code == EXIT_STOPPED and timed and place_of(state) == first
        if did_nothing and self.entry:
            reason += _describe_nothing(start_up, self.entry.starts.idle)
        self.seconds["solve"] = perf_counter() - solve_start - output
        self.seconds["output"] = output
        phases = {name: round(value, 6) for name, value in forces.seconds.items()}
        reasons = left_out(scene, discretization, failure, comm.size)
        parts = count_parts(*held, (fields, damage, remaining, writer))
        memory = describe_memory(comm, parts, watched, reasons, need, before)
        loads = comm.gather(model.bonds.count if model.bonds else 0)
        evaluations = forces.evaluations
        if fields is not None:
            self._probe(discretization, fields, state.load_factor)
        with _phase(self.seconds, "output"):
            if code != EXIT_STOPPED:  # who stops a run is in a hurry
                on_root(comm, self._write_lines)
                on_root(comm, lambda: attempt(self._draw, self.out / "figures", self._warn))
        self.seconds["total"] = perf_counter() - self.started
        summary = None
        if comm.rank == 0:
            self.entry.starts.end(self.seconds["total"], code, did_nothing, start.notes)
            summary = self._summary(
                code, reason, counts, model, evaluations, phases, memory, loads, discretization, by_material, state,
                keeper, fields_sha256(fields) if fields else digest,
            )
        if code == EXIT_FINISHED:
            on_root(comm, self._remove_stacks)
        on_root(comm, lambda: write_summary(self.entry.written.new(SUMMARY), sealed(summary, self.out)))
        if comm.rank == 0:
            self.reporter.table(scene.title or self.out.name, _end_table(summary, scene))
            self.reporter.table("memory: what was allocated, and what was left out", table_of(summary))
            self.reporter.line(f"pdfem: {_ending(code, reason, self.out)}")
        return code

    def _open_folder(self, start: Start) -> None:
        self.entry.written.remove(SUMMARY)
        if start.path:
            take_over(start, self.out / CHECKPOINTS)
        else:
            self.entry.written.remove(*RESULTS)
            self.entry.written.remove_checkpoints(self.out / CHECKPOINTS)
        self.entry.written.remove("figures/", "lines/")
        self.entry.settle()
        self.reporter = _Logged(self.reporter, RunLog(self.entry.written.new("run.log")))

    def _flush(self) -> dict[str, dict[str, int]]:
        self.entry.starts.note(perf_counter() - self.started)
        return flushed(self.out, self.history, self.frame_files)

    def _open_results(self, discretization: Discretization, failure: Failure | None, start: Start):
        """Create the result files, or cut them back to the checkpoint; return what appends one equilibrium to them."""
        scene, out = self.scene, self.out

        def note(text):
            start.notes.append(text)
            self.reporter.line(f"warning: {text}")

        columns = HISTORY + FAILURE_HISTORY if failure else HISTORY
        path = self.entry.written.new("history.csv")
        history = continue_history(path, columns, start.results.get("history.csv"), note)
        self.history = history
        mesh = discretization.mesh
        frames = []
        if scene.output.fields:
            from pdfem_mpi.results import vtkhdf

            def is_new(name):
                self.entry.written.new(name)
                if start.other_fields:
                    set_aside(out / name, "output was changed", note, "before")
                cursor = None if start.other_fields else start.results.get(name)
                digest = None if cursor is None else continue_frames(out / name, cursor, note)
                if digest:
                    self.frame_files[name] = digest
                return digest is None

            attributes = {"pdfem_mpi_version": __version__, "deck_sha256": _sha256(self.deck_text)}
            if discretization.has_points.any():
                region = np.repeat(discretization.region[discretization.has_points], 8)
                material = np.repeat(discretization.material[discretization.has_points], 8)
                overlap = np.repeat(discretization.is_overlap[discretization.has_points], 8)
                if is_new("points.vtkhdf"):
                    data = {"global_id": np.arange(len(region)), "region": region, "material": material}
                    vtkhdf.create_points(
                        out / "points.vtkhdf",
                        point_positions(discretization),
                        data | {"overlap": overlap},
                        attributes=attributes,
                    )
                    self.frame_files["points.vtkhdf"] = vtkhdf.digest_of(out / "points.vtkhdf")
                frames.append(("points.vtkhdf", lambda fields: fields.u_points))
            if discretization.has_nodes.any():
                carrying = discretization.node_number >= 0
                cells = discretization.has_nodes
                if is_new("elements.vtkhdf"):
                    vtkhdf.create_elements(
                        out / "elements.vtkhdf",
                        mesh.nodes[carrying],
                        discretization.node_number[mesh.cells[cells]],
                        {
                            "region": discretization.region[cells],
                            "material": discretization.material[cells],
                            "overlap": discretization.is_overlap[cells],
                        },
                        attributes=attributes,
                    )
                    self.frame_files["elements.vtkhdf"] = vtkhdf.digest_of(out / "elements.vtkhdf")
                frames.append(("elements.vtkhdf", lambda fields: fields.u_nodes))

        def write(columns: dict[str, Any], fields: Fields, damage: np.ndarray | None) -> None:
            history.append(columns)
            for name, pick in frames:
                arrays = {"displacement": pick(fields)}
                if damage is not None and name == "points.vtkhdf":
                    arrays["damage"] = damage
                vtkhdf.append_frame(out / name, columns["load_factor"], arrays, digest=self.frame_files[name])

        return write

    def _probe(self, discretization: Discretization, fields: Fields, factor: float) -> None:
        for probe in self.scene.probes:
            if isinstance(probe, DisplacementProbe):
                self.probes[probe.name] = displacement_at(discretization, fields, probe.point).tolist()
            elif isinstance(probe, BarProbe):
                self.bar = measure_bar(self.scene, discretization, fields, probe, factor)
                self.probes |= bar_results(self.scene, discretization, self.bar, probe, factor)
            elif isinstance(probe, LineProbe):
                self.lines[probe.name] = measure_line(discretization, fields, probe)

    def _warn_of_strains(self, row: Report, warned: bool) -> bool:
        """Tell of strained elements once, at the first row that has them; whether that is done."""
        if warned or not (row.elements and row.elements.warning):
            return warned
        self.reporter.line(row.elements.warning)
        return True

    def _write_lines(self) -> None:
        if self.lines:
            (self.out / "lines").mkdir(exist_ok=True)
        for name, line in self.lines.items():
            inside = line.kind != ""
            u = [values if known else None for values, known in zip(line.displacement, inside, strict=True)]
            rows = zip(line.distance, line.position, u, line.kind, strict=True)
            write_line(self.entry.written.new(f"lines/{name}.csv"), rows)

    def _remove_stacks(self) -> None:
        """What earlier starts left where they hung says nothing of a run that finished."""
        for path in self.out.glob("run.r*.hang"):
            with suppress(OSError):
                path.unlink()

    def _warn(self, text: str) -> None:
        self.reporter.line(f"warning: {text}")

    def _draw(self) -> None:
        if not self.scene.output.figures:
            return
        if int((self.history.last() or {}).get("broken_bonds") or 0):
            draw_run(self.out, self.scene, self._warn)
        if not (self.bar or self.lines):
            return
        from pdfem_mpi.results import plots

        (self.out / "figures").mkdir(exist_ok=True)
        if self.bar:
            attempt(lambda: self._draw_bar(plots), self.out / "figures" / "axial_displacement.png", self._warn)
        for name, line in self.lines.items():
            moving = np.flatnonzero(np.ptp(line.position, axis=0) > 0.0)
            on_axis = len(moving) == 1
            fixed = (f"{'xyz'[d]} = {line.position[0, d]:.6g}" for d in range(3) if d not in moving)
            samples = plots.LineSamples(
                line.position[:, moving[0]] if on_axis else line.distance,
                line.displacement[:, :2],
                line.kind,
                "xyz"[moving[0]] if on_axis else "distance from its start",
                f"line {name}" + (f": {', '.join(fixed)}" if on_axis else ""),
            )
            path = self.entry.written.new(f"figures/line_{name}.png")
            texts = self.scene.title, self.scene.units.length
            attempt(functools.partial(plots.displacement_along_line, path, samples, *texts), path, self._warn)

    def _draw_bar(self, plots) -> None:
        axis = next(probe.axis for probe in self.scene.probes if isinstance(probe, BarProbe))
        bar = self.bar
        kind = np.where(bar.has_points, "peridynamics", "finite elements")
        stations = plots.BarStations(
            bar.coordinate, bar.displacement, bar.exact, kind, bar.interface, bar.overlap, axis
        )
        plots.axial_displacement(
            self.entry.written.new("figures/axial_displacement.png"),
            stations,
            self.scene.title,
            self.scene.units.length,
        )

    def _summary(
        self, code, reason, counts, model, evaluations, phases, memory, loads, discretization, by_material, state,
        keeper, digest,
    ):
        last = self.history.last() or {}

        def number(column, kind=float):
            return kind(last[column]) if last.get(column) else None

        return {
            "schema_version": SCHEMA_VERSION,
            "status": STATUS[code],
            "reason": reason,
            "exit_code": code,
            "title": self.scene.title,
            "deck_sha256": _sha256(self.deck_text),
            "fields_sha256": digest,
            "ranks": self.comm.size,
            "mesh": {
                "kind": self.scene.mesh.kind,
                "symmetry": list(self.scene.mesh.symmetry),
                "sha256": discretization.mesh.sha256(),
                "notes": list(discretization.notes),
                **asdict(discretization.quality),
            },
            "counts": counts,
            "bonds_per_rank": loads,
            "solve": {
                "kind": self.scene.solver.kind,
                "load_steps": state.step,
                "evaluations": evaluations,
                "evaluations_last_step": number("evaluations", int),
                "relative_residual": number("relative_residual"),
                "energy_error": self.energy_error,
            },
            "balance": {"force": number("force_balance"), "moment": number("moment_balance")},
            "checkpoints": {
                "written": keeper.written,
                "failed": keeper.failed,
                "seconds": keeper.seconds_in_all,
                "bytes_of_last": keeper.size or None,
            },
            "restarts": keeper.restarts,
            "seconds_of_all_starts": self.entry.starts.seconds_before + self.seconds["total"],
            "surface_correction": {
                "kind": self.scene.peridynamics.surface_correction if discretization.cutoff else None,
                "remaining": model.correction_remaining if discretization.cutoff else None,
                "fit": _fit_report(model.body_fit, self.smallest_eigenvalue, self.stable),
            },
            "failure": self.failure_numbers,
            "bonds_cut_by_cracks": list(model.cut),
            "parts_at_start": self.parts,
            "bonds_by_materials": _named_pairs(discretization.materials.names, by_material),
            "probes": self.probes,
            "seconds": self.seconds | {"evaluation_phases_rank_0": phases},
            "memory": memory,
            "versions": {
                "pdfem_mpi": __version__,
                "python": platform.python_version(),
                "numpy": np.__version__,
                "numba": sys.modules["numba"].__version__,
            },
        }


def _history_row(row: Report, units: ModelUnits, fails: bool) -> dict[str, Any]:
    """A report in the deck's units, by the columns of history.csv."""
    resultant = (row.resultant * units.force).tolist()
    columns = {
        "step": row.step,
        "event": row.event,
        "load_factor": row.load_factor,
        "displacement": row.displacement * units.length,
        "reaction": row.reaction * units.force,
        **dict(zip(("reaction_x", "reaction_y", "reaction_z"), resultant, strict=True)),
        "evaluations": row.convergence.evaluations,
        "relative_residual": row.convergence.residual,
        "energy_error": row.convergence.energy_error,
        "force_balance": row.force_balance,
        "moment_balance": row.moment_balance,
        "wall_seconds": row.seconds,
    }
    if fails:
        energy = units.force * units.length
        extent = row.extent * units.length + units.origin
        columns |= {
            "broken_bonds": row.broken,
            "new_broken_bonds": row.new_broken,
            "stored_energy": _times(row.stored, energy),
            "dissipated_energy": _times(row.dissipated, energy),
            "external_work": _times(row.work, energy),
            "released_energy": _times(row.released, energy),
            "ledger_error": row.ledger_error,
        }
        for d, axis in enumerate("xyz"):
            columns[f"crack_{axis}_min"], columns[f"crack_{axis}_max"] = extent[:, d] if row.broken else (None, None)
    return columns


def _times(value: float | None, unit: float) -> float | None:
    return None if value is None else value * unit


def _counts(discretization: Discretization, model: Model | None) -> dict[str, int]:
    """Sizes of the whole body. Collective when there is a model."""
    counts = {
        "nodes": discretization.n_nodes,
        "elements": int(np.count_nonzero(discretization.has_stiffness)),
        "points": 8 * discretization.n_point_cells,
        "overlap_cells": int(np.count_nonzero(discretization.is_overlap)),
    }
    if model is not None:
        counts["undirected_bonds"] = total_bonds(model.comm, model.bonds)
        counts["unknowns"] = int(sum_integers(model.comm, np.array([model.n_unknowns]))[0])
    return counts


def _named_pairs(names: tuple[str, ...], by_material: np.ndarray | None) -> dict[str, int]:
    """Bonds between each two of several materials that have any, by name; empty for one material."""
    if by_material is None or len(names) == 1:
        return {}
    pairs = [(a, b) for a in range(len(names)) for b in range(a, len(names)) if by_material[a, b]]
    return {f"{names[a]} - {names[b]}": int(by_material[a, b]) for a, b in pairs}


def _interfaces_without_bonds(scene: Scene, discretization: Discretization, by_material: np.ndarray | None):
    """Sentences about interfaces that no bond crosses."""
    number = discretization.materials.names.index
    for index, interface in enumerate(scene.interfaces):
        if not by_material[tuple(number(name) for name in interface.between)]:
            yield f"interfaces.{index} is crossed by no bond: its materials do not meet in peridynamics or the overlap"


def _describe_mirrors(scene: Scene) -> str:
    """The planes, and what part of the body they leave."""
    faces = scene.mesh.symmetry
    endless = [axis for axis in "xyz" if {f"{axis}-", f"{axis}+"} <= set(faces)]
    if endless:
        return f"{', '.join(faces)}: a cell of a body without end along {' and '.join(endless)}"
    return f"{', '.join(faces)}: {('half', 'a quarter', 'an eighth')[len(faces) - 1]} of the body is modelled"


def _fit_report(outcome: BodyFit | None, smallest: float | None, stable: bool | None) -> dict[str, Any] | None:
    """What became of the fit of the bond factors; its numbers are missing where none serves.

    Stability is null where it was not looked at: by relaxation, after a restart, or positive factors of an earlier fit.
    """
    if outcome is None:
        return None
    report = {
        "fingerprint": outcome.fingerprint,
        "reused": outcome.reused,
        "notes": list(outcome.notes),
        "bodies": outcome.n_bodies,
    }
    found = {"smallest_eigenvalue": smallest, "stable": stable}
    return report | (asdict(outcome.fit) | found if outcome.fit else {})


def _describe_nothing(start_up: float, idle: int) -> str:
    """What to say of a start that ended where it began, after others that did."""
    again = f" It is start {idle + 1} in a row that did nothing." if idle else ""
    return f". Nothing was done. Start-up alone took {start_up:.1f} s: allow more.{again}"


def _describe_taken(force: np.ndarray, unit: str) -> str:
    """A sentence about loads on held places; force (3,), NaN along axes where there are none."""
    parts = [f"{value:.6g}{' ' + unit if unit else ''} along {axis}" for value, axis in zip(force, "xyz", strict=True)
             if not np.isnan(value)]  # fmt: skip
    return f"loads of {', '.join(parts)} act on held places: their supports take them, and reactions do not count them"


def _headline(scene, comm, counts, seconds) -> str:
    parts = [
        f"{counts[name]:,} {name.replace('_', ' ')}" for name in ("elements", "points", "undirected_bonds")
    ]
    return f"{scene.title or 'scene'}: {', '.join(parts)} on {comm.size} ranks, set up in {seconds:.1f} s"


def _ending(code: int, reason: str | None, out: Path) -> str:
    if code == EXIT_FINISHED:
        return f"finished; results in {out}"
    remedy = f". Go on with: pdfem resume {out}" if code == EXIT_STOPPED else ""
    return f"{STATUS[code]}: {(reason or '').rstrip('.')}{remedy}"


def _end_table(summary: dict, scene: Scene) -> list[tuple[str, str]]:
    rows = [(name.replace("_", " "), f"{count:,}") for name, count in summary["counts"].items()]
    solve, balance = summary["solve"], summary["balance"]
    rows.append(("force evaluations", f"{solve['evaluations']:,}"))
    if solve["relative_residual"] is not None:
        rows.append(("relative residual", f"{solve['relative_residual']:.2e}"))
        if solve["energy_error"] is not None:
            rows.append(("error in the energy norm, about", f"{solve['energy_error']:.2e}"))
        rows.append(
            ("net internal force, moment", f"{balance['force']:.1e}, {balance['moment']:.1e} of the sums")
        )
    length = scene.units.length
    for name, value in summary["probes"].items():
        unit = f" {length}" if isinstance(value, list) or name == "end_displacement" else ""
        text = ", ".join(f"{v:.6g}" for v in value) if isinstance(value, list) else f"{value:.6g}"
        rows.append((name.replace("_", " "), text + unit))
    seconds = summary["seconds"]
    rows.append(
        ("seconds: set-up, solve, total", ", ".join(f"{seconds[k]:.1f}" for k in ("setup", "solve", "total")))
    )
    rows.append(("peak memory per rank", f"{max(summary['memory']['peak_bytes_per_rank']) / 2**20:.0f} MiB"))
    return rows


def _sha256(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


class _phase:
    """Adds the time spent inside to an entry."""

    def __init__(self, seconds: dict[str, float], name: str):
        self.seconds, self.name = seconds, name

    def __enter__(self):
        self.start = perf_counter()

    def __exit__(self, *exception):
        self.seconds[self.name] = self.seconds.get(self.name, 0.0) + perf_counter() - self.start
