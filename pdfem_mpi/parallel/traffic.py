"""What this rank sent to the others, and how long it waited for them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from mpi4py.MPI import Intracomm


@dataclass
class Traffic:
    """Counts of messages between neighbours and of reductions, and seconds in their calls.

    Attributes
    ----------
    messages, sent_bytes : int
        From this rank to its neighbours.
    reductions, largest_reduction : int
        Their number, and the bytes of the largest.
    waited : float
        Seconds until messages and reductions came through, of which some are their transport.
    """

    messages: int = 0
    sent_bytes: int = 0
    reductions: int = 0
    largest_reduction: int = 0
    waited: float = 0.0

    def add_reduction(self, size: int, seconds: float) -> None:
        """Count a reduction of so many bytes."""
        self.reductions += 1
        self.largest_reduction = max(self.largest_reduction, size)
        self.waited += seconds

    def clear(self) -> None:
        """Begin to count."""
        self.__dict__.update(vars(Traffic()))

    def copy(self) -> Traffic:
        """What was counted so far."""
        return replace(self)


#: Of this process.
TRAFFIC = Traffic()


def join(comm: Intracomm, own: Traffic, seconds: float, evaluations: int) -> dict[str, Any] | None:
    """Mean and largest of all ranks, an evaluation; None on one rank, and except on rank 0. Collective.

    Parameters
    ----------
    own : Traffic
    seconds : float
        In which it was counted.
    """
    row = own.messages, own.sent_bytes, own.reductions, own.largest_reduction, own.waited, seconds - own.waited
    table = comm.gather(row)
    if table is None or comm.size == 1:
        return None
    messages, sent, reductions, largest, waited, computed = np.array(table, float).T
    n = max(evaluations, 1)

    def shown(values: np.ndarray, digits: int) -> dict[str, float]:
        return {"mean": round(float(values.mean()), digits), "largest": round(float(values.max()), digits)}

    return {
        "messages_per_evaluation": shown(messages / n, 2),
        "bytes_per_evaluation": shown(sent / n, 0),
        "reductions_per_evaluation": round(float(reductions.max()) / n, 2),
        "largest_reduction_bytes": int(largest.max()),
        "seconds_computed": shown(computed, 6),
        "seconds_waited": shown(waited, 6),
        "imbalance": round(float(computed.max() / max(computed.mean(), 1e-9)), 4),
    }
