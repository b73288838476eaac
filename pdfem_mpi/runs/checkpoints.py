"""Checkpoints of a run: how all ranks write one together, and what it holds. docs/restart.md says what is promised."""

from __future__ import annotations

import contextlib
import copy
import os
import platform
from collections.abc import Callable
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np

from pdfem_mpi.body.share import Share
from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.model.forces import Forces
from pdfem_mpi.model.state import State
from pdfem_mpi.parallel.comm import NotWritten, broadcast, on_root_beating
from pdfem_mpi.peridynamics.failure import Failure
from pdfem_mpi.results.checkpoint_files import FORMAT
from pdfem_mpi.results.cursor import free_name
from pdfem_mpi.runs.environment import environment
from pdfem_mpi.runs.identity import identity, sha256
from pdfem_mpi.runs.restart_point import FOLDER, RestartPoint
from pdfem_mpi.runs.tables import TURNED, columns_of_broken, make_layout, total_broken, turned_cells, write_tables
from pdfem_mpi.system import faults

#: So many checkpoints that could not be written, one after the other, end the run.
MOST_FAILURES = 3


class CheckpointContents(NamedTuple):
    """What a checkpoint holds beside the state.

    Attributes
    ----------
    evaluations : int
        Of the run so far.
    broken : int64, shape (n, 2 or 3)
        Bonds broken on this rank; with their teeth where bonds soften.
    books : dict or None
        The dissipated energy as an exact sum, and the extent of the last breaks.
    """

    evaluations: int
    broken: np.ndarray
    books: dict[str, Any] | None

    @classmethod
    def of(cls, forces: Forces, failure: Failure | None) -> CheckpointContents:
        """As it is now."""
        if failure is None:
            return cls(forces.evaluations, np.empty((0, 2), np.int64), None)
        books = {"dissipated": failure.dissipated_digits.tolist(), "last_extent": failure.last_extent.tolist()}
        return cls(forces.evaluations, failure.broken_pairs(), books)


class OfOneBody:
    """What checkpoints are written of: a share of the body, and its equations."""

    good: tuple[State, CheckpointContents] | None = None

    def describe(self, share: Share, forces: Forces, failure: Failure | None) -> None:
        """Write checkpoints of these."""
        self.forces, self.model, self.failure = forces, forces.model, failure
        self.layout, self.turned = make_layout(share, columns_of_broken(forces.model)), turned_cells(share)

    def let_go(self, comes_back: bool) -> None:
        """Hold nothing of a body that is about to be made anew; a good state of it stays, if it comes back."""
        self.forces = self.model = self.failure = None
        self.good = self.good if comes_back else None

    def take(self, simulation: Any, came_back: bool) -> None:
        """Write checkpoints of the body as a simulation has it now."""
        self.describe(simulation.share, simulation.forces, simulation.failure)


