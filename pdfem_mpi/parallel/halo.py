"""The halo: copies of other ranks' blocks (ghosts), refreshed from their owners and added back to them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from time import perf_counter
from typing import TYPE_CHECKING, Any

import numpy as np

from pdfem_mpi.parallel.comm import Array, agree, mpi
from pdfem_mpi.parallel.directory import Exchange
from pdfem_mpi.parallel.traffic import TRAFFIC

if TYPE_CHECKING:
    from mpi4py.MPI import Intracomm

N_TAG_PAIRS = 16000  # two tags a halo, used again after so many halos; MPI promises tags up to 32767


@dataclass(frozen=True)
class Rows:
    """Local rows that travel, neighbour by neighbour."""

    index: Array | slice  # rows of the local array
    parts: list[tuple[int, slice]]  # neighbour and its share of ``index``
    n: int


@dataclass(frozen=True)
class Buffers:
    """Contiguous copies of the rows that travel, of one size, and the calls that post their messages."""

    lent: Array
    ghosts: Array
    forward: list[Callable[[], Any]]
    reverse: list[Callable[[], Any]]


class Halo:
    """Exchange of ghost rows with the neighbouring ranks; made by :func:`build_halo`.

    Arrays have the local blocks (owned, then ghosts) on their first axis; further axes, dtype and strides are
    free, so a view of some rows of a larger table will do. Calls are collective among neighbours.

    A start copies the rows that travel; the matching finish writes those that arrived. Exchanges of several
    halos, or of several kinds of row (dtype and shape) in one halo, may be under way together; those of one
    halo and direction are started in the same order on all ranks.

    Attributes
    ----------
    n_owned, n_ghost, n_lent : int
        Blocks of this rank, copies of others' blocks, and copies of its blocks on other ranks.
    neighbours : tuple of int
        Ranks that messages are exchanged with.
    """

    n_built = 0  # agreed by the ranks of each build_halo, so no two halos of a communicator share a tag

    def __init__(self, comm: Intracomm, tag: int, n_owned: int, lent: Rows, ghosts: Rows):
        self.n_owned, self.n_ghost, self.n_lent = n_owned, ghosts.n, lent.n
        self.neighbours = tuple(sorted({rank for rank, _ in lent.parts + ghosts.parts}))
        self._comm, self._tag, self._lent, self._ghosts = comm, tag, lent, ghosts
        self._mpi = mpi()
        self._buffers: dict[tuple, list[Buffers]] = {}  # not under way, by bytes of an entry and shape of a row
        self._under_way: dict[tuple, tuple[str, list[Any], Buffers]] = {}

    def scatter_forward(self, a: Array) -> None:
        """Overwrite the ghost rows of ``a``, shape (n_owned + n_ghost, ...), by the rows of their owners."""
        self.start_forward(a)
        self.finish_forward(a)

    def scatter_reverse(self, a: Array) -> None:
        """Add the ghost rows of ``a``, shape (n_owned + n_ghost, ...), to the rows of their owners.

        The transpose of ``scatter_forward``; ghost rows stay as they are. Integers add exactly in any order;
        floats are added in the order of the neighbours' ranks.
        """
        self.start_reverse(a)
        self.finish_reverse(a)

    def shared(self) -> list[tuple[Array, Array]]:
        """For each of the neighbours: the owned rows that it holds copies of, and the ghosts that it owns."""
        lent, ghosts = dict(self._lent.parts), dict(self._ghosts.parts)
        places, nothing = np.arange(self.n_owned + self.n_ghost)[self._ghosts.index], slice(0)
        return [
            (self._lent.index[lent.get(rank, nothing)], places[ghosts.get(rank, nothing)]) for rank in self.neighbours
        ]

    def swap(self, told: list[Array]) -> Array:
        """Numbers of the ghosts, float64, shape (n_ghost,), that their owners tell each neighbour apart.

        Parameters
        ----------
        told : list of float64 arrays
            For each of the neighbours, of the owned rows that it holds copies of, in the order of `shared`.
        """
        buffers = self._allocate(np.dtype(float), ())
        by_rank = dict(zip(self.neighbours, told, strict=True))
        for rank, part in self._lent.parts:
            buffers.lent[part] = by_rank[rank]
        self._mpi.Request.Waitall([post() for post in buffers.forward])
        result = np.empty(self.n_owned + self.n_ghost)
        result[self._ghosts.index] = buffers.ghosts
        return result[self.n_owned :]

    def scatter_smallest(self, a: Array) -> None:
        """Lower the rows of owners to the smallest of their copies, entry by entry, then overwrite the copies."""
        self.start_reverse(a)
        received = self._finish(a, "reverse")
        for _, part in self._lent.parts:
            index = self._lent.index[part]
            a[index] = np.minimum(a[index], received[part])
        self.scatter_forward(a)

    def start_forward(self, a: Array) -> None:
        """Copy the owned rows of ``a`` that neighbours hold as ghosts, and send them off."""
        self._start(a, "forward")

    def finish_forward(self, a: Array) -> None:
        """Wait for the ghost rows and overwrite those of ``a``."""
        a[self._ghosts.index] = self._finish(a, "forward")

    def start_reverse(self, a: Array) -> None:
        """Copy the ghost rows of ``a``, and send them off to their owners."""
        self._start(a, "reverse")

    def finish_reverse(self, a: Array) -> None:
        """Wait for the rows that neighbours hold as ghosts and add them to the owned rows of ``a``."""
        received = self._finish(a, "reverse")
        for _, part in self._lent.parts:  # one by one: two neighbours may hold the same row
            a[self._lent.index[part]] += received[part]

    def test(self) -> None:
        """Let messages progress; to be called now and then between a start and its finish."""
        for _, requests, _ in self._under_way.values():
            self._mpi.Request.Testall(requests)

    def _start(self, a: Array, direction: str) -> None:
        """Copy the rows of ``a`` that travel and post their messages."""
        kind = (a.dtype, a.shape[1:])
        if len(a) != self.n_owned + self.n_ghost:
            raise ValueError(f"Halo: {len(a)} rows for {self.n_owned} owned and {self.n_ghost} ghost blocks.")
        if kind in self._under_way:
            raise RuntimeError(f"Halo: finish the exchange of rows {kind} before starting another.")
        free = self._buffers.setdefault((a.itemsize, a.shape[1:]), [])  # integers take what floats have left
        buffers = free.pop() if free else self._allocate(*kind)
        forward = direction == "forward"
        index, out = (self._lent.index, buffers.lent) if forward else (self._ghosts.index, buffers.ghosts)
        out = out.view(a.dtype)
        if a.flags.c_contiguous and not isinstance(index, slice):
            np.take(a, index, axis=0, out=out, mode="clip")  # twice as fast; would copy all of a strided view
        else:
            out[...] = a[index]
        TRAFFIC.messages += len(self._lent.parts if forward else self._ghosts.parts)
        TRAFFIC.sent_bytes += out.nbytes
        self._under_way[kind] = direction, [post() for post in getattr(buffers, direction)], buffers

    def _finish(self, a: Array, direction: str) -> Array:
        """Wait for the exchange of the rows of ``a`` and return those that arrived, until the next start."""
        kind = (a.dtype, a.shape[1:])
        started, requests, buffers = self._under_way.get(kind, (None, None, None))
        if started != direction:
            raise RuntimeError(f"Halo: no {direction} exchange of rows {kind} was started.")
        began = perf_counter()
        self._mpi.Request.Waitall(requests)
        TRAFFIC.waited += perf_counter() - began
        del self._under_way[kind]
        self._buffers[a.itemsize, a.shape[1:]].append(buffers)
        return (buffers.ghosts if direction == "forward" else buffers.lent).view(a.dtype)

    def _allocate(self, dtype: np.dtype, row_shape: tuple[int, ...]) -> Buffers:
        """Allocate buffers for one kind of row and prepare one message to and from each neighbour."""
        if dtype.hasobject:
            raise TypeError("Halo: rows of Python objects cannot be exchanged.")
        lent = np.empty((self.n_lent, *row_shape), dtype)
        ghosts = np.empty((self.n_ghost, *row_shape), dtype)

        def messages(call, buffer, rows, tag):
            return [partial(call, [buffer[part], self._mpi.BYTE], rank, tag) for rank, part in rows.parts]

        send, receive, tag = self._comm.Isend, self._comm.Irecv, self._tag
        forward = messages(receive, ghosts, self._ghosts, tag) + messages(send, lent, self._lent, tag)
        reverse = messages(receive, lent, self._lent, tag + 1) + messages(send, ghosts, self._ghosts, tag + 1)
        return Buffers(lent, ghosts, forward, reverse)


def build_halo(comm: Intracomm, owned_ids: Array, ghost_ids: Array, ghost_owner: Array) -> Halo:
    """Find out which rows travel between which ranks. Collective.

    Parameters
    ----------
    owned_ids : int64, shape (n_owned,)
        Global ids of the blocks of this rank, at local index 0, 1, ... in any order.
    ghost_ids : int64, shape (n_ghost,)
        Global ids of the ghosts, at local index n_owned, n_owned + 1, ... in any order; sorted by the rank of
        their owner they are copied faster.
    ghost_owner : int32, shape (n_ghost,)
        Rank that owns each ghost.

    Raises
    ------
    ValueError
        On all ranks, when a rank passes an id twice or a ghost that its owner does not own.
    """
    owned_ids, ghost_ids, owner = (np.asarray(a, dtype=np.int64) for a in (owned_ids, ghost_ids, ghost_owner))
    problems = []
    if len(np.unique(np.concatenate([owned_ids, ghost_ids]))) < len(owned_ids) + len(ghost_ids):
        problems.append(f"rank {comm.rank} passes an id twice")
    if owner.shape != ghost_ids.shape or ((owner < 0) | (owner >= comm.size)).any():
        problems.append(f"rank {comm.rank} does not name one of {comm.size} ranks as owner of each ghost")
    _raise_on_all(comm, problems)

    exchange = Exchange(comm, owner)
    asked_ids, order = exchange.there(ghost_ids), exchange.order
    by_id = np.argsort(owned_ids, kind="stable")
    place = np.searchsorted(owned_ids, asked_ids, sorter=by_id)
    foreign = np.setdiff1d(asked_ids, owned_ids)
    _raise_on_all(comm, [f"rank {comm.rank} is asked for id {i} but does not own it" for i in foreign[:3]])

    Halo.n_built = 1 + comm.allreduce(Halo.n_built, op=mpi().MAX)
    tag = 2 * (Halo.n_built % N_TAG_PAIRS) + 1
    grouped = np.array_equal(order, np.arange(len(order)))
    ghosts = slice(len(owned_ids), None) if grouped else order + len(owned_ids)
    lent = Rows(by_id[place], _parts(exchange.into), len(asked_ids))
    return Halo(comm, tag, len(owned_ids), lent, Rows(ghosts, _parts(exchange.out), len(ghost_ids)))


def _raise_on_all(comm: Intracomm, problems: list[str]) -> None:
    """Raise the problems of any rank on every rank. Collective."""
    if problems := agree(comm, problems):
        raise ValueError(f"build_halo: {'; '.join(problems)}.")


def _parts(counts: Array) -> list[tuple[int, slice]]:
    """Return (rank, slice) of each rank with a count; the slices follow one another."""
    ends = np.cumsum(counts)
    return [(int(rank), slice(ends[rank] - counts[rank], ends[rank])) for rank in np.flatnonzero(counts)]
