"""Stiffness on a grid, from the moments of its cells: rows on the ranks that own them, or the matrix of the last grid.

A node's row is made whole by its owner, the terms of each block added in the order of the grid cells: the same bits on
any number of ranks, and the same above the diagonal as below it.
"""

from __future__ import annotations

from functools import cache
from itertools import product as pairs_of
from typing import TYPE_CHECKING

import numpy as np

from pdfem_mpi.kernels.dense import product
from pdfem_mpi.kernels.element_tables import lame_moduli
from pdfem_mpi.kernels.grid_rows import BLOCK
from pdfem_mpi.mesh.background_grid import CORNERS, cell_nodes, moment_table
from pdfem_mpi.parallel.comm import sum_integers
from pdfem_mpi.parallel.sums import exact_dots
from pdfem_mpi.solvers.preconditioner.grid_cells import GridCells
from pdfem_mpi.solvers.preconditioner.levels import DAMPING, LastLevel, Level, factorise
from pdfem_mpi.solvers.preconditioner.nested_grids import number_in
from pdfem_mpi.solvers.preconditioner.spread import spread_by_claims, with_copies
from pdfem_mpi.system.heap import large_arrays_apart

if TYPE_CHECKING:
    from scipy import sparse

#: Added to the diagonal, relative: pins the rigid motions of free bodies.
PIN = 1e-8
#: Grid cells whose stiffness is made together.
CHUNK = 1024
#: Nodes of the last grid whose columns are made together.
COLUMNS = 128
#: The block of a node and itself among the 27 around it.
DIAGONAL = 13
_OFFSETS = np.array(list(pairs_of((-1, 0, 1), repeat=3)))


@cache
def _table(a: int | None, b: int | None) -> np.ndarray:
    """`moment_table` of products of two of a cell's functions, differentiated along these axes, (27, 64)."""
    return moment_table((a, b)).reshape(27, 64)


def cell_stiffness(moments: np.ndarray, h: np.ndarray, ratios: np.ndarray, spring: float) -> np.ndarray:
    """Stiffness of each grid cell by corners and components, float64, shape (n_cells, 8, 3, 8, 3).

    Parameters
    ----------
    moments : float64, shape (n_cells, n_ratios + 3, 27)
        Of Young's modulus, for each of Poisson's ratios ``ratios``, and of the fixed x, y and z components.
    h : float64, shape (3,), dimension length
    spring : float, dimension force / length
        Of a fixed component.
    """
    stiffness = np.zeros((len(moments), 8, 3, 8, 3))
    for k, nu in enumerate(ratios):
        lam, mu = (float(modulus[0]) for modulus in lame_moduli(np.ones(1), float(nu)))
        for a, b in pairs_of(range(3), repeat=2):
            products = product(moments[:, k], _table(a, b)) / (h[a] * h[b])
            products = products.reshape(-1, 8, 8)
            stiffness[:, :, a, :, b] += lam * products
            stiffness[:, :, b, :, a] += mu * products
            if a == b:
                for c in range(3):
                    stiffness[:, :, c, :, c] += mu * products
    for d in range(3):
        held = product(moments[:, len(ratios) + d], _table(None, None))
        stiffness[:, :, d, :, d] += spring * held.reshape(-1, 8, 8)
    return stiffness


