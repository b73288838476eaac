"""Checkpoints of a run: which to start from, and how all ranks write one together. Promise: docs/restart.md."""

from __future__ import annotations

import contextlib
import copy
import hashlib
import os
import platform
import sys
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from pdfem_mpi import __version__
from pdfem_mpi.body.discretization import Discretization
from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.model.bounds import Bounds
from pdfem_mpi.model.forces import Forces
from pdfem_mpi.model.model import Model
from pdfem_mpi.model.state import FIELDS, State
from pdfem_mpi.parallel.comm import NotWritten, broadcast
from pdfem_mpi.peridynamics.failure import Failure
from pdfem_mpi.results.cursor import find_damage, free_name
from pdfem_mpi.results.summary import look_at_summary
from pdfem_mpi.run.identity import differences, free_changes, identity, sha256
from pdfem_mpi.run.tables import BROKEN, Layout, make_layout, read_broken, read_fields, total_broken, write_tables
from pdfem_mpi.solvers.equilibrium import EquilibriumSolver
from pdfem_mpi.system import faults
from pdfem_mpi.system.launcher import cpu_name
from pdfem_mpi.system.signals import Requests

if TYPE_CHECKING:
    from pdfem_mpi.results.checkpoint import Reader

EXIT_USAGE, EXIT_NO_CHECKPOINT, EXIT_NOT_WRITTEN = 64, 65, 73
FOLDER = "checkpoints"
MOST_BYTES = 1 << 24  # of a summary
#: So many checkpoints that could not be written, one after the other, end the run.
MOST_FAILURES = 3
#: What a file's header calls the version of its content; the form of the file has another number.
SCHEMA = 1

AUTO, NEVER, CONTINUE = "auto", "never", "continue"


class Refused(Exception):
    """A run that is not started: one sentence and an exit code. Raised on all ranks alike."""

    def __init__(self, code: int, sentence: str):
        self.code = code
        super().__init__(sentence)


@dataclass(frozen=True)
class Ways:
    """How a run is started, and what may stop it.

    Attributes
    ----------
    resume : str
        "auto": start or go on; "never": start; "continue": go on, also from the end of a run; or a checkpoint's name.
    steal_lock, force : bool
        Take a folder that another job may hold; go on although the scene is another.
    end : float or None
        Time of ``monotonic`` by which the run must be over.
    watched : bool
        Whether the watchdog runs.
    requests : Requests
        What signals ask.
    deck : Path or None
        The deck that is read, which the run must not replace; None where it may, as when a run goes on in its folder.
    """

    resume: str = AUTO
    steal_lock: bool = False
    force: bool = False
    end: float | None = None
    watched: bool = False
    requests: Requests = field(default_factory=Requests)
    deck: Path | None = None


@dataclass
class Start:
    """Where a run starts.

    Attributes
    ----------
    path : Path or None
        The checkpoint; None: at the beginning.
    header : dict
        The checkpoint's.
    passed : list of (Path, str)
        Newer checkpoints, and what they are called from now on: "damaged" or "superseded".
    notes : list of str
        What the user should know.
    finished : bool
        The run has nothing left to do unless the deck was changed.
    changed : bool
        The deck is not that of the checkpoint.
    other_fields : bool
        Frames have other fields than before.
    seconds_before : float
        Of all earlier starts.
    restarts : list of dict
        One entry for each start but the first, this one's included.
    """

    path: Path | None = None
    header: dict[str, Any] = field(default_factory=dict)
    passed: list[tuple[Path, str]] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    finished: bool = False
    changed: bool = False
    other_fields: bool = False
    seconds_before: float = 0.0
    restarts: list[dict[str, Any]] = field(default_factory=list)

    @property
    def results(self) -> dict[str, dict[str, int]]:
        """How much of each result file belongs to the checkpoint."""
        return self.header.get("results", {})


def choose_start(out: Path, resume: str, overwrite: bool) -> Start:
    """Decide on rank 0 where a run starts; nothing is changed.

    Raises
    ------
    Refused
        The folder holds a run that must not be touched, or no checkpoint can be used.
    """
    from pdfem_mpi.results.checkpoint import list_checkpoints

    named = resume not in (AUTO, NEVER, CONTINUE)
    if overwrite and named:
        raise Refused(
            EXIT_USAGE,
            f"--overwrite starts at the beginning and removes what {out} holds, --resume {resume} goes on from there. "
            "Leave one of them away.",
        )
    if overwrite:
        return Start()
    if named:
        return _start_from(out, Path(resume))
    found = list_checkpoints(out / FOLDER)
    status, notes = look_at_summary(out)
    if (resume == NEVER and (status or found)) or (resume == AUTO and (status == "finished" or (status and not found))):
        raise Refused(
            EXIT_USAGE,
            f"the folder {out} already holds a run. Use --overwrite, or another folder with --out.",
        )
    if not found:
        begun = (out / "deck.toml").exists()
        return Start(notes=[*notes, "there is no checkpoint yet: starting at the beginning"] if begun else [])
    passed: list[tuple[Path, str]] = []
    for _, path in found:
        header, reason = _look_at(path)
        if reason is None:
            # a run that is finished has a last checkpoint that says so: without it, the end is made again
            over = status == "finished" and not passed and bool(header["state"]["program"].get("over"))
            damage = find_damage(out, header["results"]) if over else []
            return Start(path, header, passed, notes + damage, over and not damage)
        notes.append(f"{path.name} is passed over: {reason}")
        passed.append((path, "damaged"))
    reasons = "; ".join(note.replace(" is passed over", "") for note in notes)
    raise Refused(
        EXIT_NO_CHECKPOINT,
        f"no checkpoint in {out / FOLDER} can be used: {reasons}. Start again with --overwrite.",
    )


