"""Sums, gathering by global id and agreement give the same on every rank and for every number of ranks."""

import os
import sys
import threading
import time
from contextlib import nullcontext
from functools import partial

import numpy as np
import pytest

from pdfem_mpi.parallel import comm as parallel
from pdfem_mpi.parallel import slabs
from pdfem_mpi.parallel.comm import (
    agree,
    broadcast,
    check_launcher,
    dealt_on_node,
    install_abort_hook,
    largest,
    node_communicator,
    observing_progress,
    on_root_beating,
    sum_before,
    sum_integers,
)
from pdfem_mpi.parallel.slabs import gather_pairs, gather_rows
from support.counting import CountingComm
from support.helpers import assert_all

pytestmark = pytest.mark.mpi(min_size=2)


def shares(comm, n_global, seed=0):
    """Deal out 0 .. n_global - 1 at random; the last of several ranks gets nothing."""
    rng = np.random.default_rng(seed)
    owner = rng.integers(0, max(1, comm.size - 1), n_global)
    ids = rng.permutation(n_global)
    return ids[owner[ids] == comm.rank]


def test_sum_of_integers_is_exact(comm):
    """Terms beyond 2**53 that cancel: a sum that passes through float64 loses the ones."""
    big = (-1) ** comm.rank * 2**60
    values = np.array([[comm.rank + 1, big], [0, -big + 1]], dtype=np.int64)
    total = sum_integers(comm, values)
    n = comm.size
    odd = 2**60 * (n % 2)
    assert total.dtype == np.int64
    np.testing.assert_array_equal(total, [[n * (n + 1) // 2, odd], [0, n - odd]])
    assert values[0, 0] == comm.rank + 1


def test_a_sum_before_leaves_out_this_rank_and_those_after_it(comm):
    """Of an array, and of a number."""
    numbers = 10 ** np.arange(comm.size)
    before = sum_before(comm, np.array([numbers[comm.rank], 2**60])), sum_before(comm, comm.rank + 1)
    np.testing.assert_array_equal(before[0], [numbers[: comm.rank].sum(), comm.rank * 2**60])
    assert_all(comm, int(before[1]) == comm.rank * (comm.rank + 1) // 2)


def test_sum_takes_views_narrow_integers_and_empty_arrays(comm):
    table = np.arange(12, dtype=np.int64).reshape(3, 4)
    columns = sum_integers(comm, table[:, ::2])
    flags = sum_integers(comm, np.array([True, False]))
    nothing = sum_integers(comm, np.empty((0, 3), dtype=np.int64))
    np.testing.assert_array_equal(columns, comm.size * table[:, ::2])
    np.testing.assert_array_equal(flags, [comm.size, 0])
    assert nothing.shape == (0, 3)


def test_ranks_without_a_call_sleep(comm):
    """Waiting in a collective call of MPI would keep their processors busy."""
    began, worked = time.perf_counter(), time.process_time()
    result = dealt_on_node(comm, [partial(time.sleep, 1.0)] if comm.rank == 0 else [])
    waited, worked = time.perf_counter() - began, time.process_time() - worked
    assert_all(comm, waited > 0.99 and worked < 0.3, f"{waited:.2f} s, {worked:.2f} s of the processor")
    assert_all(comm, result == ([None] if comm.rank == 0 else []))


def test_calls_of_rank_0_are_dealt_out(comm):
    """Each is made once, in another process where there is one, and results come back in order."""
    n = 2 * comm.size + 1
    found = dealt_on_node(comm, [partial(_square_here, k) for k in range(n)] if comm.rank == 0 else [])
    squares, places = [square for square, _ in found], {place for _, place in found}
    assert_all(comm, squares == ([k * k for k in range(n)] if comm.rank == 0 else []))
    assert_all(comm, len(places) == (comm.size if comm.rank == 0 else 0))


def _square_here(k: int) -> tuple[int, int]:
    return k * k, os.getpid()


@pytest.mark.parametrize("dtype", [np.float64, np.uint64])
def test_sum_refuses_what_int64_cannot_hold(comm, dtype):
    """A float sum would depend on the order of ranks; nobody enters the collective."""
    with pytest.raises(TypeError):
        sum_integers(comm, np.ones(2, dtype=dtype))


def test_largest_value_and_its_bits(comm):
    """Negative values, infinities, and zeros of both signs: every rank gets the same bits."""
    sign = -1.0 if comm.rank == 0 else 1.0
    result = largest(comm, np.array([[-1.5 - comm.rank, sign * 0.0], [-np.inf, float(comm.rank)]]))
    np.testing.assert_array_equal(result, [[-1.5, 0.0], [-np.inf, comm.size - 1.0]])
    assert not np.signbit(result[0, 1])


def test_nan_on_one_rank_is_seen_by_all(comm):
    values = np.array([1.0, 2.0])
    if comm.rank == comm.size - 1:
        values[0] = np.nan
    result = largest(comm, values)
    np.testing.assert_array_equal(result, [np.nan, 2.0])


@pytest.mark.parametrize("n_global", [0, 1, 8, 9, 41])
def test_rows_are_gathered_in_the_order_of_their_ids(comm, monkeypatch, n_global):
    """Slabs of 8 ids: none, less than one, exactly one, one more, several; a rank without rows; strides."""
    monkeypatch.setattr(slabs, "SLAB", 8)
    everything = np.random.default_rng(7).random((n_global, 2, 9, 4))
    ids = shares(comm, n_global)
    rows = everything[ids][:, :, 3:6, ::2]
    gathered = gather_rows(comm, ids, rows, n_global)
    transposed = gather_rows(comm, ids, np.asfortranarray(rows), n_global)
    if comm.rank == 0:
        np.testing.assert_array_equal(gathered, everything[:, :, 3:6, ::2])
        np.testing.assert_array_equal(transposed, gathered)
    else:
        assert gathered is None


@pytest.mark.parametrize("dtype", [np.bool_, np.uint32, np.int64, np.float32])
def test_any_number_type_is_gathered(comm, dtype):
    everything = (np.arange(20) % 3).astype(dtype)
    ids = shares(comm, 20)
    gathered = gather_rows(comm, ids, everything[ids], 20)
    if comm.rank == 0:
        assert gathered.dtype == dtype
        np.testing.assert_array_equal(gathered, everything)


@pytest.mark.parametrize("fault", ["missing", "twice", "outside", "negative", "lengths", "objects"])
def test_ids_that_are_not_owned_once_are_refused_by_all(comm, fault):
    """One rank errs; every rank raises, so none waits in the next collective."""
    ids = shares(comm, 20)
    if comm.rank == 0:
        change = {"missing": ids[1:], "twice": np.append(ids, ids[0])}
        change |= {"outside": np.append(ids, 20), "negative": np.append(ids, -1)}
        ids = change.get(fault, ids)
    rows = np.zeros(len(ids) + (fault == "lengths" and comm.rank == 0), object if fault == "objects" else float)
    with pytest.raises(ValueError, match="gather_rows"):
        gather_rows(comm, ids, rows, 20)


@pytest.mark.parametrize("kind", [np.zeros((0, 2)), np.zeros(0, np.float32)], ids=["row shape", "dtype"])
def test_rows_of_another_kind_on_the_rank_without_rows_are_refused_by_all(comm, kind):
    """An empty array of the default kind is easily passed; one rank alone agrees with itself."""
    ids = shares(comm, 20)
    rows = np.zeros(20)[ids] if len(ids) else kind
    with pytest.raises(ValueError, match="gather_rows") if comm.size > 1 else nullcontext():
        gather_rows(comm, ids, rows, 20)


def test_messages_are_agreed_in_rank_order_each_once(comm):
    own = ["all"] + ([f"rank {comm.rank}"] if comm.rank % 2 == 1 else [])
    agreed, silence = agree(comm, own), agree(comm, [])
    assert agreed == ["all"] + [f"rank {rank}" for rank in range(1, comm.size, 2)]
    assert silence == []


def test_a_rank_that_raises_is_known_to_all(comm):
    """The pattern of every phase that can fail on one rank: catch, agree, then all raise or none does."""

    def phase():
        problems = []
        try:
            if comm.rank == comm.size - 1:
                raise OSError(f"disk full on rank {comm.rank}")
        except OSError as error:
            problems.append(str(error))
        if problems := agree(comm, problems):
            raise OSError("; ".join(problems))

    with pytest.raises(OSError, match=f"^disk full on rank {comm.size - 1}$"):
        phase()


def test_broadcast_takes_the_object_of_rank_0(comm):
    assert broadcast(comm, {"rank": comm.rank, "text": "deck"}) == {"rank": 0, "text": "deck"}


def test_ranks_of_one_machine_share_a_node(comm):
    """Here all ranks run on one machine; each compiles a share."""
    node = node_communicator(comm)
    found = node.size, node.rank
    node.Free()
    assert found == (comm.size, comm.rank)


@pytest.mark.parametrize(
    ("variable", "words"),
    [
        ("PMI_SIZE", "MPICH"),
        ("OMPI_COMM_WORLD_SIZE", "Open MPI's mpirun"),
        ("SLURM_STEP_NUM_TASKS", "srun --mpi="),
    ],
)
def test_a_foreign_launcher_is_named_with_the_fix(comm, monkeypatch, variable, words):
    """One rank while the launcher says 4: the sentence names launcher, library and command; else None."""
    for name in parallel.LAUNCHERS:
        monkeypatch.delenv(name, raising=False)
    no_launcher = check_launcher(comm)
    monkeypatch.setenv(variable, "1")
    one_process = check_launcher(comm)
    monkeypatch.setenv(variable, "4")
    sentence = check_launcher(comm)
    assert no_launcher is None
    assert one_process is None
    if comm.size > 1:
        assert sentence is None
    else:
        library = parallel.mpi().get_vendor()[0]
        for part in (f"{variable} = 4", words, library, "pdfem run DECK -n 4"):
            assert part in sentence


class Aborting:
    """Stands for a communicator whose Abort can be survived."""

    def __init__(self, size):
        self.size, self.rank, self.code = size, size - 1, None

    def Abort(self, code):
        self.code = code


@pytest.fixture
def hooks(monkeypatch):
    """Put both hooks back after the test."""
    monkeypatch.setattr(sys, "excepthook", sys.__excepthook__)
    monkeypatch.setattr(threading, "excepthook", threading.__excepthook__)


def test_one_rank_keeps_the_hooks_of_python(hooks):
    install_abort_hook(Aborting(1))
    assert sys.excepthook is sys.__excepthook__
    assert threading.excepthook is threading.__excepthook__


def test_an_uncaught_exception_aborts_with_rank_and_traceback(hooks, capsys):
    group = Aborting(3)
    install_abort_hook(group)
    try:
        raise KeyError("lost")
    except KeyError as error:
        sys.excepthook(type(error), error, error.__traceback__)
    text = capsys.readouterr().err
    assert group.code == 70
    assert text.startswith("[rank 2] Traceback")
    assert text.endswith("KeyError: 'lost'\n")


def test_all_ranks_hear_that_rank_0_is_at_work(comm):
    """What it does is done once, and its errors are its own business."""
    beats, done = [], []

    def action(beat):
        for _ in range(3):
            beat()
        done.append(1)

    with observing_progress(lambda: beats.append(1)):
        on_root_beating(comm, action)
    assert_all(comm, len(beats) == 4 and len(done) == (comm.rank == 0), f"{len(beats)} beats, done {len(done)} times")


def test_no_pairs_are_gathered_in_one_reduction(comm):
    """As at a checkpoint without a broken bond: nothing on rank 0 grows with ranks and body."""
    counted = CountingComm(comm)
    assert list(gather_pairs(counted, np.empty((0, 2), np.int64), 10**9)) == []
    assert (counted.calls["Allreduce"], counted.largest) == (1, 8)


@pytest.mark.parametrize(("error", "code"), [(ZeroDivisionError, 70), (SystemExit, None)])
def test_an_uncaught_exception_in_a_thread_aborts_but_its_exit_does_not(hooks, capsys, error, code):
    def fail():
        raise error

    group = Aborting(2)
    install_abort_hook(group)
    thread = threading.Thread(target=fail)
    thread.start()
    thread.join()
    assert group.code == code
    assert ("ZeroDivisionError" in capsys.readouterr().err) == (code == 70)


def test_an_abort_happens_even_when_nothing_can_be_written(hooks, monkeypatch):
    """A closed pipe must not keep the other ranks waiting."""
    group = Aborting(2)
    install_abort_hook(group)
    monkeypatch.setattr(sys, "stderr", None)
    with pytest.raises(AttributeError):
        sys.excepthook(ValueError, ValueError(), None)
    assert group.code == 70
