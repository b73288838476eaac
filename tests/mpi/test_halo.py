"""Ghosts equal their owners, and the reverse exchange is the transpose of the forward one, on 1 to 4 ranks.

The oracle is a slice of a global array that every rank builds from the same seed; data are whole numbers, so
every comparison is exact.
"""

from dataclasses import dataclass

import numpy as np
import pytest

from pdfem_mpi.parallel.halo import Halo, build_halo
from support.helpers import assert_all

pytestmark = pytest.mark.mpi(min_size=2)

N_GLOBAL = 60


@dataclass(frozen=True)
class Case:
    """What one rank passes to ``build_halo``, and what it got."""

    owner: np.ndarray  # of every global block
    owned: np.ndarray
    ghosts: np.ndarray
    halo: Halo

    @property
    def local(self):
        return np.concatenate([self.owned, self.ghosts])

    def filled(self, everything):
        """The rows of a global array for owned blocks, and rubbish for ghosts."""
        a = everything[self.local]
        a[len(self.owned) :] = 99
        return a


def scattered(comm, seed=0, share=0.5, sort_ghosts=False, owners=None):
    """Deal out blocks at random; each rank has a random part of the others' blocks as ghosts."""
    rng = np.random.default_rng(seed)
    owner = rng.choice(comm.size if owners is None else owners, N_GLOBAL)
    for rank in range(comm.size):  # the same draws on all ranks
        blocks = rng.permutation(N_GLOBAL)
        chosen = rng.random(N_GLOBAL) < share
        if rank == comm.rank:
            owned, ghosts = blocks[owner[blocks] == rank], blocks[chosen & (owner[blocks] != rank)]
    if sort_ghosts:
        ghosts = ghosts[np.lexsort((ghosts, owner[ghosts]))]
    return Case(owner, owned, ghosts, build_halo(comm, owned, ghosts, owner[ghosts].astype(np.int32)))


def table(seed=0, row_shape=(2, 9, 4), dtype=np.float64):
    """A global array of whole numbers."""
    return np.random.default_rng(seed).integers(-1000, 1000, (N_GLOBAL, *row_shape)).astype(dtype)


def test_smallest_of_all_copies(comm):
    """Owners take the smallest of their rows' copies, and ghosts take it from their owners."""
    case = scattered(comm)
    own = np.random.default_rng(comm.rank).integers(0, 1000, (len(case.local), 2))
    everyone = comm.allgather((case.local, own))
    case.halo.scatter_smallest(own)
    smallest = np.full((N_GLOBAL, 2), 1000)
    for local, rows in everyone:
        np.minimum.at(smallest, local, rows)
    assert_all(comm, (own == smallest[case.local]).all())


@pytest.mark.parametrize("sort_ghosts", [False, True], ids=["any order", "by owner"])
@pytest.mark.parametrize(
    ("dtype", "row_shape"), [(np.float64, (2, 9, 4)), (np.int64, (3,)), (np.float32, ()), (np.bool_, (3,))]
)
def test_forward_gives_slices_of_the_global_array(comm, dtype, row_shape, sort_ghosts):
    case = scattered(comm, sort_ghosts=sort_ghosts)
    everything = table(1, row_shape, dtype)
    a = case.filled(everything)
    case.halo.scatter_forward(a)
    np.testing.assert_array_equal(a, everything[case.local])


@pytest.mark.parametrize("sort_ghosts", [False, True], ids=["any order", "by owner"])
def test_reverse_adds_what_all_ranks_hold(comm, sort_ghosts):
    """Each rank holds its own numbers; an owner ends with the sum over all that have the block."""
    case = scattered(comm, sort_ghosts=sort_ghosts, share=0.8)
    held = [table(rank, (3,), np.int64) for rank in range(comm.size)]
    a = held[comm.rank][case.local]
    ghosts_before = a[len(case.owned) :].copy()
    case.halo.scatter_reverse(a)
    present = np.zeros((comm.size, N_GLOBAL), dtype=bool)
    present[comm.rank, case.local] = True
    present = comm.allgather(present[comm.rank])
    total = sum(here[:, None] * numbers for here, numbers in zip(present, held, strict=True))
    np.testing.assert_array_equal(a[: len(case.owned)], total[case.owned])
    np.testing.assert_array_equal(a[len(case.owned) :], ghosts_before)


@pytest.mark.parametrize("dtype", [np.int64, np.float64])
@pytest.mark.parametrize("seed", range(3))
def test_reverse_is_the_transpose_of_forward(comm, seed, dtype):
    """<R y, x> over owned blocks = <y, F x> over owned blocks and ghosts, both summed over ranks."""
    case = scattered(comm, seed, share=0.1 + 0.4 * seed)
    n = len(case.owned)
    rng = np.random.default_rng([seed, comm.rank])
    x = table(seed, (2, 3), dtype)[case.local]
    y = rng.integers(-1000, 1000, x.shape).astype(dtype)
    forward, reverse = x.copy(), y.copy()
    forward[n:] = 0
    case.halo.scatter_forward(forward)
    case.halo.scatter_reverse(reverse)
    left = comm.allreduce(int((reverse[:n] * x[:n]).sum()))
    right = comm.allreduce(int((y * forward).sum()))
    assert left == right


