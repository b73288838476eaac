"""Owners of numbered things: the largest claim wins, on any number of ranks."""

import numpy as np
import pytest

from pdfem_mpi.parallel.election import _largest_claims, elect, told
from support.helpers import assert_all

N = 60


def claims_of(rank, size):
    """Every thing is claimed by about half of the ranks, by many of them as much as by others."""
    rng = np.random.default_rng(100 * size + rank)
    ids = np.sort(rng.choice(N, N // 2, replace=False))
    return ids, rng.integers(0, 3, len(ids))


def test_the_largest_claim_of_the_lowest_rank_wins():
    heard = np.array([[7, 1], [5, 0], [7, 2], [9, 0], [7, 2], [9, 0]])
    found = _largest_claims(heard, np.array([0, 0, 1, 1, 2, 2]))
    np.testing.assert_array_equal(found, [1, 0, 1, 1, 1, 1])


@pytest.mark.mpi
def test_ranks_agree_on_owners(comm):
    ids, claims = claims_of(comm.rank, comm.size)
    best = {}
    for rank in range(comm.size):
        for thing, claim in zip(*claims_of(rank, comm.size), strict=True):
            if thing not in best or claim > best[thing][0]:
                best[thing] = claim, rank
    expected = [best[thing][1] for thing in ids]
    found = elect(comm, ids, claims)
    assert_all(comm, found.tolist() == expected, f"{found}")
    owned = told(comm, ids, found)
    mine = sorted(thing for thing, (_, rank) in best.items() if rank == comm.rank)
    assert_all(comm, owned.tolist() == mine, f"{owned}")


@pytest.mark.mpi
def test_ranks_may_know_nothing(comm):
    nothing = np.empty(0, np.int64)
    ids = np.array([3]) if comm.rank == comm.size - 1 else nothing
    found = elect(comm, ids, np.zeros(len(ids), np.int64))
    owned = told(comm, ids, found)
    last = comm.rank == comm.size - 1
    assert_all(comm, (found.tolist(), owned.tolist()) == (([comm.rank], [3]) if last else ([], [])))
