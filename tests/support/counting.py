"""A communicator that counts what goes through it."""

from __future__ import annotations

from collections import Counter

import numpy as np


class CountingComm:
    """A communicator; knows how many reductions and messages went through, and the bytes of the largest.

    Attributes
    ----------
    calls : Counter
        By the name of the call.
    sent : int
        Bytes of messages from this rank to another.
    largest : int
        Bytes of the largest reduction.
    """

    def __init__(self, comm):
        self._comm = comm
        self.reset()

    def __getattr__(self, name):
        return getattr(self._comm, name)

    def reset(self) -> None:
        """Begin to count."""
        self.calls: Counter[str] = Counter()
        self.sent = self.largest = 0

    def Allreduce(self, own, total, op):
        self.calls["Allreduce"] += 1
        self.largest = max(self.largest, np.asarray(own).nbytes)
        self._comm.Allreduce(own, total, op=op)

    def Isend(self, buffer, rank, tag):
        self.calls["Isend"] += 1
        self.sent += np.asarray(buffer[0]).nbytes
        return self._comm.Isend(buffer, rank, tag)
