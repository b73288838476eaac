"""The watchdog: no word from the others for too long ends all ranks, with the stacks of those that hang in a file."""

from __future__ import annotations

import faulthandler
import os
import sys
import threading
from collections import deque
from time import monotonic
from typing import TYPE_CHECKING, Any

from pdfem_mpi.parallel.comm import observing_progress
from pdfem_mpi.system.exit_codes import EXIT_INTERNAL_ERROR

if TYPE_CHECKING:
    from mpi4py.MPI import Intracomm


def patience() -> float:
    """Seconds without progress that a run is given: 300, or what PDFEM_WATCHDOG_SECONDS says."""
    return float(os.environ.get("PDFEM_WATCHDOG_SECONDS", "300"))


class NoWatchdog:
    """A watchdog that watches nothing."""

    def __enter__(self) -> NoWatchdog:
        return self

    def __exit__(self, *exception: Any) -> None:
        pass


class Watchdog:
    """A thread that ends all ranks when this one has heard nothing from the others for too long.

    Within it, every sum or word that comes through from the others is a beat (`parallel.comm.observing_progress`). It
    dumps the stacks of all threads first. Where even the thread cannot run, because something holds Python's lock, the
    timer of `faulthandler` ends the process after twice the time.

    Parameters
    ----------
    comm : Intracomm
    hang : str or Path
        The file of the dump.
    seconds : float
        Least time without a beat; ten times the longest of the last beats' distances where that is longer.
    """

    BEATS = 100
    FACTOR = 10.0

    def __init__(self, comm: Intracomm, hang: Any, seconds: float = 300.0):
        self.comm, self.hang, self.seconds = comm, hang, seconds
        self._last = monotonic()
        self._distances: deque[float] = deque(maxlen=self.BEATS)
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._watch, name="watchdog", daemon=True)
        self._armed = 0.0
        self._observing = observing_progress(self.beat)

    def __enter__(self) -> Watchdog:
        self.beat()
        self._observing.__enter__()
        self._thread.start()
        return self

    def __exit__(self, *exception: Any) -> None:
        self._observing.__exit__(*exception)
        self._over.set()
        self._thread.join()
        faulthandler.cancel_dump_traceback_later()

    def beat(self) -> None:
        """There is progress."""
        now = monotonic()
        self._distances.append(now - self._last)
        self._last = now
        if now - self._armed > 0.25 * self.seconds:
            self._armed = now
            faulthandler.dump_traceback_later(2.0 * self.limit(), exit=True)

    def limit(self) -> float:
        """Seconds without a beat that are too many."""
        return max(self.seconds, self.FACTOR * max(list(self._distances), default=0.0))

    def _watch(self) -> None:
        while not self._over.wait(min(1.0, 0.1 * self.seconds)):
            silent = monotonic() - self._last
            if silent > self.limit():
                self._end(silent)

    def _end(self, silent: float) -> None:
        try:
            with open(self.hang, "w", encoding="utf-8") as file:
                faulthandler.dump_traceback(file, all_threads=True)
            where = f"; the stacks are in {self.hang}"
        except OSError:
            where = ""
        sys.stderr.write(f"[rank {self.comm.rank}] no progress for {silent:.0f} s: ending all ranks{where}\n")
        sys.stderr.flush()
        self.comm.Abort(EXIT_INTERNAL_ERROR)
