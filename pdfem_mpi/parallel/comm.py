"""The communicator: the one importer of mpi4py; sums in any order of ranks, errors agreed by all ranks.

Importing this module starts nothing; the first call of :func:`world` initialises MPI.
"""

from __future__ import annotations

import hashlib
import math
import os
import sys
import threading
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

if TYPE_CHECKING:
    from mpi4py.MPI import Intracomm

EXIT_INTERNAL_ERROR = 70
SLAB = 65536  # global ids that travel to rank 0 at a time: its buffers do not grow with the problem
PAIR_SLAB = 4096  # the same for pairs of ids, of which an id may have hundreds

# what each launcher says about the number of ranks it started (not SLURM_NTASKS: the batch shell has it too)
LAUNCHERS = {
    "PMI_SIZE": "a PMI launcher such as MPICH's mpirun",
    "OMPI_COMM_WORLD_SIZE": "Open MPI's mpirun",
    "SLURM_STEP_NUM_TASKS": "Slurm's srun",
}

Array = np.ndarray
T = TypeVar("T")


def mpi() -> Any:
    """Return the module ``mpi4py.MPI``; the first call initialises MPI."""
    from mpi4py import MPI

    return MPI


def world() -> Intracomm:
    """Return the communicator of all ranks; the first call initialises MPI."""
    return mpi().COMM_WORLD


def node_communicator(comm: Intracomm) -> Intracomm:
    """Return the ranks of ``comm`` that share this rank's node, to compile once per node. Collective."""
    return comm.Split_type(mpi().COMM_TYPE_SHARED)


def same_on_node(comm: Intracomm, value: T) -> T:
    """Return the ``value`` of the first rank on this rank's node. Collective."""
    if comm.size == 1:
        return value
    node = node_communicator(comm)
    value = node.bcast(value)
    node.Free()
    return value


def check_launcher(comm: Intracomm) -> str | None:
    """Return a sentence if the launcher started several ranks but ``comm`` has one, else None.

    The MPI library then does not belong to the launcher, and every process would run the whole problem.
    """
    for variable, launcher in LAUNCHERS.items():
        started = os.environ.get(variable, "")
        if comm.size > 1 or not started.isdigit() or int(started) < 2:
            continue
        name, version = mpi().get_vendor()
        srun = " (or srun --mpi=pmi2 for MPICH, srun --mpi=pmix for Open MPI)" if "SLURM" in variable else ""
        return (
            f"{variable} = {started}: {launcher} started {started} processes, but mpi4py loaded "
            f"{name} {'.'.join(map(str, version))}, which does not belong to it and sees 1 rank. "
            f"Run `pdfem run DECK -n {started}` from a plain shell: it takes the mpirun of this Python{srun}."
        )
    return None


_heard: list[Callable[[], None]] = []


@contextmanager
def hearing(beat: Callable[[], None]) -> Iterator[None]:
    """Call ``beat`` whenever this rank heard from the others: a sum, a word or a slab of rows came through."""
    _heard.append(beat)
    try:
        yield
    finally:
        _heard.remove(beat)


def _tell_of_progress() -> None:
    for beat in _heard:
        beat()


def sum_integers(comm: Intracomm, values: Array) -> Array:
    """Return the sum over all ranks, exact in any order, as int64. Collective.

    Parameters
    ----------
    values : int64 or narrower, any shape (equal on all ranks)
    """
    own = np.asarray(values).astype(np.int64, order="C", casting="safe")
    total = np.empty_like(own)
    comm.Allreduce(own, total, op=mpi().SUM)
    _tell_of_progress()
    return total


def largest(comm: Intracomm, values: Array) -> Array:
    """Return the largest value over all ranks; NaN on any rank gives NaN. Collective.

    Parameters
    ----------
    values : float64, any shape (equal on all ranks)
        The result has the same bits on every rank and for any number of ranks; zeros are positive.
    """
    own = np.asarray(values, dtype=np.float64)
    is_nan = np.isnan(own)
    # MAX would leave it to the order of ranks what becomes of NaN and of -0
    both = np.stack([np.where(is_nan, -np.inf, own) + 0.0, is_nan])
    result = np.empty_like(both)
    comm.Allreduce(both, result, op=mpi().MAX)
    _tell_of_progress()
    return np.where(result[1] > 0.0, np.nan, result[0])