class CheckpointWriter(OfOneBody):
    """Writes checkpoints, all ranks together, and keeps count of failures.

    Parameters
    ----------
    scene, share, forces, failure
        Of the run; ``failure`` may be None.
    out : Path
        The run folder.
    flush : callable
        On rank 0: bring the result files to the disk and return how far they are, by name.
    report : callable
        Called with a line about every checkpoint.
    start : RestartPoint
    started : float
        Time of ``perf_counter`` at which this start of the run began.

    Attributes
    ----------
    written, failed, seconds_in_all : int, int, float
    seconds, size : float, int
        Of the last checkpoint.
    good : (State, CheckpointContents) or None
        What `remember` holds.
    restarts : list of dict
        One for each start but the first.
    """

    def __init__(
        self,
        scene: Scene,
        share: Share,
        forces: Forces,
        failure: Failure | None,
        out: Path,
        flush: Callable[[], dict[str, dict[str, int]]],
        report: Callable[[str], None],
        start: RestartPoint,
        started: float,
    ):
        self.comm = forces.model.comm
        self.describe(share, forces, failure)
        self.folder, self.keep = out / FOLDER, scene.checkpoint.keep
        self.written = self.failed = self.size = 0
        self.seconds = self.seconds_in_all = 0.0
        self._flush, self._report, self.restarts = flush, report, start.restarts
        self._before, self._started = start.seconds_before, started
        self._failures, self._number = 0, 0
        self.good: tuple[State, CheckpointContents] | None = None
        self._fixed = origin_of(scene, share) if self.comm.rank == 0 else {}

    @property
    def elapsed(self) -> float:
        """Seconds of the run, those of earlier starts included."""
        return self._before + perf_counter() - self._started

    def remember(self, state: State) -> None:
        """Hold a copy of a good state, for the case that the next step fails; the beginning needs none."""
        self.good = None  # not two copies at a time
        if state.step:
            self.good = copy.deepcopy(state), CheckpointContents.of(self.forces, self.failure)

    def save_good(self) -> bool:
        """Write the last good state, if it was not the beginning. Collective."""
        return self.save(*self.good) if self.good else False

    def save(self, state: State, contents: CheckpointContents | None = None) -> bool:
        """Write a checkpoint by the protocol of results/checkpoint.py. Collective.

        Returns
        -------
        bool
            False: it could not be written, older ones are as they were, and the user was warned.

        Raises
        ------
        NotWritten
            On all ranks, after `MOST_FAILURES` failures in a row.
        """
        faults.begin("agree")
        begun = perf_counter()
        comm = self.comm
        contents = contents or CheckpointContents.of(self.forces, self.failure)
        header = self._header(state, contents)
        writer, problem = None, None
        if comm.rank == 0:
            try:
                writer = self._open(header, state)
            except OSError as error:
                problem = error
        write_tables(self.model, self.layout, state.fields, contents.broken, writer)
        if writer and self.turned is not None:
            writer.write_rows(TURNED, 0, self.turned[:, None])
        self.size, problem = _finish(comm, writer, header, (self.size, problem))
        faults.begin("outcome")
        reason = broadcast(comm, None if problem is None else getattr(problem, "strerror", None) or str(problem))
        self.seconds = perf_counter() - begun
        self.seconds_in_all += self.seconds
        if reason is None:
            self._failures = 0
            self.written += 1
            faults.begin("rotate")
            if comm.rank == 0:
                self._number += 1
                remove_old(self.folder, self.keep)
                self._report(
                    f"checkpoint {writer.path.name}: step {state.step}, iteration {state.iteration}, "
                    f"{self.size / 1e6:.1f} MB in {self.seconds:.2f} s"
                )
            return True
        self.failed += 1
        self._failures += 1
        sentence = f"{self.folder}: a checkpoint cannot be written ({reason})"
        if self._failures >= MOST_FAILURES:
            raise NotWritten(f"{sentence}, {MOST_FAILURES} times in a row.")
        self._report(f"warning: {sentence}; older ones are kept. Free space.")
        return False

    def _header(self, state: State, contents: CheckpointContents) -> dict[str, Any]:
        """Everything that is not a table. Collective."""
        numbers = numbers_of(state)
        broken, wide = total_broken(self.model, contents.broken)
        if self.comm.rank > 0:
            return {}
        return self._fixed | {
            "written": datetime.now(UTC).isoformat(timespec="seconds"),
            "state": numbers,
            "broken_bonds": broken,
            "wide": wide,
            "failure": contents.books,
            "evaluations": contents.evaluations,
            "seconds": self.elapsed,
            "restarts": self.restarts,
        }

    def _open(self, header: dict[str, Any], state: State):
        """Bring results to the disk, note how far they are, and open the file. On rank 0."""
        from pdfem_mpi.results.checkpoint import Writer
        from pdfem_mpi.results.checkpoint_files import checkpoint_path, list_checkpoints

        faults.begin("flush")
        header["results"] = self._flush()
        self.folder.mkdir(exist_ok=True)
        if not self._number:
            self._number = max((number for number, _ in list_checkpoints(self.folder)), default=0)
        path = checkpoint_path(self.folder, self._number + 1)
        tables = self.layout.tables(header["broken_bonds"], header["wide"], state.fields)
        if self.turned is not None:
            tables[TURNED] = len(self.turned), 1, np.dtype("<u8")
        return Writer(path, tables, job_name())


def remove_old(folder: Path, keep: int) -> None:
    """Remove all checkpoints but the newest ones; a file that cannot be removed stays."""
    from pdfem_mpi.results.checkpoint_files import rotate

    with contextlib.suppress(OSError):
        rotate(folder, keep)


def _finish(comm, writer, header: dict[str, Any], before: tuple[int, Exception | None]):
    """Finish the file on rank 0, whose work keeps all watchdogs quiet; its size, and what went wrong. Collective."""
    found = [before]

    def finish(beat):
        try:
            found.append((writer.finish(header, beat), None))
        except (OSError, RuntimeError) as error:
            found.append((before[0], error))

    on_root_beating(comm, finish if writer else lambda beat: None)
    return found[-1]


def take_over(start: RestartPoint, folder: Path) -> None:
    """Clean the folder of checkpoints for a run that goes on: torn files go, newer ones not used step aside."""
    from pdfem_mpi.results.checkpoint_files import remove_stale

    remove_stale(folder)
    for path, fate in start.passed:
        with contextlib.suppress(FileNotFoundError):
            os.replace(path, free_name(path, fate))


def origin_of(scene: Scene, share: Share) -> dict[str, Any]:
    """What a header says of the program, the computer and the scene."""
    keys = identity(scene, share)
    return {
        "program": "pdfem_mpi",
        "schema": FORMAT,
        **environment(),
        "python": platform.python_version(),
        "ranks": share.comm.size,
        "fingerprint": sha256(keys),
        "keys": keys,
    }


def numbers_of(state: State) -> dict[str, Any]:
    """What a header says of the state."""
    return {
        "step": state.step,
        "load_factor": float(state.load_factor),
        "iteration": state.iteration,
        "spent": state.spent,
        "fields": list(state.fields),
        "seconds": perf_counter() - state.began,
        "bounds": asdict(state.bounds),
        "program": {name: _plain(value) for name, value in state.program.items()},
    }


def job_name() -> str:
    """The batch system's number of this job, or this process'."""
    return os.environ.get("SLURM_JOB_ID") or str(os.getpid())


def _plain(value: Any) -> float | int | bool:
    return value.item() if isinstance(value, np.generic) else value
