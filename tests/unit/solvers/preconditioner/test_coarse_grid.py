"""Levels of the coarse grid: moments, rows, ways between grids and cycles, against direct sums and dense matrices."""

import numpy as np
import pytest

from pdfem_mpi.deck.loads import BodyForce, Support
from pdfem_mpi.kernels.hex8 import gauss_positions
from pdfem_mpi.mesh.background_grid import add_moments
from pdfem_mpi.parallel.halo import build_halo
from pdfem_mpi.solvers.preconditioner import nested_grids
from pdfem_mpi.solvers.preconditioner.coarse_grid import _locate
from pdfem_mpi.solvers.preconditioner.grid_cells import (
    MOMENT_QUANTUM,
    GridCells,
    added_up,
    coarser_cells,
    moments_of_cells,
)
from pdfem_mpi.solvers.preconditioner.grid_stiffness import make_level, whole_stiffness
from pdfem_mpi.solvers.preconditioner.levels import cycle
from pdfem_mpi.solvers.preconditioner.nested_grids import coarser_nodes, halved
from pdfem_mpi.solvers.preconditioner.preconditioner import make_preconditioner
from support.bodies import build, local_share, make_scene

SINGLE = 1e-6  # relative: blocks are kept in single precision
PINNED = 1e-6  # relative: pins add 1e-8 of the diagonal on each level
ROUNDED = 1e-11  # relative: moments are rounded to 2**-40 of a cell
COUNTS, H = np.array([4, 3, 2]), np.array([2.0, 2.0, 2.0])
HELD = {
    "loads": (BodyForce(kind="body_force", face="x+", total=(0.0, 0.0, 0.1)),),
    "supports": (Support(face="x-", x=0.0, y=0.0, z=0.0),),
}


def cells_on(counts, h, held=0.0):
    """The cells of a grid over a box of elements, with what holds its Gauss points as if they were nodes."""
    share = local_share(make_scene((8, 6, 4), 8))
    own, n = np.arange(len(share.mesh.cells)), int(np.prod(counts))
    where, xi = _locate(gauss_positions(share.nodes[share.mesh.cells]).reshape(-1, 3), share.lower, h, counts)
    halo = build_halo(share.comm, np.arange(n), np.empty(0, np.int64), np.empty(0, np.int32))
    stiffest, quantum, moments = moments_of_cells(share, own, where, xi, halo, np.array([0.25]))
    add_moments(moments[:, -1], where, xi, np.full(len(where), held), np.full(n, MOMENT_QUANTUM))
    return share, GridCells(counts, h, np.arange(n), added_up(halo, moments, quantum, MOMENT_QUANTUM), stiffest)


def stiffness_of(cells, spring=0.0):
    return whole_stiffness(cells, np.array([0.25]), spring)


def matrix_of(level):
    """The matrix of a level that is all on this rank, column by column."""
    n = 3 * len(level.nodes)
    columns, residual = [], np.empty(n)
    for unit in np.eye(n):
        level.look(unit.reshape(-1, 3).copy(), np.zeros(n), residual)
        columns.append(-residual)
    return np.array(columns).T


def test_stiffness_gives_linear_fields_no_force_inside_and_the_right_energy():
    """Integrated by moments, a uniform strain has the energy of the body: volume times the energy density."""
    share, cells = cells_on(COUNTS, H)
    number, matrix = stiffness_of(cells)
    index = np.stack(np.unravel_index(np.flatnonzero(number >= 0), COUNTS + 1), axis=1)
    x = share.lower + index * H
    gradient = np.array([[1.0, 0.2, 0.0], [0.2, -0.5, 0.3], [0.0, 0.3, 0.4]])
    u = (x @ gradient).reshape(-1)
    lam = mu = 0.4 * share.youngs_modulus[0]  # nu = 1/4
    density = 0.5 * lam * np.trace(gradient) ** 2 + mu * (gradient**2).sum()
    assert 0.5 * u @ (matrix @ u) == pytest.approx(8 * 6 * 4 * density, rel=PINNED)
    inside = ((index > 0) & (index < COUNTS)).all(axis=1)
    force = (matrix @ u).reshape(-1, 3)[inside]
    assert np.abs(force).max() < PINNED * lam


def test_rows_are_those_of_the_whole_matrix_and_symmetric():
    share, cells = cells_on(COUNTS, H, held=0.5)
    level = make_level(share.comm, cells, np.array([0.25]), 7.0)
    found, expected = matrix_of(level), stiffness_of(cells, 7.0)[1].toarray()
    np.testing.assert_array_equal(found, found.T)
    np.testing.assert_allclose(found, expected, rtol=0, atol=SINGLE * np.abs(expected).max())
    np.testing.assert_allclose(0.5 / level.smoother, np.diag(expected), rtol=1e-12)