def make_level(comm, cells: GridCells, ratios: np.ndarray, spring: float) -> Level:
    """The rows of a grid's nodes, dealt out by who owns most of the cells around each. Collective."""
    counts = cells.counts
    claimed, n_claims = np.unique(cell_nodes(counts, 1, cells.ids[cells.active]), return_counts=True)
    nodes = spread_by_claims(comm, claimed, n_claims).owned
    around = _cells_around(comm, cells, nodes)
    table, stiffest = _rows(around, nodes, ratios, spring)
    diagonal = table[:, DIAGONAL, range(3), range(3)]
    there = np.where(stiffest > 0.0, stiffest, 1.0)[:, None]
    mean = exact_dots(comm, [(diagonal / there, np.ones_like(diagonal))])[0]
    mean /= max(3 * int(sum_integers(comm, np.array([len(nodes)]))[0]), 1)
    diagonal = diagonal + _pins(diagonal, there, mean)
    table[:, DIAGONAL, range(3), range(3)] = diagonal
    row, slot = np.nonzero((table != 0.0).any(axis=(2, 3)))
    index = np.stack(np.unravel_index(nodes, counts + 1), axis=1)
    column = number_in(counts + 1, index[row] + _OFFSETS[slot])
    spread = with_copies(comm, nodes, column, int(np.prod(counts + 1)))
    blocks = np.zeros((len(row), 3, BLOCK // 3), np.float32)
    blocks[:, :, :3] = table[row, slot].swapaxes(1, 2)
    return Level(
        nodes=nodes,
        start=np.searchsorted(row, np.arange(len(nodes) + 1)).astype(np.int32),
        column=spread.places(column).astype(np.int32),
        blocks=blocks.reshape(-1),
        smoother=(DAMPING / diagonal).reshape(-1),
        halo=spread.halo,
    )


def _cells_around(comm, cells: GridCells, nodes: np.ndarray) -> GridCells:
    """All cells of the body around some nodes, rising, wherever they are owned. Collective."""
    counts, owned = cells.counts, cells.ids
    lowest = np.stack(np.unravel_index(nodes, counts + 1), axis=1) - 1
    index = np.concatenate([lowest + corner for corner in CORNERS])
    inside = ((index >= 0) & (index < counts)).all(axis=1)
    spread = with_copies(comm, owned, number_in(counts, index[inside]), int(np.prod(counts)))
    moments = np.empty((len(spread.ids), *cells.moments.shape[1:]))
    stiffest = np.empty(len(spread.ids))
    for known, own in ((moments, cells.moments), (stiffest, cells.stiffest)):
        known[: len(owned)] = own
        spread.halo.scatter_forward(known)
    order = np.argsort(spread.ids, kind="stable")
    found = GridCells(counts, cells.h, spread.ids[order], moments[order], stiffest[order])
    there = found.active
    return GridCells(counts, cells.h, found.ids[there], found.moments[there], found.stiffest[there])


def _rows(cells: GridCells, nodes: np.ndarray, ratios: np.ndarray, spring: float) -> tuple[np.ndarray, np.ndarray]:
    """Blocks of each node with the 27 around it, (n, 27, 3, 3), and the stiffest material around it, (n,).

    A node is the last corner of the first of its cells: corners from the last to the first are cells in their order,
    however these are cut into chunks.
    """
    table, stiffest = np.zeros((len(nodes), 27, 3, 3)), np.zeros(len(nodes))
    apart = CORNERS[None] - CORNERS[:, None]
    slots = DIAGONAL + 9 * apart[..., 0] + 3 * apart[..., 1] + apart[..., 2]
    for first in range(0, len(cells.ids), CHUNK):
        chunk = slice(first, first + CHUNK)
        stiffness = cell_stiffness(cells.moments[chunk], cells.h, ratios, spring)
        stiffness = 0.5 * (stiffness + stiffness.transpose(0, 3, 4, 1, 2))
        corners = cell_nodes(cells.counts, 1, cells.ids[chunk])
        rows = np.minimum(np.searchsorted(nodes, corners), max(len(nodes) - 1, 0))
        for a in reversed(range(8)):
            mine = np.flatnonzero(nodes[rows[:, a]] == corners[:, a]) if len(nodes) else np.empty(0, np.int64)
            row = rows[mine, a]
            stiffest[row] = np.maximum(stiffest[row], cells.stiffest[chunk][mine])
            for b in range(8):
                table[row, slots[a, b]] += stiffness[mine, a, :, b, :]
    return table, stiffest


def make_last(comm, cells: GridCells, ratios: np.ndarray, spring: float) -> LastLevel:
    """Factors of the last grid on rank 0, which owns all of its cells."""
    nowhere = np.empty(0, np.int64)
    if comm.rank > 0:
        return LastLevel(nowhere, None, np.empty((0, 0)))
    with large_arrays_apart():  # rank 0 alone has these, one after the other
        number, matrix = whole_stiffness(cells, ratios, spring)
        return LastLevel(np.flatnonzero(number >= 0), factorise(matrix, number, cells.counts), np.empty((0, 0)))


def whole_stiffness(cells: GridCells, ratios: np.ndarray, spring: float) -> tuple[np.ndarray, sparse.csc_array]:
    """Numbers of the grid nodes that touch the body (-1 elsewhere), and the stiffness of their unknowns.

    Parameters
    ----------
    cells : GridCells
        All of the grid, rising. A node is pinned in proportion to the stiffest material around it.
    """
    from scipy import sparse

    active = cells.active
    corners = cell_nodes(cells.counts, 1, cells.ids[active])
    number = np.full(int(np.prod(cells.counts + 1)), -1)
    used = np.unique(corners)
    number[used] = np.arange(len(used))
    corners, moments = number[corners], cells.moments[active]

    def columns_of(nodes: range) -> sparse.csc_array:
        """The terms of some nodes' columns, added in the order of the cells."""
        here = (corners >= nodes.start) & (corners < nodes.stop)
        some = np.flatnonzero(here.any(axis=1))
        stiffness = cell_stiffness(moments[some], cells.h, ratios, spring)
        dofs = (3 * corners[some, :, None] + np.arange(3)).astype(np.int32)
        chosen, row, column = (
            np.broadcast_to(of, stiffness.shape)
            for of in (here[some][:, None, None, :, None], dofs[..., None, None], dofs[:, None, None])
        )
        places = row[chosen], column[chosen] - np.int32(3 * nodes.start)
        return sparse.coo_array((stiffness[chosen], places), shape=(3 * len(used), 3 * len(nodes))).tocsc()

    all_nodes = range(len(used))
    matrix = sparse.hstack([columns_of(all_nodes[k : k + COLUMNS]) for k in all_nodes[::COLUMNS]], format="csc")
    diagonal, around = matrix.diagonal(), np.zeros(len(used))
    np.maximum.at(around, corners, cells.stiffest[active][:, None])
    around = np.repeat(around, 3)
    matrix.data += matrix.T.tocsc().data  # in the same places, as blocks come whole
    matrix.data *= 0.5
    matrix.setdiag(diagonal + _pins(diagonal, around, (diagonal / around).mean()))
    matrix.eliminate_zeros()
    return number, matrix


def _pins(diagonal: np.ndarray, stiffest: np.ndarray, mean: float) -> np.ndarray:
    """What holds each unknown: a part of its diagonal, or of the mean diagonal of material as stiff as around it."""
    return PIN * np.maximum(diagonal, stiffest * mean)
