"""The communicator: the one importer of mpi4py; sums in any order of ranks, errors agreed by all ranks.

Importing this module starts nothing; the first call of :func:`world` initialises MPI.
"""

from __future__ import annotations

import os
import sys
import threading
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import chain
from time import perf_counter, sleep
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from pdfem_mpi.parallel.traffic import TRAFFIC
from pdfem_mpi.system.exit_codes import EXIT_INTERNAL_ERROR

if TYPE_CHECKING:
    from mpi4py.MPI import Intracomm


# what each launcher says about the number of ranks it started (not SLURM_NTASKS: the batch shell has it too)
LAUNCHERS = {
    "PMI_SIZE": "a PMI launcher such as MPICH's mpirun",
    "OMPI_COMM_WORLD_SIZE": "Open MPI's mpirun",
    "SLURM_STEP_NUM_TASKS": "Slurm's srun",
}

#: Seconds between two looks of a rank that waits at leisure.
BETWEEN_LOOKS = 0.005
#: Open messages that a library of MPI has places for from the start.
FEW_OPEN = 8

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


def lay_out_tables(comm: Intracomm) -> None:
    """Let the library of MPI make its tables now, where this rank may have more than a few open messages. Collective.

    MPICH has places for eight, and takes 2 MiB for 4,096 when there is a ninth. Whether a rank with seven neighbours
    comes to that depends on which message is early: what a rank takes for its part of the body would be left to chance.
    An exchange of a number with each rank takes 0.3 MiB for types of data, on many ranks and once.
    """
    if 2 * (comm.size - 1) <= FEW_OPEN:
        return
    itself, nothing, ends = mpi().COMM_SELF, np.empty(0, np.int8), range(FEW_OPEN + 1)
    mpi().Request.Waitall([itself.Irecv(nothing, 0) for _ in ends] + [itself.Isend(nothing, 0) for _ in ends])
    comm.Alltoall(np.zeros(comm.size, np.int64), np.empty(comm.size, np.int64))


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


_observers: list[Callable[[], None]] = []


@contextmanager
def observing_progress(beat: Callable[[], None]) -> Iterator[None]:
    """Call ``beat`` whenever something comes through from the other ranks: a sum, an object or a slab of rows.

    Also while this rank works for long by itself, in a loop that ends for sure.
    """
    _observers.append(beat)
    try:
        yield
    finally:
        _observers.remove(beat)


def report_progress() -> None:
    """Call the observers: something came through from the other ranks, or this one is at work."""
    for beat in _observers:
        beat()


def sum_integers(comm: Intracomm, values: Array) -> Array:
    """Return the sum over all ranks, exact in any order, as int64. Collective.

    Parameters
    ----------
    values : int64 or narrower, any shape (equal on all ranks)
    """
    own = np.asarray(values).astype(np.int64, order="C", casting="safe")
    total = np.empty_like(own)
    began = perf_counter()
    comm.Allreduce(own, total, op=mpi().SUM)
    TRAFFIC.add_reduction(own.nbytes, perf_counter() - began)
    report_progress()
    return total


def sum_before(comm: Intracomm, values: Array) -> Array:
    """Return the sum over the ranks before this one, 0 on the first, as int64. Collective.

    mpi4py's own ``exscan`` makes a second communicator of each that it is called on, and the library of MPI takes 1.8
    MiB for them.

    Parameters
    ----------
    values : int64 or narrower, any shape (equal on all ranks)
    """
    own = np.asarray(values).astype(np.int64, order="C", casting="safe")
    before = np.zeros_like(own)
    comm.Exscan(own, before, op=mpi().SUM)
    if comm.rank == 0:
        before[...] = 0  # what the first rank receives is not defined
    report_progress()
    return before


def largest(comm: Intracomm, values: Array) -> Array:
    """Return the largest value over all ranks; NaN on any rank gives NaN. Collective.

    Parameters
    ----------
    values : float64, any shape (equal on all ranks)
        The result has the same bits on every rank and for any number of ranks; zeros are positive.
    """
    own = np.asarray(values, dtype=np.float64)
    is_nan = np.isnan(own)
    # with MAX alone the result for NaN and for -0 would depend on the order of the ranks
    both = np.stack([np.where(is_nan, -np.inf, own) + 0.0, is_nan])
    result = np.empty_like(both)
    began = perf_counter()
    comm.Allreduce(both, result, op=mpi().MAX)
    TRAFFIC.add_reduction(both.nbytes, perf_counter() - began)
    report_progress()
    return np.where(result[1] > 0.0, np.nan, result[0])


def agree(comm: Intracomm, messages: list[str]) -> list[str]:
    """Return the messages of all ranks in rank order, each once; empty when no rank has one. Collective.

    Ends every phase that can fail on one rank alone, so that all ranks raise or none does.
    """
    everybody = comm.allgather(messages)
    report_progress()
    return list(dict.fromkeys(message for own in everybody for message in own))


def broadcast(comm: Intracomm, value: T, root: int = 0) -> T:
    """Return a rank's ``value`` (any object that can be pickled) on every rank. Collective."""
    word = comm.bcast(value, root=root)
    report_progress()
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


def dealt_on_node(comm: Intracomm, calls: list[Callable[[], T]]) -> list[T]:
    """Run calls that rank 0 has, each on some rank of its node; their results in order, none except on rank 0.

    The calls can be pickled and do not fail. A library of MPI waits with its processors busy, as long as it may take;
    here who has no call, and who is done, sleeps and looks every few milliseconds. Collective.
    """
    node = node_communicator(comm)
    turns: list[list[tuple[int, Callable[[], T]]]] = [[] for _ in range(node.size)]
    for k, call in enumerate(calls):
        turn, place = divmod(k, node.size)  # there and back: the first has the last one too
        turns[node.size - 1 - place if turn % 2 else place].append((k, call))
    found = [(k, call()) for k, call in node.scatter(turns)]
    over = comm.Ibarrier()
    while not over.Test():
        sleep(BETWEEN_LOOKS)
    gathered = node.gather(found)
    node.Free()
    if comm.rank > 0:
        return []
    return [result for _, result in sorted(chain(*gathered))]


def on_root_beating(comm: Intracomm, action: Callable[[Callable[[], None]], None]) -> None:
    """Run ``action(beat)`` on rank 0, where it may take long; every call of ``beat`` is heard by all. Collective.

    The action keeps its errors to itself.
    """
    if comm.rank == 0:
        action(lambda: broadcast(comm, True))
        broadcast(comm, False)
        return
    while broadcast(comm, False):
        pass


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