def distinct(comm: Intracomm, values: Array) -> Array:
    """Return the sorted distinct integers of all ranks, int64. Collective.

    Parameters
    ----------
    values : int64, any shape
    """
    return np.unique(np.concatenate(comm.allgather(np.unique(np.asarray(values, np.int64)))))


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

    All ranks must come to the end: what the rank that writes the slabs cannot do is told after it.

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
        raise ValueError(
            f"gather_rows: (dtype, row shape, numbers and one id per row) by rank: {list(kinds)}."
        )
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
        _tell_of_progress()
        first, n_slab = int(slabs[slab]), int(slabs[slab + 1] - slabs[slab])
        if comm.rank > 0:
            yield first, None
            continue
        table = np.empty((n_slab, *rows.shape[1:]), rows.dtype)
        table[slab_ids - first] = slab_rows
        n_owners = np.bincount(slab_ids - first, minlength=n_slab)
        wrong = np.flatnonzero(n_owners != 1)[: max(0, 3 - len(problems))]
        problems += [f"id {first + i} has {n_owners[i]} owners" for i in wrong]
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
    pairs : int64, shape (n, 2)
        In any order; the first id of each is in ``0 .. n_global - 1``.

    Yields
    ------
    int64, shape (m, 2); None except on rank 0
        Ranges without a pair are left out.
    """
    own = pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))]
    edges = np.searchsorted(own[:, 0], np.arange(0, n_global + PAIR_SLAB, PAIR_SLAB))
    numbers = np.diff(edges)
    total = sum_integers(comm, numbers)
    counts = comm.gather(numbers) or [np.zeros(len(numbers), int)]
    for slab in np.flatnonzero(total):
        n_rows = np.array([count[slab] for count in counts])
        found = np.empty((total[slab] if comm.rank == 0 else 0, 2), np.int64)
        comm.Gatherv(own[edges[slab] : edges[slab + 1]], [found, 2 * n_rows])
        _tell_of_progress()
        yield found[np.lexsort((found[:, 1], found[:, 0]))] if comm.rank == 0 else None


def digest(comm: Intracomm, global_ids: Array, rows: Array, n_global: int) -> str:
    """Return the sha256 (hexadecimal) of dtype, shape and bits of rows in global-id order. Collective.

    Arguments as in :func:`gather_rows`; the same on every rank, and for any distribution of the rows.
    """
    table = gather_rows(comm, global_ids, rows, n_global)
    kind = b"" if table is None else f"{table.dtype.str}{table.shape}".encode()
    return broadcast(comm, None if table is None else hashlib.sha256(kind + table.tobytes()).hexdigest())


def agree(comm: Intracomm, messages: list[str]) -> list[str]:
    """Return the messages of all ranks in rank order, each once; empty when no rank has one. Collective.

    Ends every phase that can fail on one rank alone, so that all ranks raise or none does.
    """
    everybody = comm.allgather(messages)
    _tell_of_progress()
    return list(dict.fromkeys(message for own in everybody for message in own))


def broadcast(comm: Intracomm, value: T) -> T:
    """Return rank 0's ``value`` (any object that can be pickled) on every rank. Collective."""
    word = comm.bcast(value, root=0)
    _tell_of_progress()
    return word


class NotWritten(Exception):
    """Rank 0 could not write; raised on all ranks."""


def on_root(comm: Intracomm, action: Callable[[], Any]) -> Any:
    """Run ``action`` on rank 0; its result there, None elsewhere. Collective.

    Raises
    ------
    NotWritten
        On all ranks, for an OSError on rank 0.
    """
    result, messages = None, []
    if comm.rank == 0:
        try:
            result = action()
        except OSError as error:
            messages = [f"{error.filename or 'results'}: cannot be written ({error.strerror or error})."]
    messages = agree(comm, messages)
    if messages:
        raise NotWritten(messages[0])
    return result


def install_abort_hook(comm: Intracomm) -> None:
    """Make an uncaught exception on one rank, in any thread, stop all ranks with exit code 70.

    Without it the others wait for ever. With one rank nothing is installed. A command-line library that
    replaces ``sys.excepthook`` must have done so before.
    """
    if comm.size == 1:
        return

    def abort(kind, value, trace):
        try:
            sys.stderr.write(f"[rank {comm.rank}] {''.join(traceback.format_exception(kind, value, trace))}")
            sys.stderr.flush()
            sys.stdout.flush()
        finally:
            comm.Abort(EXIT_INTERNAL_ERROR)

    def abort_from_thread(args):
        if args.exc_type is not SystemExit:
            abort(args.exc_type, args.exc_value, args.exc_traceback)

    sys.excepthook = abort
    threading.excepthook = abort_from_thread
