"""What signals ask of a run; for use before MPI and numpy load, so that none is missed while they do."""

from __future__ import annotations

import contextlib
import faulthandler
import os
import signal
import sys
import threading
import time
from collections.abc import Callable
from time import monotonic
from typing import TYPE_CHECKING

from pdfem_mpi.system.exit_codes import EXIT_INTERNAL_ERROR, EXIT_STOPPED
from pdfem_mpi.system.launcher import launcher_variable

if TYPE_CHECKING:
    from mpi4py.MPI import Intracomm

#: Two signals within this many seconds are one: batch systems and launchers may both pass it on.
SAME_SIGNAL_SECONDS = 1.0
STOPS = (signal.SIGUSR1, signal.SIGTERM, signal.SIGINT)
#: A run that was asked to stop before its load program began is ended when it has not found the time by itself.
SET_UP_SECONDS = 3.0


class Requests:
    """What signals ask of this process; installed once, as early as possible.

    SIGUSR1, SIGTERM and SIGINT (Ctrl-C) ask for a checkpoint and an end: a flag is set, which all ranks learn of at the
    next safe point. A second one, later than `SAME_SIGNAL_SECONDS`, ends all ranks at once with exit code 70. SIGUSR2
    prints the stacks of all threads.

    While the deck is read and the run is set up there is nothing to keep: where the ranks do not come to the next look
    at the flag within `SET_UP_SECONDS`, all are ended with exit code 75.

    A handler in Python would wait for the main thread, which may wait for another rank for ever: a thread of its own
    receives the signals instead.

    Attributes
    ----------
    stop : bool
    comm : Intracomm or None
        Set when MPI has started.
    setting_up : bool
        Signals are taken over, and the load program has not begun.
    clean_up : list of callables
        What to do before all ranks are ended; short, and of no other rank.
    """

    def __init__(self) -> None:
        self.stop = False
        self.comm: Intracomm | None = None
        self.setting_up = False
        self.clean_up: list[Callable[[], None]] = []
        self._first = 0.0
        self._launched = launcher_variable() is not None

    def stop_in_set_up(self) -> int:
        """This rank's wish to stop before the load program begins, to be added over all ranks."""
        return int(self.stop)

    def install(self) -> None:
        """Take over the signals. In the main thread only."""
        self.setting_up = True
        reading, writing = os.pipe()
        os.set_blocking(writing, False)
        signal.set_wakeup_fd(writing, warn_on_full_buffer=False)
        threading.Thread(target=self._listen, args=(reading,), name="signals", daemon=True).start()
        for number in STOPS:
            # what a shell starts in the background without job control is not meant by a Ctrl-C
            if number != signal.SIGINT or signal.getsignal(number) != signal.SIG_IGN:
                signal.signal(number, lambda *_: None)
        try:
            faulthandler.register(signal.SIGUSR2, all_threads=True)
        except (ValueError, OSError, AttributeError):  # standard error is not a file
            signal.signal(signal.SIGUSR2, signal.SIG_IGN)

    @staticmethod
    def come_too_late() -> None:
        """Ignore a request to stop from here on: nothing is left to keep. In the main thread only.

        Python takes its handlers away while it ends, and a signal would end the process by itself, with an exit code
        that says so.
        """
        for number in (signal.SIGUSR1, signal.SIGTERM):
            signal.signal(number, signal.SIG_IGN)

    def _listen(self, reading: int) -> None:
        while numbers := os.read(reading, 16):
            for number in numbers:
                if number in STOPS:
                    self.handle(number)

    def handle(self, number: int) -> None:
        """Note the first signal; end all ranks at the second."""
        now = monotonic()
        name = signal.Signals(number).name
        if not self.stop:
            self._first, self.stop = now, True
            if self.setting_up:
                threading.Thread(target=self._end_set_up, args=(name,), name="end of set-up", daemon=True).start()
        elif now - self._first > SAME_SIGNAL_SECONDS:
            self._end(EXIT_INTERNAL_ERROR, f"{name} a second time: ending at once")

    def _end_set_up(self, name: str) -> None:
        """End a run that is being set up, if it does not end by itself."""
        time.sleep(SET_UP_SECONDS)
        if self.setting_up:
            self._end(EXIT_STOPPED, f"{name} before the first step: ending. The same command starts again")

    def _end(self, code: int, words: str) -> None:
        """End all ranks."""
        sys.stderr.write(f"pdfem: {words}\n")
        sys.stderr.flush()
        for action in self.clean_up:
            with contextlib.suppress(Exception):
                action()
        if self.comm is not None and (self._launched or self.comm.size > 1):
            time.sleep(0.1)  # a launcher that ends may drop the words that it has not passed on
            self.comm.Abort(code)
        elif self._launched:
            # when one rank ends with an exit code, a launcher lets the others wait for ever in the start of MPI
            os.kill(os.getpid(), signal.SIGKILL)
        else:  # without clean-up: a compiler that runs in another thread would stumble over it
            os._exit(code)
