"""A rank's share of the body: all of it on one rank, and on several what each of them has to know."""

import numpy as np
import pytest

from pdfem_mpi.body.discretization import discretize
from pdfem_mpi.deck.loads import BodyForce, Support, Traction
from pdfem_mpi.mesh.generators import box
from pdfem_mpi.mesh.part import take_part
from pdfem_mpi.runs.tables import renumber
from support.bodies import local_share, make_scene

COUPLED = make_scene((9, 3, 2), 4)


def test_one_rank_has_the_whole_body_without_a_copy():
    """Numbers of its cells and nodes are those of the mesh; rows of files count those in use."""
    whole, share = discretize(COUPLED), local_share(COUPLED)
    np.testing.assert_array_equal(share.mesh.cell_id, np.arange(9 * 3 * 2))
    np.testing.assert_array_equal(share.mesh.cells, whole.mesh.cells)
    assert share.is_owned.all()
    np.testing.assert_array_equal(share.point_row[share.has_points], np.arange(share.counts.point_cells))
    np.testing.assert_array_equal(np.flatnonzero(share.node_row >= 0), np.flatnonzero(whole.carries))
    points = np.flatnonzero(share.has_points & ~share.is_overlap)
    np.testing.assert_array_equal(share.free_row[points], np.arange(len(points)))
    assert share.counts.cells == 54 and share.counts.overlap_cells == whole.is_overlap.sum() == 6


def test_a_part_of_a_mesh_knows_the_whole_ones_measures():
    """Its cells have the same corners; its box, tolerance and edges are not its own."""
    mesh = box((0.0, 0.0, 0.0), (8.0, 2.0, 2.0), (4, 2, 1))
    chosen = np.zeros(len(mesh.cells), bool)
    chosen[[1, 5]] = True
    part = take_part(mesh, chosen)
    np.testing.assert_array_equal(part.nodes[part.cells], mesh.nodes[mesh.cells[[1, 5]]])
    np.testing.assert_array_equal(part.node_id[part.cells], mesh.cells[[1, 5]])
    assert (part.upper == [8.0, 2.0, 2.0]).all() and part.tolerance == mesh.tolerance
    assert (part.smallest_edge, part.largest_edge, part.mean_edge) == (1.0, 2.0, 1.5)
    np.testing.assert_array_equal(part.places_of_cells(np.array([5, 1])), [1, 0])


def test_selections_of_a_part_are_those_of_the_whole_that_lie_in_it():
    """Counts that messages speak of stay those of the whole body."""
    scene = make_scene(
        (4, 2, 2), 4, loads=(Traction(kind="traction", face="x+", total=(1.0, 0.0, 0.0)),
                             BodyForce(kind="body_force", region="elements", density=(1.0, 0.0, 0.0))),
        supports=(Support(face="x-", x=0.0),),
    )  # fmt: skip
    whole = local_share(scene).selections
    mesh = box((0.0, 0.0, 0.0), (4.0, 2.0, 2.0), (4, 2, 2))
    right = mesh.centroids[:, 0] > 2.0
    part = take_part(mesh, right)
    found = whole.part(part)
    assert len(found.loads[0].cells) == 4 and found.loads[0].total == 4
    np.testing.assert_array_equal(part.cell_id[found.loads[1].cells], np.flatnonzero(right))
    np.testing.assert_array_equal(part.node_id[found.loads[0].nodes], whole.loads[0].nodes)
    assert len(whole.supports[0].nodes) == 9 and not len(found.supports[0].nodes)


def test_ids_of_earlier_checkpoints_are_read():
    """They counted cells with points: the first such cell is number 3 x 2 x 3 of the mesh here. Images count on."""
    share = local_share(COUPLED)
    first, n_old, n_new = np.flatnonzero(share.has_points)[0], share.counts.point_cells, share.counts.cells
    assert first > 0
    old = np.array([[5, 8 * n_old + 2], [8 * (n_old - 1), 8 * (3 * n_old + 1) + 7]])
    expected = [[8 * first + 5, 8 * (first + n_new) + 2]]
    np.testing.assert_array_equal(renumber(old, share)[:1], expected)
    second = np.flatnonzero(share.has_points)[1]
    assert renumber(old, share)[1, 1] == 8 * (second + 3 * n_new) + 7


@pytest.mark.parametrize("elements", [0, 4, 9])
def test_elements_everywhere_are_the_intact_body(elements):
    """Every cell is an element, and every node of the mesh carries unknowns."""
    intact = local_share(make_scene((9, 3, 2), elements)).with_elements_everywhere()
    assert len(intact.subdomain.elements) == 54 and len(intact.subdomain.owned_nodes) == 10 * 4 * 3
    assert not intact.has_points.any() and not len(intact.subdomain.free)
