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
from scipy import sparse
from scipy.linalg import cholesky, solve_triangular

from pdfem_mpi.kernels.fronts import solve_fronts


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


def factorise(matrix: sparse.csr_array, fronts: list[Front], size: int) -> Factor:
    """Factors of a symmetric positive matrix with ``size`` unknowns a node.

    Raises
    ------
    numpy.linalg.LinAlgError
        The matrix is not positive.
    """
    components, waiting = np.arange(size), {}
    local = np.full(matrix.shape[0], -1)
    panels, rows_of, n_own = [], [], []
    for index, front in enumerate(fronts):
        own, around = (
            (size * nodes[:, None] + components).reshape(-1) for nodes in (front.nodes, front.around)
        )
        rows = np.concatenate([own, around])
        local[rows] = np.arange(len(rows))
        dense = np.zeros((len(rows), len(rows)))
        columns = matrix[own].tocoo()  # symmetric: rows are columns
        known = local[columns.col] >= 0  # what was eliminated before is in the children
        dense[local[columns.col[known]], columns.row[known]] = columns.data[known]
        for child in front.children:
            unknowns, left = waiting.pop(child)
            where = local[unknowns]
            dense[np.ix_(where, where)] += left
        local[rows] = -1
        m = len(own)
        if m:
            upper_left = cholesky(dense[:m, :m], lower=True, overwrite_a=True, check_finite=False)
            below = solve_triangular(upper_left, dense[m:, :m].T, lower=True, check_finite=False).T
            waiting[index] = around, dense[m:, m:] - below @ below.T
            np.fill_diagonal(upper_left, 1.0 / np.diagonal(upper_left))
            whole = np.concatenate([upper_left, below]).T  # columns one after another
            panels.append(whole[np.arange(len(rows)) >= np.arange(m)[:, None]].astype(np.float32))
        else:
            waiting[index] = around, dense
            panels.append(np.empty(0, np.float32))
        rows_of.append(rows)
        n_own.append(m)

    def starts(parts):
        return np.concatenate([[0], np.cumsum([len(part) for part in parts])]).astype(np.int64)

    return Factor(
        start=starts(rows_of),
        n_own=np.array(n_own, np.int64),
        rows=np.concatenate(rows_of).astype(np.int64),
        place=starts(panels),
        entries=np.concatenate(panels),
    )


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