def _start_from(out: Path, path: Path) -> Start:
    """A checkpoint that was asked for by name; results go on only if it belongs to this folder."""
    from pdfem_mpi.results.checkpoint import Invalid, check, list_checkpoints

    try:
        header = check(path)
    except Invalid as error:
        raise Refused(EXIT_NO_CHECKPOINT, f"{path}: {error}. Give another checkpoint.") from None
    if path.parent.resolve() == (out / FOLDER).resolve():
        newer = [p for _, p in list_checkpoints(out / FOLDER) if p.name > path.name]
        return Start(path, header, [(p, "superseded") for p in newer])
    if look_at_summary(out)[0] or list_checkpoints(out / FOLDER):
        raise Refused(EXIT_USAGE, f"the folder {out} already holds a run. Use another folder with --out.")
    return Start(path, {**header, "results": {}}, notes=["results begin at this checkpoint: it is of another folder"])


def _look_at(path: Path) -> tuple[dict[str, Any], str | None]:
    """Header of a checkpoint, or why it cannot be used."""
    from pdfem_mpi.results.checkpoint import Invalid, check

    try:
        return check(path), None
    except Invalid as error:
        if error.newer:
            raise Refused(EXIT_NO_CHECKPOINT, f"{path}: {error}. Use that version of pdfem_mpi.") from None
        return {}, str(error)


def compare(start: Start, keys: dict[str, Any], force: bool) -> list[str]:
    """Compare a checkpoint's scene with the deck's; return the changes, for the log.

    Raises
    ------
    Refused
        With every key that differs.
    """
    header = start.header
    refused, told = differences(header["keys"], keys, header["state"]["step"])
    start.changed = bool(refused or told)
    start.other_fields = any(header["keys"].get(key) != keys[key] for key in ("output.fields", "output.damage"))
    if refused and not force:
        raise Refused(
            EXIT_NO_CHECKPOINT,
            f"{start.path}: written for another scene: {'; '.join(refused)}. Restore these keys, or choose a new "
            "folder with --out.",
        )
    told += free_changes(header["keys"], keys)
    now = _environment()
    for what in ("versions", "cpu", "code_sha256"):
        if header[what] != now[what]:
            name = {"versions": "packages", "cpu": "CPU", "code_sha256": "version of pdfem_mpi's source"}[what]
            told.append(f"it was written with another {name}: equal bits are promised for the same only")
    return [f"forced: {key}" for key in refused] + told


def restore(start: Start, discretization: Discretization, model: Model, state: State) -> np.ndarray:
    """Fill the state from a checkpoint. Collective.

    Parameters
    ----------
    state : State
        Overwritten, but for the bounds: they belong to the solver as well, which is made with new ones.

    Returns
    -------
    int64, shape (n, 2)
        Broken bonds with an end in a cell of this rank.

    Raises
    ------
    OSError
        On all ranks.
    Refused
        Its tables are not those of the scene.
    """
    saved = start.header["state"]
    state.step, state.load_factor = saved["step"], saved["load_factor"]
    state.iteration, state.spent = saved["iteration"], saved["spent"]
    state.program = dict(saved["program"])
    state.began = perf_counter() - saved["seconds"]
    for name in saved.get("fields", [entry.name for entry in FIELDS]):  # all, before they were named
        state.add(name)
    layout = make_layout(discretization, model)
    with _reader(start.path, model.comm) as reader:
        fault = broadcast(model.comm, _shape_fault(layout, state, reader) if reader else None)
        if fault:
            raise Refused(EXIT_NO_CHECKPOINT, f"{start.path}: {fault}. Start again with --overwrite.")
        read_fields(model, layout, state, reader)
        return read_broken(model, reader)


def _shape_fault(layout: Layout, state: State, reader: Reader) -> str | None:
    """Which table of a checkpoint has not the rows that this scene has; None if all have."""
    for name, (rows, width, _) in layout.tables(0, False, state.fields).items():
        if name != BROKEN and reader.shape(name) != (rows, width):
            return f"its table {name} has shape {reader.shape(name)}, and the scene needs {(rows, width)}"
    return None


