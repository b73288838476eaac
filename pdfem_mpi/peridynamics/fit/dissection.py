"""Cholesky's factors of a matrix over the nodes of a background grid of elements, by nested dissection.

Boxes of elements are halved across their longest axis, down to single elements. The nodes of the dividing plane, and
at last those inside an element, are eliminated together (a *front*) after everything on both sides of them; what they
leave is a dense matrix of the nodes around the box (Duff and Reid 1983). Factors are kept in single precision: they
precondition, and half the bytes are half the time of a solve. Products are in double precision, so that the solve is
as symmetric as a product of a matrix and its transpose.

Everything here is done alike on every rank, with arrays of the same shapes: the same bits everywhere.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from pdfem_mpi.kernels.dense import product
from pdfem_mpi.kernels.fronts import MARGIN, eliminate_front, solve_fronts


@dataclass(frozen=True)
class Front:
    """Nodes eliminated together, in their order, and those around their box, which are eliminated later."""

    nodes: np.ndarray
    around: np.ndarray
    children: tuple[int, ...]


@dataclass(frozen=True)
class Factor:
    """Cholesky's factors, front by front.

    Attributes
    ----------
    start : int64, shape (n_fronts + 1,)
        First of each front's rows in ``rows``.
    n_own : int64, shape (n_fronts,)
        How many of them are eliminated with it; they come first.
    rows : int64
        Unknowns.
    place : int64, shape (n_fronts + 1,)
        First of each front's entries.
    entries : float32
        Columns of the eliminated unknowns from the diagonal downwards, the diagonal inverted.
    """

    start: np.ndarray
    n_own: np.ndarray
    rows: np.ndarray
    place: np.ndarray
    entries: np.ndarray

    def solve(self, right: np.ndarray) -> np.ndarray:
        """Solution for one right-hand side, both of shape (n_unknowns,)."""
        x = right.copy()
        solve_fronts(self.start, self.n_own, self.rows, self.place, self.entries, x)
        return x


def dissect(counts: np.ndarray, number: np.ndarray) -> list[Front]:
    """Fronts of a grid of triquadratic elements, children before parents.

    Parameters
    ----------
    counts : int64, shape (3,)
        Elements along the axes.
    number : int64, shape (n_grid_nodes,)
        Numbers of the nodes of ``2 counts + 1`` planes, the last axis fastest; -1 for nodes that are not used.
    """
    fronts: list[Front] = []
    grid = number.reshape(2 * counts + 1)
    taken = np.zeros(grid.shape, bool)

    def front_of(lower, upper) -> int:
        box = tuple(slice(2 * a, 2 * b + 1) for a, b in zip(lower, upper, strict=True))
        axis = int(np.argmax(upper - lower))
        children, plane = [], box
        around = grid[box][taken[box]]
        if (upper - lower)[axis] > 1:
            middle = (lower[axis] + upper[axis]) // 2
            plane = (*box[:axis], slice(2 * middle, 2 * middle + 1), *box[axis + 1 :])
        nodes = grid[plane][~taken[plane]]
        taken[plane] = True
        if plane is not box:
            below, above = upper.copy(), lower.copy()
            below[axis] = above[axis] = middle
            children = [front_of(lower, below), front_of(above, upper)]
        fronts.append(Front(nodes[nodes >= 0], around[around >= 0], tuple(children)))
        return len(fronts) - 1

    front_of(np.zeros(3, np.int64), counts.copy())
    return fronts


@dataclass(frozen=True)
class BlockMatrix:
    """A symmetric matrix of blocks: that of nodes i and j is ``sum_k values[., k] tables[k]``.

    Attributes
    ----------
    start : int64, shape (n_nodes + 1,)
        First of each node's entries.
    column : int64, shape (n_entries,)
    values : float64, shape (n_entries, n_tables)
    tables : float64, shape (n_tables, size, size)
    raised : float64, shape (n_nodes * size,)
        Added to the diagonal.
    """

    start: np.ndarray
    column: np.ndarray
    values: np.ndarray
    tables: np.ndarray
    raised: np.ndarray

    def columns_of(self, nodes: np.ndarray, local: np.ndarray, n_rows: int) -> np.ndarray:
        """Columns of some nodes' unknowns, shape (n_rows, n_nodes * size), in rows by a local numbering of nodes.

        Blocks whose local number is negative are left out.
        """
        size = self.tables.shape[1]
        count = self.start[nodes + 1] - self.start[nodes]
        which = np.repeat(np.arange(len(nodes)), count)
        entry = np.arange(len(which)) + np.repeat(self.start[nodes] - np.cumsum(count) + count, count)
        row = local[self.column[entry]]
        entry, which, row = entry[row >= 0], which[row >= 0], row[row >= 0]
        dense = np.zeros((n_rows // size, size, len(nodes), size))
        blocks = product(self.values[entry], self.tables)
        dense[row, :, which, :] = blocks.swapaxes(1, 2)  # (i, j) is given, (j, i) its transpose is wanted
        dense = dense.reshape(n_rows, -1)
        own = np.arange(len(nodes) * size)
        unknowns = (size * nodes[:, None] + np.arange(size)).reshape(-1)
        dense[own, own] += self.raised[unknowns]
        return dense


def factorise(matrix: BlockMatrix, fronts: list[Front]) -> Factor:
    """Factors of a positive matrix over the nodes that were dissected.

    Raises
    ------
    ArithmeticError
        The matrix is not positive.
    """
    size = matrix.tables.shape[1]
    own_size = np.array([size * len(front.nodes) for front in fronts], np.int64)
    whole_size = own_size + np.array([size * len(front.around) for front in fronts], np.int64)
    start = np.concatenate([[0], np.cumsum(whole_size)])
    place = np.concatenate([[0], np.cumsum(own_size * whole_size - own_size * (own_size - 1) // 2)])
    rows, entries = np.empty(start[-1], np.int64), np.empty(place[-1], np.float32)
    local, waiting = np.full(len(matrix.start) - 1, -1), {}
    for index, front in enumerate(fronts):
        nodes = np.concatenate([front.nodes, front.around])
        m, n = own_size[index], whole_size[index]
        local[nodes] = np.arange(len(nodes))
        dense = np.zeros((n + MARGIN, n + MARGIN))
        dense[:m, :n] = matrix.columns_of(front.nodes, local, n).T  # what was eliminated before is in the children
        for child in front.children:
            around, left = waiting.pop(child)
            where = (size * local[around][:, None] + np.arange(size)).reshape(-1)
            dense[np.ix_(where, where)] += left
        local[nodes] = -1
        if eliminate_front(dense.reshape(-1), n + MARGIN, n, m) >= 0:
            raise ArithmeticError("the matrix of the fit is not positive")
        at = place[index]
        for c in range(m):
            entries[at : at + n - c] = dense[c, c:n]
            entries[at] = 1.0 / dense[c, c]
            at += n - c
        left = np.triu(dense[m:n, m:n])
        left += np.triu(left, 1).T
        waiting[index] = front.around, left
        rows[start[index] : start[index + 1]] = (size * nodes[:, None] + np.arange(size)).reshape(-1)
    return Factor(start, own_size, rows, place, entries)


def count_entries(counts: np.ndarray, size: int) -> float:
    """Entries of the factors where every element of a grid is used."""
    return float(size**2) * _count(tuple(int(n) for n in counts), (False,) * 6)


@lru_cache(maxsize=100_000)
def _count(lengths: tuple[int, ...], divided: tuple[bool, ...]) -> float:
    """Pairs of nodes in the fronts of a box, by which of its faces are dividing planes."""
    free = [2 * n + 1 - divided[2 * d] - divided[2 * d + 1] for d, n in enumerate(lengths)]
    around = float(np.prod([2.0 * n + 1 for n in lengths])) - float(np.prod(np.array(free, float)))
    axis = int(np.argmax(lengths))
    if lengths[axis] == 1:
        own, halves = float(np.prod(np.array(free, float))), 0.0
    else:
        own = float(np.prod(np.array(free, float))) / free[axis]
        middle = lengths[axis] // 2
        halves = 0.0
        for length, side in ((middle, 1), (lengths[axis] - middle, 0)):
            part = (*lengths[:axis], length, *lengths[axis + 1 :])
            faces = tuple(True if face == 2 * axis + side else flag for face, flag in enumerate(divided))
            halves += _count(part, faces)
    return own * (own + 1.0) / 2.0 + own * around + halves
