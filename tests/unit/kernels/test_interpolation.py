"""Interpolation (25) and the lumped force (26)."""

import numpy as np
import pytest

from pdfem_mpi.kernels import hex8, interpolation

N_CELLS, FIRST, N_OVERLAP = 6, 2, 3


@pytest.fixture
def cells():
    """Three overlap cells in a row, 16 nodes."""
    r, s, t = ((hex8.REFERENCE_NODES + 1) // 2).astype(int).T
    return (np.arange(N_OVERLAP)[:, None] + r + 4 * (s + 2 * t)).astype(np.int32)


def overlap_rows(table, rows):
    """Rows of the overlap's points, in the order cell, Gauss point, component."""
    block = table.reshape(N_CELLS, 2, 9, 4)[FIRST : FIRST + N_OVERLAP, :, rows]
    return block.transpose(0, 1, 3, 2).reshape(N_OVERLAP, 8, 3)


def displacements():
    """Seeded, multiples of 2^-30 below 1."""
    return np.round(np.random.default_rng(1).uniform(-1.0, 1.0, (16, 3)) * 2**30) / 2**30


def interpolated(u, cells):
    """A fresh table of sevens with the interpolated displacements in it."""
    table = np.full((2 * N_CELLS, 9, 4), 7.0)
    interpolation.interpolate(table, FIRST, cells, u)
    return table


def lumped(table, cells, ratio=1.0):
    """Node forces of a table of point forces."""
    force = np.zeros((16, 3), np.int64)
    interpolation.lump(force, table, FIRST, cells, ratio)
    return force


def point_forces(size=2**40):
    """Seeded integers in all rows of all cells: only rows 6-8 of the overlap may be read."""
    return np.random.default_rng(2).integers(-size, size, (2 * N_CELLS, 9, 4))


@pytest.mark.nojit
def test_interpolation_is_the_shape_functions(cells):
    """Eq. 25 at the Gauss points, in the table's layout; nothing else is written."""
    u = displacements()
    table = interpolated(u, cells)
    expected = np.einsum("pa,nac->npc", hex8.SHAPE_AT_GAUSS, u[cells])
    np.testing.assert_allclose(overlap_rows(table, slice(0, 3)), expected, rtol=0, atol=4e-15)
    table.reshape(N_CELLS, 2, 9, 4)[FIRST : FIRST + N_OVERLAP, :, :3] = 7.0
    assert (table == 7.0).all()


def test_translation_is_interpolated_exactly(cells):
    """A rigid translation stretches no bond of the overlap, not even by round-off."""
    points = overlap_rows(interpolated(np.tile([0.1, -1e6, np.pi], (16, 1)), cells), slice(0, 3))
    assert (points == [0.1, -1e6, np.pi]).all()


@pytest.mark.nojit
def test_lump_is_the_adjoint_of_interpolate(cells):
    """Work of the lumped forces on the nodes = work of the point forces on the points."""
    u, table = displacements(), point_forces()
    moved, force = overlap_rows(interpolated(u, cells), slice(0, 3)), overlap_rows(table, slice(6, 9))
    work = np.array([(lumped(table, cells) * u).sum(), (force * moved).sum()])
    # 24 points of 8 roundings to integers of 2^40, and float64 sums
    assert abs(work[0] - work[1]) < 1e-12 * abs(force * moved).sum()


def test_each_force_goes_to_its_own_point(cells):
    """Column by column: one unit force at a time gives the shape functions of its point."""
    size = 2**40
    for cell, p, c in np.ndindex(N_OVERLAP, 8, 3):
        table = np.zeros((2 * N_CELLS, 9, 4), np.int64)
        table[2 * (FIRST + cell) + p // 4, 6 + c, p % 4] = size
        expected = np.zeros((16, 3))
        expected[cells[cell], c] = hex8.SHAPE_AT_GAUSS[p] * size
        # at most 1/2 from each rounding, 7/2 at node 0, and round-off of the shape functions' sum
        assert abs(lumped(table, cells) - expected).max() <= 4


@pytest.mark.parametrize("ratio", [1.0, 4.0, 1024.0])
def test_no_force_is_lost(cells, ratio):
    """The nodes get exactly the sum of the points' forces, also in a finer quantum."""
    table = point_forces()
    total = overlap_rows(table, slice(6, 9)).sum(axis=(0, 1)) * int(ratio)
    assert (lumped(table, cells, ratio).sum(axis=0) == total).all()


def test_ratio_converts_the_quantum(cells):
    """Coarser node quanta: forces are a quarter, up to the roundings of the terms."""
    table = point_forces()
    assert abs(lumped(table, cells, 0.25) - lumped(table, cells) / 4).max() < 24 * 8


@pytest.mark.parametrize("n_parts", [2, 3])
def test_order_and_parts_do_not_change_a_bit(cells, n_parts):
    """Cells of the overlap summed apart, as ranks do."""
    table = point_forces()
    force = np.zeros((16, 3), np.int64)
    for part in np.array_split(np.arange(N_OVERLAP)[::-1], n_parts):
        for cell in part:
            interpolation.lump(force, table, FIRST + int(cell), cells[cell : cell + 1], 0.5)
    assert (force == lumped(table, cells, 0.5)).all()


def test_lump_adds(cells):
    """The forces of the elements are already there."""
    table = point_forces()
    force = np.full((16, 3), 5, np.int64)
    interpolation.lump(force, table, FIRST, cells, 1.0)
    assert (force == lumped(table, cells) + 5).all()


def test_points_of_an_element_patch_move_as_the_elements(cells):
    """Linear displacement of the nodes gives the same linear displacement of the Gauss points."""
    x = np.stack(np.unravel_index(np.arange(16), (2, 2, 4))[::-1], axis=1).astype(float)
    gradient = np.random.default_rng(3).uniform(-1.0, 1.0, (3, 3))
    points = overlap_rows(interpolated(x @ gradient, cells), slice(0, 3))
    np.testing.assert_allclose(points, hex8.gauss_positions(x[cells]) @ gradient, rtol=0, atol=1e-14)
