"""Ownership of cells: balance, small dividing surfaces, and the same answer for everyone (no MPI)."""

import gc
import time
import weakref

import numpy as np
import pytest

from pdfem_mpi.parallel.bisection import bisect, mean_edge

SECONDS = 0.5  # 40,000 cells into 16 parts: "well under 1 s"; about 0.05 s on a quiet core
EDGE_TOLERANCE = 1e-5  # mean_edge stops at 1e-6


def grid(nx, ny, nz, spacing=(1.0, 1.0, 1.0)):
    """Return the centres of nx x ny x nz cells, x fastest, shape (n, 3)."""
    z, y, x = np.meshgrid(np.arange(nz), np.arange(ny), np.arange(nx), indexing="ij")
    return np.stack([x, y, z], axis=-1).reshape(-1, 3) * spacing


def dividing_surface(owner, nx, ny, nz):
    """Count the pairs of face neighbours that belong to different parts."""
    box = owner.reshape(nz, ny, nx)
    return sum(int(np.count_nonzero(np.diff(box, axis=axis))) for axis in range(3))


def weights_of(owner, weights, n_parts):
    return np.bincount(owner, weights=weights, minlength=n_parts)


@pytest.mark.parametrize("n_parts", range(1, 10))
def test_equal_cells_give_parts_that_differ_by_one_cell(n_parts):
    """A cut is within half a cell of its share, so a part is within one cell of its own."""
    positions = grid(13, 11, 7)
    owner = bisect(positions, np.ones(len(positions), dtype=np.int64), n_parts)
    n_cells = np.bincount(owner, minlength=n_parts)
    assert owner.dtype == np.int32
    assert len(n_cells) == n_parts
    assert np.abs(n_cells - len(positions) / n_parts).max() <= 1.0


@pytest.mark.parametrize("n_parts", [2, 3, 5, 7, 8, 9])
def test_uneven_weights_are_balanced_within_the_largest_weight(n_parts):
    """A quarter of the cells costs 1000 times the rest, as bonds do beside elements."""
    positions = grid(24, 12, 6)
    weights = np.where(positions[:, 0] < 6, 1000, 1) + np.random.default_rng(1).integers(0, 3, len(positions))
    share = weights.sum() / n_parts
    parts = weights_of(bisect(positions, weights, n_parts), weights, n_parts)
    assert np.abs(parts - share).max() <= weights.max()


def test_one_heavy_cell_leaves_no_part_empty():
    """The cell outweighs all others together: its part is heavy, but every part has cells."""
    positions = grid(5, 4, 3)
    weights = np.ones(60, dtype=np.int64)
    weights[17] = 10**12
    for n_parts in (2, 3, 5, 7, 9, 60):
        assert np.bincount(bisect(positions, weights, n_parts), minlength=n_parts).min() >= 1


def test_cells_without_weight_are_divided_by_number():
    owner = bisect(grid(8, 1, 1), np.zeros(8, dtype=np.int64), 4)
    np.testing.assert_array_equal(owner, [0, 0, 1, 1, 2, 2, 3, 3])


@pytest.mark.parametrize("n_parts", [1, 2, 5, 7, 9])
def test_one_cell_each_when_there_are_as_many_parts_as_cells(n_parts):
    positions = np.random.default_rng(2).random((n_parts, 3))
    owner = bisect(positions, np.arange(1, n_parts + 1), n_parts)
    np.testing.assert_array_equal(np.sort(owner), np.arange(n_parts))


@pytest.mark.parametrize("n_cells", [0, 1, 2, 4])
def test_more_parts_than_cells_leave_parts_empty_and_none_has_two_cells(n_cells):
    owner = bisect(grid(n_cells, 1, 1), np.full(n_cells, 5), 7)
    assert len(np.unique(owner)) == n_cells
    assert ((owner >= 0) & (owner < 7)).all()


def test_cells_at_one_place_are_divided_by_index():
    """Every coordinate is equal: only the index is left to decide."""
    owner = bisect(np.full((9, 3), 0.25), np.ones(9, dtype=np.int64), 3)
    np.testing.assert_array_equal(owner, [0, 0, 0, 1, 1, 1, 2, 2, 2])


def test_a_plane_inside_a_layer_takes_the_cells_of_lowest_index():
    """3 x 3 cells in two parts: 4 of 9 cells, the first column and one cell of the second."""
    np.testing.assert_array_equal(bisect(grid(3, 3, 1), np.ones(9, dtype=np.int64), 2), [0, 0, 1, 0, 1, 1, 0, 1, 1])


@pytest.mark.parametrize("n_parts", [2, 4, 5, 8])
def test_long_bar_is_cut_across_x(n_parts):
    """The bar of sec. 4.1: 200 x 8 x 8 cells are cut into slices, each cut 8 x 8."""
    positions = grid(200, 8, 8)
    owner = bisect(positions, np.ones(len(positions), dtype=np.int64), n_parts)
    np.testing.assert_array_equal(owner, (positions[:, 0] * n_parts / 200).astype(int))
    assert dividing_surface(owner, 200, 8, 8) == 64 * (n_parts - 1)