def _fill(bounds: Bounds, saved: dict[str, Any]) -> None:
    """Set the bounds in place: the forces have them too."""
    bounds.bond, bounds.element = saved["bond"], saved["element"]
    for name, part in saved["parts"].items():
        _fill(bounds.part(name), part)


def restore_late(
    start: Start, pairs: np.ndarray, state: State, failure: Failure | None, solve: EquilibriumSolver
) -> None:
    """Set the bounds, break the checkpoint's bonds, and let the solver know. Collective.

    The solver was made for the intact body with new bounds, as in the run that broke them one after the other.

    Parameters
    ----------
    pairs : int64, shape (n, 2)
        From `restore`.

    Raises
    ------
    Refused
        They are not bonds of this scene.
    """
    _fill(state.bounds, start.header["state"]["bounds"])
    if failure is None:
        return
    books = start.header["failure"]
    try:
        model, total = solve.forces.model, start.header["broken_bonds"]
        failure.restore(model.comm, model.points, model.bonds, pairs, np.array(books["dissipated"]), total)
    except ValueError as error:
        raise Refused(EXIT_NO_CHECKPOINT, f"{start.path}: {error}. Start again with --overwrite.") from None
    failure.last_extent = np.array(books["last_extent"])
    broken = failure.take()
    if start.header["broken_bonds"]:
        solve.soften(broken)


def _reader(path: Path, comm):
    if comm.rank > 0:
        return contextlib.nullcontext()
    from pdfem_mpi.results.checkpoint import open_checkpoint

    return open_checkpoint(path)


def _environment() -> dict[str, Any]:
    """What equal bits rest on beside the deck."""
    total = hashlib.sha256()
    package = Path(__file__).parents[1]
    for file in sorted(package.rglob("*.py")):
        total.update(f"{file.relative_to(package)}\n".encode() + file.read_bytes())
    return {
        "versions": {"pdfem_mpi": __version__, "numpy": np.__version__, "numba": sys.modules["numba"].__version__},
        "cpu": cpu_name(),
        "code_sha256": total.hexdigest(),
    }


class Moment(NamedTuple):
    """What a checkpoint holds beside the state.

    Attributes
    ----------
    evaluations : int
        Of the run so far.
    broken : int64, shape (n, 2)
        Bonds broken on this rank.
    books : dict or None
        The dissipated energy as an exact sum, and the extent of the last breaks.
    """

    evaluations: int
    broken: np.ndarray
    books: dict[str, Any] | None


