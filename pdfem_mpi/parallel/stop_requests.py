"""When a run writes a checkpoint, and when it stops with one. Decided by all ranks alike, at safe points only.

A signal sets a flag and nothing else. Flags of all ranks, and what rank 0's clock says, travel as two more
integers in a reduction that the solvers make anyway: all ranks read the same sums and decide alike. A safe point is
where the state is whole: between load steps, and in relaxation after each step of central differences. No clock
decides a number of the results, only when a file is written; the clock is one that cannot be set back.
"""

from __future__ import annotations

from time import monotonic
from typing import TYPE_CHECKING, Any

import numpy as np

from pdfem_mpi.parallel.comm import broadcast, sum_integers
from pdfem_mpi.system.signals import Requests

if TYPE_CHECKING:
    from mpi4py.MPI import Intracomm

#: A checkpoint costs this fraction of the run's time at most, however often it is asked for by the clock.
LARGEST_SHARE = 0.05
#: Seconds that a checkpoint is taken to cost before one was written.
FIRST_COST = 1.0


class Stopped(Exception):
    """The run was asked to stop, and its state is kept. Raised on all ranks alike.

    Attributes
    ----------
    kept : bool
        A checkpoint of this very state was written.
    asked : bool
        By a signal, not by the clock.
    """

    def __init__(self, reason: str, kept: bool, asked: bool = True):
        self.kept, self.asked = kept, asked
        super().__init__(reason)


class NoStopRequests:
    """Never a stop or a checkpoint: for solvers that are called without a run around them."""

    def votes(self) -> tuple[int, int]:
        """No votes."""
        return 0, 0

    def act(self, votes: Any, state: Any) -> None:
        """Go on."""

    def between(self, state: Any) -> None:
        """Go on."""


NO_STOP_REQUESTS = NoStopRequests()


class StopRequests:
    """When to keep a checkpoint, and when to stop.

    Parameters
    ----------
    comm : Intracomm
    requests : Requests
        What signals ask.
    checkpoints : CheckpointWriter
        Its ``save(state) -> bool`` and ``remember(state)`` are called, collectively.
    settings : scene.Checkpoint
    end : float or None
        Time of ``monotonic`` on rank 0 at which the run must be over.

    Attributes
    ----------
    cost : float
        Seconds that the last checkpoint took, a guess until one was written.
    """

    def __init__(self, comm: Intracomm, requests: Requests, checkpoints: Any, settings: Any, end: float | None = None):
        self.comm, self.requests, self.checkpoints, self.settings, self.end = comm, requests, checkpoints, settings, end
        self.cost = FIRST_COST
        self._last = monotonic()
        self._kept: tuple[float, ...] | None = None
        self._step = 0

    def votes(self) -> tuple[int, int]:
        """This rank's votes, to be added over all ranks: to stop, and to keep a checkpoint."""
        if self.comm.rank > 0:
            return int(self.requests.stop), 0
        now = monotonic()
        stop = self.requests.stop or (self.end is not None and now > self.end - 2.0 * self.cost)
        return int(stop), int(now - self._last > max(60.0 * self.settings.minutes, self.cost / LARGEST_SHARE))

    def act(self, votes: Any, state: Any) -> None:
        """Do what the summed votes say, at a safe point of relaxation. Collective.

        Raises
        ------
        Stopped
            On all ranks.
        """
        stop, save = (int(vote) for vote in votes)
        if stop:
            self._stop(state)
        elif save or _due(state.iteration, self.settings.iterations) or self._steps_due(state):
            self.save(state)

    def between(self, state: Any) -> None:
        """A safe point between load steps, events or batches: ask all ranks and act. Collective.

        Raises
        ------
        Stopped
            On all ranks.
        """
        stop, save = (int(vote) for vote in sum_integers(self.comm, np.array(self.votes())))
        self.checkpoints.remember(state)
        if stop:
            self._stop(state)
        elif save or self._steps_due(state):
            self.save(state)

    def resumed(self, state: Any) -> None:
        """The state is that of a checkpoint: none is written until it has moved on."""
        self._kept, self._step = place_of(state), state.step

    def save(self, state: Any) -> bool:
        """Keep a checkpoint unless this very state has one. Collective."""
        if self._kept == place_of(state):
            return True  # not twice
        start = monotonic()
        kept = self.checkpoints.save(state)
        self._last = monotonic()
        self.cost, self._step = self._last - start, state.step
        if kept:
            self._kept = place_of(state)
        return kept

    def _steps_due(self, state: Any) -> bool:
        return self.settings.steps is not None and state.step >= self._step + self.settings.steps

    def _stop(self, state: Any) -> None:
        asked = broadcast(self.comm, self.end is None or monotonic() <= self.end - 2.0 * self.cost)
        reason = "asked to stop" if asked else "the time allowed by --max-hours is used up"
        raise Stopped(reason, self.save(state), asked)


def _due(count: int, every: int | None) -> bool:
    return every is not None and count > 0 and count % every == 0


def place_of(state: Any) -> tuple[float, ...]:
    """Where a run is: no two states of one run have the same, and all ranks agree."""
    return state.step, state.iteration, state.spent, *state.program.values()