@pytest.mark.parametrize("rows", [slice(0, 3), slice(6, 9)], ids=["u", "force"])
def test_only_the_rows_of_a_view_travel(comm, rows):
    """The rows of the point table that are u: other rows of ghosts stay as they are."""
    case = scattered(comm)
    everything = table(2)
    n_local = len(case.local)
    s = case.filled(everything).reshape(2 * n_local, 9, 4)
    before = s.copy().reshape(n_local, 2, 9, 4)
    expected = before.copy()
    expected[:, :, rows] = everything[case.local][:, :, rows]
    case.halo.scatter_forward(s.reshape(n_local, 2, 9, 4)[:, :, rows, :])
    np.testing.assert_array_equal(s.reshape(n_local, 2, 9, 4), expected)


def test_integers_in_a_view_of_the_float_table_are_added_as_integers(comm):
    """Forces are int64 in the rows 6-8 of the float64 table: sums beyond 2**53 keep their last bit."""
    case = scattered(comm, share=1.0)
    n_local, n = len(case.local), len(case.owned)
    s = np.zeros((2 * n_local, 9, 4))
    force = s.view(np.int64).reshape(n_local, 2, 9, 4)[:, :, 6:9, :]
    force[...] = 2**60 // comm.size + 1
    case.halo.scatter_reverse(force)
    np.testing.assert_array_equal(force[:n], comm.size * (2**60 // comm.size + 1))
    assert not s[:, :6].any()


@pytest.mark.parametrize("steps", [0, 3])
def test_split_exchange_carries_what_was_there_at_the_start(comm, steps):
    """With any number of tests between; owned rows may be changed once the exchange has started."""
    case = scattered(comm)
    everything = table(3, (2, 3))
    a = case.filled(everything)
    n = len(case.owned)
    case.halo.start_forward(a)
    a[:n] = 7
    for _ in range(steps):
        case.halo.test()
    case.halo.finish_forward(a)
    forces = np.ones(a.shape, dtype=np.int64)
    case.halo.start_reverse(forces)
    forces[:n] += 10
    forces[n:] = 0
    for _ in range(steps):
        case.halo.test()
    case.halo.finish_reverse(forces)
    holders = np.bincount(np.concatenate(comm.allgather(case.local)), minlength=N_GLOBAL)
    np.testing.assert_array_equal(a[n:], everything[case.ghosts])
    assert (a[:n] == 7).all()
    np.testing.assert_array_equal(forces[:n, 0, 0], 10 + holders[case.owned])


def test_several_exchanges_may_be_under_way(comm):
    """Two halos on one communicator, two types of row of one halo; finished in another order on odd ranks."""
    points, nodes = scattered(comm, 4), scattered(comm, 5)
    u, forces, x = table(4, (2, 3)), table(5, (2, 3), np.int64), table(6, (2, 3))
    a, b, c = points.filled(u), forces[points.local], nodes.filled(x)
    points.halo.start_forward(a)
    points.halo.start_reverse(b)
    nodes.halo.start_forward(c)
    nodes.halo.test()
    if comm.rank % 2 == 0:
        points.halo.finish_forward(a)
        nodes.halo.finish_forward(c)
    else:
        nodes.halo.finish_forward(c)
        points.halo.finish_forward(a)
    points.halo.finish_reverse(b)
    holders = np.bincount(np.concatenate(comm.allgather(points.local)), minlength=N_GLOBAL)[:, None, None]
    np.testing.assert_array_equal(a, u[points.local])
    np.testing.assert_array_equal(c, x[nodes.local])
    np.testing.assert_array_equal(b[: len(points.owned)], (holders * forces)[points.owned])


def test_halos_and_directions_are_told_apart_when_ranks_start_them_in_different_orders(comm):
    points, nodes = scattered(comm, 6), scattered(comm, 7)
    u, x = table(8, (3,)), table(9, (3,))
    a, b, counts = points.filled(u), nodes.filled(x), np.ones((len(points.local), 3), dtype=np.int64)
    starts = [
        (points.halo.start_forward, a),
        (nodes.halo.start_forward, b),
        (points.halo.start_reverse, counts),
    ]
    for start, array in starts if comm.rank % 2 == 0 else reversed(starts):
        start(array)
    points.halo.finish_forward(a)
    nodes.halo.finish_forward(b)
    points.halo.finish_reverse(counts)
    holders = np.bincount(np.concatenate(comm.allgather(points.local)), minlength=N_GLOBAL)
    np.testing.assert_array_equal(a, u[points.local])
    np.testing.assert_array_equal(b, x[nodes.local])
    np.testing.assert_array_equal(counts[: len(points.owned), 0], holders[points.owned])


def test_a_rank_may_have_no_block(comm):
    """Everything on the last rank: the others own nothing, and have ghosts or nothing at all."""
    case = scattered(comm, owners=[comm.size - 1])
    everything = table(10, (3,))
    a = case.filled(everything)
    case.halo.scatter_forward(a)
    ones = np.ones(len(a), dtype=np.int64)
    case.halo.scatter_reverse(ones)
    empty = build_halo(comm, case.owned, np.empty(0, np.int64), np.empty(0, np.int32))
    alone = everything[case.owned]
    empty.scatter_forward(alone)
    empty.scatter_reverse(alone)
    holders = np.bincount(np.concatenate(comm.allgather(case.local)), minlength=N_GLOBAL)
    np.testing.assert_array_equal(a, everything[case.local])
    np.testing.assert_array_equal(ones[: len(case.owned)], holders[case.owned])
    np.testing.assert_array_equal(alone, everything[case.owned])
    assert (empty.n_ghost, empty.n_lent, empty.neighbours) == (0, 0, ())


def test_only_rows_that_are_ghosts_travel_and_only_to_their_holders(comm):
    """A chain of ranks: one ghost on each side, so two neighbours and at most two rows each way."""
    n, rank, size = 5, comm.rank, comm.size
    owned = np.arange(n * rank, n * rank + n)
    ghosts = np.array([i for i in (n * rank - 1, n * rank + n) if 0 <= i < n * size], dtype=np.int64)
    halo = build_halo(comm, owned, ghosts, ghosts // n)
    beside = tuple(r for r in (rank - 1, rank + 1) if 0 <= r < size)
    assert halo.neighbours == beside
    assert (halo.n_owned, halo.n_ghost, halo.n_lent) == (n, len(beside), len(beside))


def test_buffers_are_allocated_once_for_each_size_of_row(comm):
    """Repeated exchanges reuse buffers and messages, also for integers in place of floats, and carry the new values."""
    case = scattered(comm)
    first, second = table(11, (3,)), table(12, (3,))
    a, b, c = case.filled(first), case.filled(second), case.filled(first.astype(np.int64))
    case.halo.scatter_forward(a)
    ((buffers,),) = case.halo._buffers.values()
    case.halo.scatter_forward(b)
    case.halo.scatter_forward(c)
    np.testing.assert_array_equal(b, second[case.local])
    np.testing.assert_array_equal(c, first[case.local])
    ((after,),) = case.halo._buffers.values()
    assert after is buffers


@pytest.mark.parametrize("fault", ["not owned", "owner out of range", "negative owner", "twice", "lengths"])
def test_a_wrong_ghost_on_one_rank_is_refused_by_all(comm, fault):
    """Rank 0 errs; the message names who found it, and every rank raises it."""
    owned = np.array([2 * comm.rank, 2 * comm.rank + 1])
    ghosts, owner = np.empty(0, np.int64), np.empty(0, np.int32)
    if comm.rank == 0:
        ghosts, owner = {
            "not owned": ([77], [comm.size - 1]),
            "owner out of range": ([77], [comm.size]),
            "negative owner": ([77], [-1]),
            "twice": ([1], [0]),
            "lengths": ([77], []),
        }[fault]
    finder = comm.size - 1 if fault == "not owned" else 0
    with pytest.raises(ValueError, match=f"build_halo: rank {finder} "):
        build_halo(comm, owned, ghosts, owner)


def test_misuse_is_an_error_before_any_message_is_sent(comm):
    case = scattered(comm)
    a = case.filled(table(13, (3,)))
    with pytest.raises(ValueError, match="rows for"):
        case.halo.start_forward(a[:-1])
    with pytest.raises(RuntimeError, match="no forward exchange"):
        case.halo.finish_forward(a)
    with pytest.raises(TypeError, match="Python objects"):
        case.halo.start_forward(a.astype(object))
    case.halo.start_forward(a)
    with pytest.raises(RuntimeError, match="before starting another"):
        case.halo.start_reverse(a)
    with pytest.raises(RuntimeError, match="no reverse exchange"):
        case.halo.finish_reverse(a)
    case.halo.finish_forward(a)


@pytest.mark.mpi
def test_owners_tell_each_neighbour_apart(comm):
    """A number for each copy, of its row and of who has it: others are told others."""
    n = 6
    ids = np.arange(n) + n * comm.rank
    others = np.setdiff1d(np.arange(n * comm.size), ids)[comm.rank :: 2]
    halo = build_halo(comm, ids, others, others // n)
    shared = halo.shared()
    assert_all(comm, all((ids[lent] // n == comm.rank).all() for lent, _ in shared))
    told = [100.0 * rank + ids[lent] for rank, (lent, _) in zip(halo.neighbours, shared, strict=True)]
    assert_all(comm, halo.swap(told).tolist() == (100.0 * comm.rank + others).tolist())
    for rank, (_, ghosts) in zip(halo.neighbours, shared, strict=True):
        assert (others[ghosts - n] // n == rank).all()
