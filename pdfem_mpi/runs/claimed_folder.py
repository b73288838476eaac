"""A run folder that this start has claimed: the lock, where the run begins, and the record of this start."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path
from time import perf_counter

from pdfem_mpi.deck.table import SceneError
from pdfem_mpi.deck.toml import read_deck, write_deck
from pdfem_mpi.results.ownership import DECK, RESULTS, SUMMARY, Written, free_name, refuse_deck, refuse_folder
from pdfem_mpi.results.starts import Starts
from pdfem_mpi.runs.checkpoints import take_over
from pdfem_mpi.runs.restart_point import FOLDER as CHECKPOINTS
from pdfem_mpi.runs.restart_point import Refused, RunOptions, choose_start
from pdfem_mpi.system.exit_codes import EXIT_NOT_WRITTEN, EXIT_USAGE
from pdfem_mpi.system.files import replacing
from pdfem_mpi.system.lock import Lock, Locked


class ClaimedFolder:
    """A run folder that this start has locked. On rank 0 alone.

    Parameters
    ----------
    out : Path
        The run folder.
    deck_text : str
        The deck as it is run.
    overwrite : bool
    options : RunOptions
    ranks : int
    started : float
        Time of ``perf_counter`` at which this start began.

    Attributes
    ----------
    start : RestartPoint
        Where the run begins.
    written : Written
        The files that this program wrote here.
    starts : Starts
        All starts so far.

    Raises
    ------
    Refused
        Nothing was changed.
    OSError
        The folder cannot be written.
    """

    def __init__(self, out: Path, deck_text: str, overwrite: bool, options: RunOptions, ranks: int, started: float):
        self.out, self.deck_text, self._started = out, deck_text, started
        if refusal := refuse_folder(out) or self._refuse_deck(options.deck):
            raise Refused(EXIT_USAGE, refusal)
        self._made = [path for path in (out, *out.parents) if not path.exists()]
        self._new_deck = self._committed = False
        out.mkdir(parents=True, exist_ok=True)
        self.written = Written(out)
        try:
            self._lock = Lock(out, os.environ.get("SLURM_JOB_ID", ""), options.steal_lock)
        except Locked as error:
            self._remove_made()
            raise Refused(EXIT_NOT_WRITTEN, str(error)) from None
        try:
            self.start = choose_start(out, options.resume, overwrite)
            if self._lock.note:
                self.start.notes.insert(0, self._lock.note)
            self._note_beginning(overwrite, ranks)
        except (Refused, OSError):
            self.release()
            raise
        options.requests.clean_up += [self._lock.release, lambda: self.end(None)]

    def _note_beginning(self, overwrite: bool, ranks: int) -> None:
        """Record that this start has begun, so that later ones know of it even if it is killed."""
        start, header = self.start, self.start.header
        self.starts = Starts(self.out, overwrite, (header.get("seconds", 0.0), header.get("restarts", [])))
        restart = None
        if start.path or not self.starts.is_first:
            state = header.get("state", {"step": 0, "iteration": 0})
            restart = {
                "checkpoint": start.path.name if start.path else None,
                "step": state["step"],
                "iteration": state["iteration"],
                "ranks": ranks,
                "seconds_before": self.starts.seconds_before,
                "notes": start.notes,
            }
        self.written.begin()
        self.starts.begin(restart)
        start.seconds_before, start.restarts = self.starts.seconds_before, self.starts.restarts
        if not (self.out / DECK).exists() and not overwrite:
            self._new_deck = True
            self.write_deck()

    def commit(self) -> None:
        """Make room for what this start writes: from now on it counts, however it ends."""
        self.written.remove(SUMMARY)
        if self.start.path:
            take_over(self.start, self.out / CHECKPOINTS)
        else:
            self.written.remove(*RESULTS)
            self.written.remove_checkpoints(self.out / CHECKPOINTS)
        self.written.remove("figures/", "lines/")
        self._committed = True
        self.starts.commit()
        self.write_deck()

    def withdraw(self) -> None:
        """Remove the record of a start that was refused after all."""
        if self._committed:
            self.end(None)
            return
        self.starts.withdraw()
        if self._new_deck:
            with suppress(OSError):
                (self.out / DECK).unlink()
        self.written.forget()

    def release(self) -> None:
        """Unlock the folder, and remove it if it was made for a run that was refused."""
        self._lock.release()
        self._remove_made()

    def _remove_made(self) -> None:
        for path in self._made:
            with suppress(OSError):
                path.rmdir()

    def end(self, code: int | None, did_nothing: bool = False) -> float:
        """Record that this start ends, without a code if it was cut short; return its seconds."""
        seconds = perf_counter() - self._started
        self.starts.end(seconds, code, did_nothing, self.start.notes)
        return seconds

    def write_deck(self) -> None:
        """Write the deck as it is run; one that a person wrote stays if it says the same, else it steps aside."""
        path, text = self.out / DECK, self.deck_text.encode()
        before = None
        with suppress(FileNotFoundError):
            before = path.read_bytes()
        if before is not None and before != text and not self.written.wrote_deck(before):
            if self._says_the_same(path):
                return
            aside = free_name(path)
            os.rename(path, aside)
            self.start.notes.append(f"{DECK} was not as this program had written it: it is now {aside.name}")
        self.written.note_deck(text)
        if before != text:
            with replacing(path) as temporary:
                temporary.write_bytes(text)

    def _refuse_deck(self, deck: Path | None) -> str | None:
        """Why this deck must not be run in this folder."""
        return refuse_deck(self.out, deck, self._says_the_same(self.out / DECK)) if deck else None

    def _says_the_same(self, path: Path) -> bool:
        """Whether a deck is that of this run, however it is written."""
        with suppress(SceneError):
            return write_deck(read_deck(path)) == self.deck_text
        return False
