"""Few bonds between two ranks are all on one of them, and those ghosts travel one way."""

import numpy as np
import pytest

from pdfem_mpi.parallel.comm import sum_integers
from pdfem_mpi.peridynamics.few_bonds import share_out
from support.bodies import build, make_scene
from support.helpers import assert_all

pytestmark = pytest.mark.mpi(min_size=2)


def pair(comm, numbers):
    """A number of this rank for each other rank, from a table of all of them; and the other ranks."""
    others = np.delete(np.arange(comm.size), comm.rank)
    return numbers[comm.rank, others], others


def table(comm, own, others):
    """What all ranks say of each other; int64, shape (n_ranks, n_ranks)."""
    everybody = np.zeros((comm.size, comm.size), np.int64)
    everybody[comm.rank, others] = own
    return sum_integers(comm, everybody)


@pytest.mark.parametrize("seed", range(5))
def test_two_ranks_decide_alike(comm, seed):
    """Which pairs have few rows is seen by both, and one takes them; the largest pair of a rank is never among them."""
    rng = np.random.default_rng(seed)
    numbers = (10.0 ** rng.uniform(0, 4, (comm.size, comm.size))).astype(np.int64)
    own, others = pair(comm, numbers)
    few, taken = share_out(comm, others, own)
    few_of_all, taken_of_all = table(comm, few, others), table(comm, taken, others)
    both = numbers + numbers.T
    np.fill_diagonal(both, 0)
    most = np.minimum(both.max(axis=0)[:, None], both.max(axis=0))
    expected = (both <= 0.25 * most) & ~np.eye(comm.size, dtype=bool)
    assert_all(comm, (few_of_all == expected).all(), f"{few_of_all} of {both}")
    assert_all(comm, (taken_of_all + taken_of_all.T == few_of_all).all(), f"{taken_of_all}")


def test_who_has_more_takes_less(comm):
    """Of four ranks in a square, two have more of the bonds along its sides: the others get those across."""
    numbers = np.zeros((comm.size, comm.size), np.int64)
    if comm.size == 4:
        numbers[:] = [[0, 500, 700, 50], [500, 0, 50, 700], [300, 50, 0, 500], [50, 300, 500, 0]]
    own, others = pair(comm, numbers)
    few, taken = share_out(comm, others, own)
    across = others + comm.rank == 3
    assert_all(comm, comm.size != 4 or (few == across).all(), f"{few} of {own}")
    assert_all(comm, comm.size != 4 or (taken == (across & (comm.rank > 1))).all(), f"{taken} of {own}")


def test_ranks_across_a_corner_send_one_way(comm):
    """Four quarters of a plate: along their sides ghosts go both ways, and from corner to corner one way."""
    body = build(make_scene((8, 8, 2), 0, correction="none"), comm, loaded=False)
    halo = body.model.points.halo
    ways = [(len(lent) > 0) + (len(ghosts) > 0) for lent, ghosts in halo.shared()]
    expected = {rank: 1 if comm.size == 4 and rank + comm.rank == 3 else 2 for rank in range(comm.size)}
    found = dict(zip(halo.neighbours, ways, strict=True))
    assert_all(comm, all(found[rank] == expected[rank] for rank in found), f"{found}")
    assert_all(comm, comm.size < 4 or len(found) == 3, f"{found}")