@pytest.mark.parametrize("counts", [(4, 6, 2), (4, 1, 2)])
def test_moments_of_a_coarser_grid_are_those_of_its_points(counts):
    """Worked out from the finer grid's, they are those that the points themselves have in the coarser cells."""
    counts = np.array(counts)
    h = np.array([8.0, 6.0, 4.0]) / counts
    share, fine = cells_on(counts, h, held=0.25)
    coarse = coarser_cells(share.comm, fine, 1, last=False)
    _, direct = cells_on(halved(counts), np.array([8.0, 6.0, 4.0]) / halved(counts), held=0.25)
    np.testing.assert_array_equal(coarse.ids, direct.ids)
    np.testing.assert_array_equal(coarse.stiffest, direct.stiffest)
    np.testing.assert_array_equal(coarse.h, direct.h)
    scale = np.abs(direct.moments).max(axis=(0, 2), keepdims=True)
    np.testing.assert_allclose(coarse.moments, direct.moments, rtol=0, atol=ROUNDED * scale.max())
    np.testing.assert_allclose(coarse.moments[:, -1], direct.moments[:, -1], rtol=0, atol=ROUNDED * scale[0, -1, 0])


def test_a_coarser_stiffness_is_that_of_interpolated_displacements():
    """From moments comes ``T^t A T``, as far as pins go."""
    counts, h = np.array([4, 6, 2]), np.array([2.0, 1.0, 2.0])
    share, cells = cells_on(counts, h, held=0.25)
    number, fine = stiffness_of(cells, 7.0)
    _, coarse = stiffness_of(coarser_cells(share.comm, cells, 1, last=True), 7.0)
    corners, weights = coarser_nodes(np.flatnonzero(number >= 0), counts)
    table = np.zeros((len(corners), int(np.prod(halved(counts) + 1))))
    np.add.at(table, (np.arange(len(corners))[:, None], corners), weights)
    table = np.kron(table, np.eye(3))
    expected = table.T @ fine.toarray() @ table
    np.testing.assert_allclose(coarse.toarray(), expected, rtol=0, atol=PINNED * np.abs(expected).max())


@pytest.mark.parametrize("counts", [(4, 2, 2), (6, 1, 4), (4, 2, 1)])
def test_ways_between_grids_are_exact_for_linear_functions(counts):
    """Trilinear interpolation from half the cells, an axis of one cell kept."""
    counts = np.array(counts)
    nodes = np.arange(int(np.prod(counts + 1)))
    corners, weights = coarser_nodes(nodes, counts)
    ratio = np.where(counts == halved(counts), 1, 2)
    x = np.stack(np.unravel_index(nodes, counts + 1), axis=1) @ np.array([0.3, -0.7, 1.1])
    places = np.stack(np.unravel_index(np.arange(int(np.prod(halved(counts) + 1))), halved(counts) + 1), axis=1) * ratio
    values = places @ np.array([0.3, -0.7, 1.1])
    np.testing.assert_allclose((weights * values[corners]).sum(axis=1), x, rtol=1e-14, atol=1e-14)


@pytest.mark.parametrize(
    ("cells", "most", "expected", "n_halvings"),
    [
        ((8, 4, 4), 5_000, (4, 2, 2), 0),
        ((16, 8, 8), 300, (8, 4, 4), 1),
        ((38, 9, 5), 100, (20, 4, 2), 2),
        ((40, 40, 5), 100, (24, 24, 2), 3),
    ],
)
def test_grids_are_halved_until_the_last_is_small(monkeypatch, cells, most, expected, n_halvings):
    """Thin sides are rounded up only as far as they can be halved; so few unknowns does the last grid have."""
    monkeypatch.setattr(nested_grids, "MOST_UNKNOWNS", most)
    counts, found = nested_grids.grid_counts(local_share(make_scene(cells, cells[0])))
    assert (tuple(counts), found) == (expected, n_halvings)
    for k in range(found):
        ratio = nested_grids.ratio_of(halved(counts, k))
        np.testing.assert_array_equal(halved(counts, k), ratio * halved(counts, k + 1))
    assert 3 * np.prod(halved(counts, found) + 1) <= most


@pytest.mark.parametrize("most", [300, 60])
def test_a_cycle_over_nested_grids_solves_within_a_few_rounds(monkeypatch, most):
    """Against the matrix of the first grid: a factor of 0.7 a cycle, the damping of block-free Jacobi steps."""
    monkeypatch.setattr(nested_grids, "MOST_UNKNOWNS", most)
    body = build(make_scene((16, 8, 8), 0, **HELD))
    grid = make_preconditioner(body.share, body.model, body.case).grid
    assert len(grid.levels) == {300: 1, 60: 2}[most]
    level = grid.levels[0]
    n = 3 * len(level.nodes)
    right, x = np.random.default_rng(0).standard_normal(n), np.zeros((n // 3, 3))
    residual = right.copy()
    for _ in range(8):
        x += cycle(grid.levels, grid.last, grid.down[1:], residual, 2.0**-43).reshape(-1, 3)
        level.look(x, right, residual)
    assert np.linalg.norm(residual) < 0.05 * np.linalg.norm(right)


def test_a_cycle_is_symmetric(monkeypatch):
    monkeypatch.setattr(nested_grids, "MOST_UNKNOWNS", 60)
    body = build(make_scene((16, 8, 8), 8, **HELD))
    grid = make_preconditioner(body.share, body.model, body.case).grid
    x, y = np.random.default_rng(1).standard_normal((2, 3 * len(grid.levels[0].nodes)))
    px, py = (cycle(grid.levels, grid.last, grid.down[1:], r, 2.0**-43) for r in (x, y))
    assert x @ px > 0.0
    assert abs(x @ py - y @ px) <= ROUNDED * np.sqrt((x @ px) * (y @ py))
