"""What ranks know of ids, asked of the rank that holds an id's block: no rank has a table of all ids.

The ids ``0 .. n - 1`` are dealt out in blocks, one to a rank.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from pdfem_mpi.parallel.comm import mpi, report_progress, sum_before, sum_integers

if TYPE_CHECKING:
    from mpi4py.MPI import Intracomm

Array = np.ndarray


class Exchange:
    """Rows that travel to ranks, and answers that come back. Collective, as its methods are.

    Parameters
    ----------
    comm : Intracomm
    to : int, shape (n,)
        Rank that each row goes to.

    Attributes
    ----------
    order : int64, shape (n,)
        The rows, rank by rank.
    out, into : int64, shape (n_ranks,)
        How many rows go to each rank, and come from it.
    """

    def __init__(self, comm: Intracomm, to: Array):
        self._comm = comm
        self.order = np.argsort(to, kind="stable")
        self.out = np.bincount(to, minlength=comm.size)
        self.into = np.empty_like(self.out)
        comm.Alltoall(self.out, self.into)

    @property
    def source(self) -> Array:
        """The rank of each row that comes here; int64."""
        return np.repeat(np.arange(len(self.into)), self.into)

    def there(self, rows: Array) -> Array:
        """The rows that come here, rank by rank; ``rows`` have the shape (n, ...)."""
        return self._send(rows[self.order], self.out, self.into)

    def back(self, rows: Array) -> Array:
        """Answers to the rows that this rank sent, in their order; ``rows`` answer those that came here."""
        answers = np.empty((len(self.order), *rows.shape[1:]), rows.dtype)
        answers[self.order] = self._send(rows, self.into, self.out)
        return answers

    def _send(self, rows: Array, out: Array, into: Array) -> Array:
        width = rows.dtype.itemsize * math.prod(rows.shape[1:])
        received = np.empty((int(into.sum()), *rows.shape[1:]), rows.dtype)
        byte = mpi().BYTE
        self._comm.Alltoallv([np.ascontiguousarray(rows), out * width, byte], [received, into * width, byte])
        report_progress()
        return received


def holders(comm: Intracomm, ids: Array, n: int) -> Array:
    """The rank that holds the block of each id; int64."""
    return ids // max(1, -(-n // comm.size))


@dataclass(frozen=True)
class Directory:
    """A number for each of some ids.

    Attributes
    ----------
    comm : Intracomm
    n : int
        Ids are below it.
    ids, values : int64, shape (n_here,)
        Of the block that this rank holds; ids rise.
    """

    comm: Intracomm
    n: int
    ids: Array
    values: Array

    @classmethod
    def of(cls, comm: Intracomm, ids: Array, values: Array, n: int) -> Directory:
        """Make it of what each rank knows, int64, shape (n_own,); an id that several ranks know has one value.

        Collective.
        """
        rows = Exchange(comm, holders(comm, ids, n)).there(np.column_stack([ids, values]))
        ids, first = np.unique(rows[:, 0], return_index=True)
        return cls(comm, n, ids, rows[first, 1])

    @classmethod
    def of_places(cls, comm: Intracomm, ids: Array, n: int) -> Directory:
        """The place of each id among those that ranks have, in rising order; several may have the same. Collective."""
        here = np.unique(Exchange(comm, holders(comm, ids, n)).there(ids))
        before = int(sum_before(comm, len(here)))
        return cls(comm, n, here, before + np.arange(len(here)))

    def count(self) -> int:
        """How many ids are known. Collective."""
        return int(sum_integers(self.comm, np.array([len(self.ids)]))[0])

    def ask(self, ids: Array) -> Array:
        """Values of ids in any order, -1 of those that nobody knows; int64. Collective."""
        exchange = Exchange(self.comm, holders(self.comm, ids, self.n))
        asked = exchange.there(ids)
        place = np.searchsorted(self.ids, asked)
        known = place < len(self.ids)
        known[known] = self.ids[place[known]] == asked[known]
        answers = np.full(len(asked), -1, np.int64)
        answers[known] = self.values[place[known]]
        return exchange.back(answers)
