"""Pieces of meshes that are made, against the same cells of the whole."""

import numpy as np
import pytest

from pdfem_mpi.mesh.generators import box_layers, plate_layers
from pdfem_mpi.mesh.pieces import block_of

LAYERS = {
    "box": box_layers((-1.0, 0.0, 0.0), (5.0, 2.5, 1.5), (12, 5, 3)),
    "plate": plate_layers((-2.0, -1.5, -0.2), (2.0, 1.5, 0.2), 0.5, 0.2),
    "quarter plate": plate_layers((0.0, 0.0, 0.0), (2.0, 1.4, 0.2), 0.5, 0.2, ("x-", "y-")),
}


@pytest.fixture(params=LAYERS)
def layers(request):
    return LAYERS[request.param]


def middle_of(mesh):
    """Half-way between the lowest and the highest level along z, and the mean of the lower corners across."""
    return np.column_stack([mesh.nodes[mesh.cells[:, :4], :2].mean(axis=1), mesh.centroids[:, 2]])


@pytest.mark.parametrize("n_layers", [0, 1, 2])
def test_a_piece_has_the_cells_of_the_whole_in_a_box_and_around_it(layers, n_layers):
    whole = layers.whole()
    lower, upper = whole.lower + 0.22 * (whole.upper - whole.lower), whole.lower + 0.61 * (whole.upper - whole.lower)
    middle = middle_of(whole)
    chosen = ((middle >= lower) & (middle < upper)).all(axis=1)
    for _ in range(n_layers):
        chosen = whole.neighbours(chosen)
    part = layers.near(lower, upper, n_layers)
    assert 0 < len(part.cell_id) < len(whole.cells)
    np.testing.assert_array_equal(part.cell_id, np.flatnonzero(chosen))
    np.testing.assert_array_equal(part.node_id, np.unique(whole.cells[chosen]))
    np.testing.assert_array_equal(part.node_id[part.cells], whole.cells[chosen])
    np.testing.assert_array_equal(part.nodes, whole.nodes[part.node_id])


def test_a_box_beside_all_cells_has_none(layers):
    part = layers.near(np.full(3, 90.0), np.full(3, 91.0), 2)
    assert part.cells.shape == (0, 8) and part.nodes.shape == (0, 3) and not len(part.cell_id)


@pytest.mark.parametrize("n_blocks", [1, 2, 7, 32])
def test_blocks_hold_each_cell_once(layers, n_blocks):
    parts = [layers.near(*block_of(*layers.box, rank, n_blocks)) for rank in range(n_blocks)]
    found = np.concatenate([part.cell_id for part in parts])
    np.testing.assert_array_equal(np.sort(found), np.arange(layers.size[0]))


def test_sizes_and_corners_are_those_of_the_whole(layers):
    whole = layers.whole()
    assert layers.size == (len(whole.cells), len(whole.nodes))
    np.testing.assert_array_equal(layers.box, [whole.lower, whole.upper])