class Keeper:
    """Writes checkpoints, all ranks together, and keeps count of failures.

    Parameters
    ----------
    scene : Scene
    discretization : Discretization
    forces : Forces
        Of the run: knows its evaluations.
    failure : Failure or None
        Knows the broken bonds.
    out : Path
        The run folder.
    flush : callable
        On rank 0: bring the result files to the disk and return how far they are, by name.
    tell : callable
        Hears a line of every checkpoint.
    start : Start
    started : float
        Time of ``perf_counter`` at which this start of the run began.

    Attributes
    ----------
    written, failed : int
    seconds, size : float, int
        Of the last checkpoint.
    seconds_in_all : float
    good : (State, Moment) or None
        What `remember` holds.
    restarts : list of dict
        One entry for each start but the first, the last one's included.
    """

    def __init__(
        self,
        scene: Scene,
        discretization: Discretization,
        forces: Forces,
        failure: Failure | None,
        out: Path,
        flush: Callable[[], dict[str, dict[str, int]]],
        tell: Callable[[str], None],
        start: Start,
        started: float,
    ):
        self.comm, self.forces, self.model, self.failure = forces.model.comm, forces, forces.model, failure
        self.layout = make_layout(discretization, forces.model)
        self.folder, self.keep = out / FOLDER, scene.checkpoint.keep
        self.written = self.failed = self.size = 0
        self.seconds = self.seconds_in_all = 0.0
        self.restarts = start.restarts
        self._flush, self._tell = flush, tell
        self._before, self._started = start.seconds_before, started
        self._failures, self._number = 0, 0
        self.good: tuple[State, Moment] | None = None
        if self.comm.rank == 0:
            keys = identity(scene, discretization)
            self._fixed = {
                "program": "pdfem_mpi",
                "schema": SCHEMA,
                **_environment(),
                "python": platform.python_version(),
                "ranks": self.comm.size,
                "fingerprint": sha256(keys),
                "keys": keys,
            }

    @property
    def elapsed(self) -> float:
        """Seconds of the run, those of earlier starts included."""
        return self._before + perf_counter() - self._started

    def remember(self, state: State) -> None:
        """Hold a copy of a good state, for the case that the next step fails; the beginning needs none."""
        self.good = None  # not two copies at a time
        if state.step:
            self.good = copy.deepcopy(state), self._moment()

    def save_good(self) -> bool:
        """Write the last good state, if it was not the beginning. Collective."""
        return self.save(*self.good) if self.good else False

    def save(self, state: State, moment: Moment | None = None) -> bool:
        """Write a checkpoint by the protocol of results/checkpoint.py. Collective.

        Returns
        -------
        bool
            False: it could not be written, older ones are as they were, and the user was told.

        Raises
        ------
        NotWritten
            On all ranks, after `MOST_FAILURES` failures in a row.
        """
        faults.begin("agree")
        begun = perf_counter()
        comm = self.comm
        moment = moment or self._moment()
        header = self._header(state, moment)
        writer, problem = None, None
        if comm.rank == 0:
            try:
                writer = self._open(header, state)
            except OSError as error:
                problem = error
        write_tables(self.model, self.layout, state.fields, moment.broken, writer)
        if writer:
            try:
                self.size = writer.finish(header)
            except (OSError, RuntimeError) as error:
                problem = error
        faults.begin("outcome")
        reason = broadcast(comm, None if problem is None else getattr(problem, "strerror", None) or str(problem))
        self.seconds = perf_counter() - begun
        self.seconds_in_all += self.seconds
        if reason is None:
            self._failures = 0
            self.written += 1
            faults.begin("rotate")
            if comm.rank == 0:
                self._rotate()
                self._tell(
                    f"checkpoint {writer.path.name}: step {state.step}, iteration {state.iteration}, "
                    f"{self.size / 1e6:.1f} MB in {self.seconds:.2f} s"
                )
            return True
        self.failed += 1
        self._failures += 1
        sentence = f"{self.folder}: a checkpoint cannot be written ({reason})"
        if self._failures >= MOST_FAILURES:
            raise NotWritten(f"{sentence}, {MOST_FAILURES} times in a row.")
        self._tell(f"warning: {sentence}; older ones are kept. Free space.")
        return False

    def _moment(self) -> Moment:
        """What a checkpoint holds beside the state, as it is now."""
        failure, evaluations = self.failure, self.forces.evaluations
        if failure is None:
            return Moment(evaluations, np.empty((0, 2), np.int64), None)
        books = {"dissipated": failure.dissipated_digits.tolist(), "last_extent": failure.last_extent.tolist()}
        return Moment(evaluations, failure.broken_pairs(), books)

    def _header(self, state: State, moment: Moment) -> dict[str, Any]:
        """Everything that is not a table. Collective."""
        numbers = {
            "step": state.step,
            "load_factor": float(state.load_factor),
            "iteration": state.iteration,
            "spent": state.spent,
            "fields": list(state.fields),
            "seconds": perf_counter() - state.began,
            "bounds": asdict(state.bounds),
            "program": {name: _plain(value) for name, value in state.program.items()},
        }
        broken, wide = total_broken(self.model, moment.broken)
        if self.comm.rank > 0:
            return {}
        return self._fixed | {
            "written": datetime.now(UTC).isoformat(timespec="seconds"),
            "state": numbers,
            "broken_bonds": broken,
            "wide": wide,
            "failure": moment.books,
            "evaluations": moment.evaluations,
            "seconds": self.elapsed,
            "restarts": self.restarts,
        }

    def _open(self, header: dict[str, Any], state: State):
        """Bring results to the disk, note how far they are, and open the file. On rank 0."""
        from pdfem_mpi.results.checkpoint import Writer, checkpoint_path, list_checkpoints

        faults.begin("flush")
        header["results"] = self._flush()
        self.folder.mkdir(exist_ok=True)
        if not self._number:
            self._number = max((number for number, _ in list_checkpoints(self.folder)), default=0)
        path = checkpoint_path(self.folder, self._number + 1)
        tables = self.layout.tables(header["broken_bonds"], header["wide"], state.fields)
        return Writer(path, tables, job_name())

    def _rotate(self) -> None:
        from pdfem_mpi.results.checkpoint import rotate

        self._number += 1
        with contextlib.suppress(OSError):
            rotate(self.folder, self.keep)


def take_over(start: Start, folder: Path) -> None:
    """Clean the folder of checkpoints for a run that goes on: torn files go, newer ones not used step aside."""
    from pdfem_mpi.results.checkpoint import remove_stale

    remove_stale(folder)
    for path, fate in start.passed:
        with contextlib.suppress(FileNotFoundError):
            os.replace(path, free_name(path, fate))


def job_name() -> str:
    """The batch system's number of this job, or this process'."""
    return os.environ.get("SLURM_JOB_ID") or str(os.getpid())


def _plain(value: Any) -> float | int | bool:
    return value.item() if isinstance(value, np.generic) else value
