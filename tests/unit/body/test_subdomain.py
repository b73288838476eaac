"""A rank's share: every cell and node has one owner, and every bond partner is seen."""

import numpy as np
import pytest
from scipy.spatial.distance import cdist

from pdfem_mpi.body.discretization import discretize
from pdfem_mpi.body.partitioning import partition
from pdfem_mpi.body.subdomain import cut_out, node_owners
from pdfem_mpi.deck.table import SceneError
from pdfem_mpi.kernels.hex8 import gauss_positions
from pdfem_mpi.parallel.comm import observing_progress
from support.bodies import make_scene

BODIES = {
    "peridynamics": make_scene((7, 3, 2)),
    "elements": make_scene((7, 3, 2), 7),
    "coupled": make_scene((9, 3, 2), 4),
    "coupled, reading A, overlap 2": make_scene((9, 3, 2), 5, coupling="paper_a", overlap=2),
}


def random_owners(n_cells, n_parts):
    return np.random.default_rng(n_parts).integers(0, n_parts, n_cells).astype(np.int32)


@pytest.fixture(params=[1, 2, 3, 5], ids="{}_parts".format)
def n_parts(request):
    return request.param


@pytest.fixture(params=BODIES)
def body(request):
    return discretize(BODIES[request.param])


@pytest.fixture(params=["bisection", "random"])
def owner(request, body, n_parts):
    """Owners as a run has them, and owners that no bisection would give."""
    return partition(body, n_parts) if request.param == "bisection" else random_owners(len(body.region), n_parts)


def test_every_cell_and_node_has_one_owner(body, owner, n_parts):
    shares = [cut_out(body, owner, rank) for rank in range(n_parts)]
    for chosen, names in (
        (body.has_points & ~body.is_overlap, ["free"]),
        (body.is_overlap, ["overlap"]),
        (body.has_stiffness, ["elements"]),
    ):
        cells = np.concatenate([getattr(share, name) for share in shares for name in names])
        np.testing.assert_array_equal(np.sort(cells), np.flatnonzero(chosen))
    nodes = np.concatenate([share.owned_nodes for share in shares])
    np.testing.assert_array_equal(np.sort(nodes), np.flatnonzero(body.carries))


def test_a_rank_sees_all_nodes_of_its_elements_and_their_owners(body, owner, n_parts):
    shares = [cut_out(body, owner, rank) for rank in range(n_parts)]
    owner_of_node = {node: rank for rank, share in enumerate(shares) for node in share.owned_nodes.tolist()}
    for rank, share in enumerate(shares):
        cells = np.flatnonzero((owner == rank) & body.has_nodes)
        seen = np.concatenate([share.owned_nodes, share.ghost_nodes])
        assert len(np.unique(seen)) == len(seen)
        assert set(body.mesh.cells[cells].ravel().tolist()) == set(seen.tolist())
        assert [owner_of_node[node] for node in share.ghost_nodes.tolist()] == share.ghost_node_owner.tolist()


def test_nodes_go_one_way_between_two_ranks_and_between_few_of_them():
    """Of cubes in a block whose planes step inside of a layer; with the lowest rank as owner they were 4.1 a rank."""
    body = discretize(make_scene((8, 8, 4), 0, solver="cg"))
    everywhere, owner = np.ones(len(body.region), bool), partition(body, 32)
    of_node = node_owners(body.mesh, everywhere, owner)
    ways = set(zip(of_node[body.mesh.cells].ravel().tolist(), np.repeat(owner, 8).tolist(), strict=True))
    ways = {(one, other) for one, other in ways if one != other}
    assert not ways & {(other, one) for one, other in ways}
    assert len(ways) < 3.6 * 32


def test_a_rank_sees_every_point_within_the_cutoff_radius(body, owner, n_parts):
    """Ghosts are cells with points of other ranks, each once; none that has a bond to an owned point is missing."""
    points = gauss_positions(body.nodes[body.mesh.cells])
    for rank in range(n_parts):
        share = cut_out(body, owner, rank)
        owned = np.concatenate([share.free, share.overlap]).astype(int)
        assert (share.ghost_owner == owner[share.ghosts]).all()
        assert (share.ghost_owner != rank).all()
        assert body.has_points[share.ghosts].all()
        assert len(np.unique(share.ghosts)) == len(share.ghosts)
        others = np.flatnonzero(body.has_points & (owner != rank))
        if not len(owned):
            assert not len(share.ghosts)
            continue
        reached = [cell for cell in others if (cdist(points[cell], points[owned].reshape(-1, 3)) <= body.cutoff).any()]
        assert set(reached) <= set(share.ghosts.tolist())


def test_ghosts_end_a_little_beyond_the_cutoff_radius():
    """Cells of a long bar that are farther away than the cutoff radius and two cells are nobody's ghosts."""
    body = discretize(make_scene((40, 2, 2)))
    owner = partition(body, 2)
    for rank in range(2):
        ghosts = cut_out(body, owner, rank).ghosts
        assert len(ghosts) <= 4 * 4  # four layers of 2 x 2 cells


def test_cells_are_shared_by_their_cost():
    """A peridynamic half costs far more than an element half: two ranks divide the former between them."""
    body = discretize(make_scene((20, 3, 3), 10))
    owner = partition(body, 2)
    free = body.has_points & ~body.is_overlap
    share = np.count_nonzero(owner[free] == 0) / np.count_nonzero(free)
    assert 0.3 < share < 0.7


def test_one_part_owns_all():
    body = discretize(make_scene((3, 1, 1)))
    assert not partition(body, 1).any()


def test_more_parts_than_cells_are_refused_with_the_number_that_fits():
    body = discretize(make_scene((3, 1, 1)))
    assert sorted(partition(body, 3)) == [0, 1, 2]
    with pytest.raises(SceneError, match=r"4 ranks cannot share 3 cells\. Use at most 3 ranks"):
        partition(body, 4)


def test_more_ranks_than_sums_are_exact_for_are_refused_by_name():
    body = discretize(make_scene((3, 1, 1)))
    with pytest.raises(SceneError, match=r"40000 ranks are more than 32,768, up to which sums over ranks are exact"):
        partition(body, 40_000)


def test_a_cycle_over_all_cells_evens_them_out():
    """Conjugate gradients work on every cell: the rank with the elements gets fewer of them than for relaxation."""
    cells = {}
    for solver in ("adr", "cg"):
        body = discretize(make_scene((24, 8, 8), 12, solver=solver))
        cells[solver] = np.bincount(partition(body, 16)).max() / (len(body.region) / 16)
    assert cells["cg"] < 4.0 < 7.0 < cells["adr"]  # times the mean


def test_set_up_says_that_it_is_at_work():
    """The watchdog hears of it: long set-ups have no word from the other ranks."""
    beats = []
    with observing_progress(lambda: beats.append(1)):
        partition(discretize(make_scene((6, 3, 3), 2)), 2)
    assert len(beats) >= 4
