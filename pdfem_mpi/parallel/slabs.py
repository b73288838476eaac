"""Tables of the whole body on their way to rank 0 and back, a slab of global ids at a time."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

import numpy as np

from pdfem_mpi.parallel.comm import agree, broadcast, mpi, report_progress, sum_integers
from pdfem_mpi.parallel.directory import Directory, Exchange

if TYPE_CHECKING:
    from mpi4py.MPI import Intracomm

SLAB = 65536  # global ids that travel to rank 0 at a time: its buffers do not grow with the problem
PAIR_SLAB = 4096  # the same for pairs of ids, of which an id may have hundreds

Array = np.ndarray


def gather_rows(comm: Intracomm, global_ids: Array, rows: Array, n_global: int) -> Array | None:
    """Collect rows from their owners, in the order of global ids, on rank 0. Collective.

    Parameters
    ----------
    global_ids : int64, shape (n_owned,)
        In any order; each of ``0 .. n_global - 1`` on exactly one rank.
    rows : any dtype without Python objects, shape (n_owned, ...)
        The same dtype and row shape on all ranks, also where ``n_owned = 0``. May be a strided view.
    n_global : int

    Returns
    -------
    same dtype, shape (n_global, ...); None except on rank 0

    Raises
    ------
    ValueError
        On all ranks: rows of different kinds, or an id that is missing, out of range or owned twice.
    """
    table = None
    for first, slab in gather_slabs(comm, global_ids, rows, n_global):
        if comm.rank == 0:
            if table is None:
                table = np.empty((n_global, *slab.shape[1:]), slab.dtype)
            table[first : first + len(slab)] = slab
    return table


def gather_slabs(comm: Intracomm, global_ids: Array, rows: Array, n_global: int) -> Iterator[tuple[int, Array | None]]:
    """Collect rows on rank 0 as `gather_rows` does, a slab of global ids at a time. Collective at every turn.

    All ranks must come to the end: an error of the rank that writes the slabs is raised after it.

    Yields
    ------
    first : int
        The slab's first global id.
    slab : same dtype as ``rows``, shape (n_slab, ...)
        Rows ``first .. first + n_slab - 1``; None except on rank 0. With no rows at all, one empty slab.

    Raises
    ------
    ValueError
        As in `gather_rows`; for ids that are missing or owned twice at the end.
    """
    ids, rows = np.asarray(global_ids, dtype=np.int64), np.asarray(rows)
    fits = len(rows) == len(ids) and not rows.dtype.hasobject
    kinds = dict.fromkeys(comm.allgather((rows.dtype.str, rows.shape[1:], fits)))
    if len(kinds) > 1 or not all(fits for _, _, fits in kinds):
        raise ValueError(f"gather_rows: (dtype, row shape, numbers and one id per row) by rank: {list(kinds)}.")
    order = np.argsort(ids, kind="stable")
    slabs = np.minimum(np.arange(0, max(n_global, 1) + SLAB, SLAB), n_global)
    edges = np.searchsorted(ids, slabs, sorter=order)
    counts = comm.gather(np.diff(edges)) or [np.zeros(len(edges), int)]
    width = rows.dtype.itemsize * math.prod(rows.shape[1:])
    problems: list[str] = []
    for slab in range(len(edges) - 1):
        own = order[edges[slab] : edges[slab + 1]]
        n_rows = np.array([count[slab] for count in counts])
        slab_ids = np.empty(n_rows.sum(), np.int64)
        slab_rows = np.empty((len(slab_ids), *rows.shape[1:]), rows.dtype)
        comm.Gatherv(ids[own], [slab_ids, n_rows])
        comm.Gatherv([np.ascontiguousarray(rows[own]), mpi().BYTE], [slab_rows, n_rows * width, mpi().BYTE])
        report_progress()
        first, n_slab = int(slabs[slab]), int(slabs[slab + 1] - slabs[slab])
        if comm.rank > 0:
            yield first, None
            continue
        table = np.empty((n_slab, *rows.shape[1:]), rows.dtype)
        table[slab_ids - first] = slab_rows
        n_owners = np.bincount(slab_ids - first, minlength=n_slab)
        wrong = np.flatnonzero(n_owners != 1)[: max(0, 3 - len(problems))]
        problems += [f"id {first + i} has {n_owners[i]} owners" for i in wrong]
        del slab_ids, slab_rows  # while the slab is worked on, there is one of it
        yield first, table
    if edges[-1] - edges[0] < len(ids):
        problems.append(f"rank {comm.rank} has ids outside 0 .. {n_global - 1}")
    if problems := agree(comm, problems):
        raise ValueError(f"gather_rows: {'; '.join(problems)}. Pass each id on the one rank that owns it.")


def scatter_slabs(
    comm: Intracomm, global_ids: Array, n_global: int, read: Callable[[int, int], Array], like: Array
) -> Array:
    """Return this rank's rows of a table that rank 0 reads slab by slab: the way back of `gather_slabs`. Collective.

    Parameters
    ----------
    global_ids : int64, shape (n_rows,)
        The rows wanted here, in any order; other ranks may want the same.
    n_global : int
    read : callable
        ``read(first, last)`` gives rows ``first .. last - 1`` on rank 0; it is not called elsewhere.
    like : shape (0, ...)
        An array of the rows' dtype and shape.

    Raises
    ------
    OSError
        On all ranks, with rank 0's words.
    """
    ids = np.asarray(global_ids, dtype=np.int64)
    order = np.argsort(ids, kind="stable")
    own = np.empty((len(ids), *like.shape[1:]), like.dtype)
    for first in range(0, n_global, SLAB):
        last = min(first + SLAB, n_global)
        slab, messages = np.empty((last - first, *like.shape[1:]), like.dtype), []
        if comm.rank == 0:
            try:
                slab[:] = read(first, last)
            except OSError as error:
                messages = [str(error)]
        if messages := broadcast(comm, messages):
            raise OSError(messages[0])
        comm.Bcast([slab, mpi().BYTE])
        here = slice(*np.searchsorted(ids, (first, last), sorter=order))
        own[order[here]] = slab[ids[order[here]] - first]
    return own


def gather_pairs(comm: Intracomm, pairs: Array, n_global: int) -> Iterator[Array | None]:
    """Collect pairs of ids on rank 0 in lexicographic order, a range of first ids at a time. Collective at every turn.

    Parameters
    ----------
    pairs : int64, shape (n, 2 or more)
        In any order; the first id of each is in ``0 .. n_global - 1``. Further columns go with them.

    Yields
    ------
    int64, shape (m, 2 or more); None except on rank 0
        Ranges without a pair are left out.
    """
    if not sum_integers(comm, np.array([len(pairs)]))[0]:
        return
    own = pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))]
    edges = np.searchsorted(own[:, 0], np.arange(0, n_global + PAIR_SLAB, PAIR_SLAB))
    numbers = np.diff(edges)
    total = sum_integers(comm, numbers)
    counts = comm.gather(numbers) or [np.zeros(len(numbers), int)]
    for slab in np.flatnonzero(total):
        n_rows = np.array([count[slab] for count in counts])
        found = np.empty((total[slab] if comm.rank == 0 else 0, own.shape[1]), np.int64)
        comm.Gatherv(own[edges[slab] : edges[slab + 1]], [found, own.shape[1] * n_rows])
        report_progress()
        yield found[np.lexsort((found[:, 1], found[:, 0]))] if comm.rank == 0 else None


def redistribute(comm: Intracomm, global_ids: Array, rows: Array, wanted: Array, n_global: int) -> Array:
    """Rows of a table whose rows lie on other ranks than they are wanted on. Collective.

    Parameters
    ----------
    global_ids : int64, shape (n,)
        Of the rows here, each on one rank; not all of ``0 .. n_global - 1`` need be there.
    rows : shape (n, ...)
        The same dtype and row shape on all ranks.
    wanted : int64, shape (m,)
        Ids of the rows wanted here, each once; other ranks may want the same.

    Returns
    -------
    same dtype, shape (m, ...)

    Raises
    ------
    ValueError
        On all ranks: an id that no rank has.
    """
    owner = Directory.of(comm, global_ids, np.full(len(global_ids), comm.rank), n_global).ask(wanted)
    if problems := agree(comm, [f"id {k} has no owner" for k in wanted[owner < 0][:3]]):
        raise ValueError(f"redistribute: {'; '.join(problems)}.")
    exchange, order = Exchange(comm, owner), np.argsort(global_ids, kind="stable")
    asked = exchange.there(wanted)
    return exchange.back(rows[order[np.searchsorted(global_ids, asked, sorter=order)]])
