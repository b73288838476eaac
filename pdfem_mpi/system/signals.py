"""What signals ask of a run; for use before MPI and numpy load, so that none is missed while they do."""

from __future__ import annotations

import faulthandler
import os
import signal
import sys
import threading
from time import monotonic
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from mpi4py.MPI import Intracomm

EXIT_AT_ONCE = 70
#: Two signals within this many seconds are one: batch systems and launchers may both pass it on.
SAME_SIGNAL_SECONDS = 1.0
STOPS = (signal.SIGUSR1, signal.SIGTERM)


class Requests:
    """What signals ask of this process; installed once, as early as possible.

    SIGUSR1 and SIGTERM ask for a checkpoint and an end: a flag is set, which all ranks hear of at the next safe point.
    A second one, later than `SAME_SIGNAL_SECONDS`, ends all ranks at once with exit code 70. SIGUSR2 prints the
    stacks of all threads.

    A handler in Python would wait for the main thread, which may wait for another rank for ever: a thread of its own
    hears of signals instead.

    Attributes
    ----------
    stop : bool
    comm : Intracomm or None
        Set when MPI has started.
    """

    def __init__(self) -> None:
        self.stop = False
        self.comm: Intracomm | None = None
        self._first = 0.0

    def install(self) -> None:
        """Take over the signals. In the main thread only."""
        heard, told = os.pipe()
        os.set_blocking(told, False)
        signal.set_wakeup_fd(told, warn_on_full_buffer=False)
        threading.Thread(target=self._listen, args=(heard,), name="signals", daemon=True).start()
        for number in STOPS:
            signal.signal(number, lambda *_: None)
        try:
            faulthandler.register(signal.SIGUSR2, all_threads=True)
        except (ValueError, OSError, AttributeError):  # standard error is not a file
            signal.signal(signal.SIGUSR2, signal.SIG_IGN)

    def _listen(self, heard: int) -> None:
        while numbers := os.read(heard, 16):
            for number in numbers:
                if number in STOPS:
                    self.hear(number)

    def hear(self, number: int) -> None:
        """Note the first signal; end all ranks at the second."""
        now = monotonic()
        if not self.stop:
            self._first, self.stop = now, True
        elif now - self._first > SAME_SIGNAL_SECONDS:
            sys.stderr.write(f"pdfem: {signal.Signals(number).name} a second time: ending at once\n")
            sys.stderr.flush()
            if self.comm is None:
                os._exit(EXIT_AT_ONCE)
            self.comm.Abort(EXIT_AT_ONCE)