@pytest.mark.parametrize(
    ("n_parts", "surface"),
    [(2, 240), (4, 3 * 240), (8, 3 * 240 + 4 * 160), (16, 3 * 240 + 4 * 160 + 8 * 120)],
)
def test_plate_is_cut_on_the_smallest_surfaces(n_parts, surface):
    """160 x 60 x 4 cells: strips 40 wide first, then halves 30 high, then 20 x 30 tiles; never across z."""
    positions = grid(160, 60, 4)
    owner = bisect(positions, np.ones(len(positions), dtype=np.int64), n_parts)
    assert dividing_surface(owner, 160, 60, 4) == surface
    assert (owner.reshape(4, 60, 160) == owner.reshape(4, 60, 160)[:1]).all()


def test_a_neck_is_preferred_to_the_longest_direction():
    """Two 8 x 20 plates joined by a neck of 8 x 2 cells: the plane across the neck, though y is longest."""
    positions = grid(24, 30, 1)
    x, y = positions[:, 0], positions[:, 1]
    cells = positions[(x < 8) | (x >= 16) | ((y >= 14) & (y < 16))]
    owner = bisect(cells, np.ones(len(cells), dtype=np.int64), 2)
    np.testing.assert_array_equal(owner, cells[:, 0] >= 12)


def test_long_cells_count_although_their_layers_are_far_apart():
    """Cut across x when 200 cells touch the plane, not when 800 do: then only 240 are near a plane in y."""
    positions = grid(20, 10, 10, spacing=(4.0, 1.0, 1.0))
    owner = bisect(positions, np.ones(2000, dtype=np.int64), 2)
    np.testing.assert_array_equal(owner, positions[:, 0] >= 40.0)
    positions = grid(4, 40, 10, spacing=(9.0, 1.0, 1.0))
    owner = bisect(positions, np.ones(1600, dtype=np.int64), 2)
    np.testing.assert_array_equal(owner, positions[:, 1] >= 20.0)


def test_the_answer_depends_on_the_arguments_alone():
    """Called again, with another memory layout and integer type: the same; the arguments are left alone."""
    rng = np.random.default_rng(3)
    positions, weights = rng.random((500, 3)), rng.integers(0, 50, 500)
    copies = positions.copy(), weights.copy()
    first = bisect(positions, weights, 7)
    np.testing.assert_array_equal(bisect(np.asfortranarray(positions), weights.astype(np.int32), 7), first)
    np.testing.assert_array_equal(positions, copies[0])
    np.testing.assert_array_equal(weights, copies[1])


def test_numbering_of_the_cells_does_not_move_the_planes():
    """Without equal coordinates a renumbered mesh is divided in the same way."""
    rng = np.random.default_rng(4)
    positions, weights, renumbered = rng.random((400, 3)), rng.integers(1, 9, 400), rng.permutation(400)
    owner = bisect(positions, weights, 6)
    np.testing.assert_array_equal(bisect(positions[renumbered], weights[renumbered], 6), owner[renumbered])


@pytest.mark.parametrize("shape", [(7, 5, 3), (9, 1, 1), (6, 4, 1)])
def test_mean_edge_of_a_box_of_cubes_is_their_edge(shape):
    edge = mean_edge(np.prod(shape), np.ptp(grid(*shape, spacing=(0.3, 0.3, 0.3)), axis=0))
    assert abs(edge - 0.3) <= EDGE_TOLERANCE * 0.3


def test_forty_thousand_cells_in_sixteen_parts_take_no_time():
    positions = grid(160, 63, 4)
    weights = np.where(positions[:, 1] < 20, 30, 1)
    start = time.perf_counter()
    owner = bisect(positions, weights, 16)
    assert time.perf_counter() - start < SECONDS
    parts = weights_of(owner, weights, 16)
    assert np.abs(parts - weights.sum() / 16).max() <= weights.max()


@pytest.mark.parametrize(
    ("positions", "weights", "n_parts"),
    [
        (np.zeros((3, 3)), np.ones(3, int), 0),
        (np.zeros((3, 2)), np.ones(3, int), 2),
        (np.zeros((4, 3)), np.ones(3, int), 2),
        (np.full((3, 3), np.nan), np.ones(3, int), 2),
        (np.zeros((3, 3)), np.array([1, -1, 1]), 2),
    ],
    ids=["no parts", "plane positions", "lengths differ", "nan", "negative weight"],
)
def test_wrong_input_is_refused(positions, weights, n_parts):
    with pytest.raises(ValueError, match="bisect"):
        bisect(positions, weights, n_parts)


def test_nothing_of_the_body_stays():
    """Not even until Python looks for garbage."""
    positions = grid(4, 4, 4).copy()
    held = weakref.ref(positions)
    gc.disable()
    try:
        bisect(positions, np.ones(64, np.int64), 3)
        del positions
        assert held() is None
    finally:
        gc.enable()
