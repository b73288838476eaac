"""Levels of the coarse grid: rows of its stiffness on the ranks, factors of the last one, and a symmetric cycle."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pdfem_mpi.kernels.banded import factor_of_band, solution_of_band
from pdfem_mpi.kernels.dense import without_components
from pdfem_mpi.kernels.grid_rows import grid_residual
from pdfem_mpi.kernels.multigrid import interpolate, restrict
from pdfem_mpi.parallel.halo import Halo
from pdfem_mpi.solvers.preconditioner.spread import with_copies

#: Damping and number of Jacobi steps before and after each correction of a multigrid cycle.
DAMPING, SMOOTHINGS = 0.5, 2
#: What forces on nodes grow by from a grid to the one of half its cells, and the quantum of their sums with them.
GROWTH = 8.0


@dataclass(frozen=True)
class Transfer:
    """The way from nodes to a coarser grid and back.

    Attributes
    ----------
    corners : int32, shape (n_nodes, 8)
        Grid nodes around each node, the rank's own nodes first, by their places in the halo.
    weights : float64, shape (n_nodes, 8)
    halo : Halo
        Of the coarser grid's nodes: those that the rank owns, and others around its nodes.
    """

    corners: np.ndarray
    weights: np.ndarray
    halo: Halo

    def restrict(self, r: np.ndarray, quantum: float) -> np.ndarray:
        """``T^t r`` of the rank's own nodes, each term rounded to the quantum; float64, shape (n_owned * 3,).

        Collective.
        """
        sums, own = np.zeros((self.halo.n_owned + self.halo.n_ghost, 3), np.int64), slice(0, len(r) // 3)
        restrict(self.corners[own], self.weights[own], r, quantum, sums)
        self.halo.scatter_reverse(sums)
        return (sums[: self.halo.n_owned] * quantum).reshape(-1)

    def add(self, correction: np.ndarray, z: np.ndarray) -> None:
        """``z += T correction``, of shapes (n_nodes * 3,) and (n_owned * 3,). Collective."""
        known = np.empty((self.halo.n_owned + self.halo.n_ghost, 3))
        known[: self.halo.n_owned] = correction.reshape(-1, 3)
        self.halo.scatter_forward(known)
        interpolate(self.corners, self.weights, known, z)


def make_transfer(comm, corners: np.ndarray, weights: np.ndarray, owned: np.ndarray, n: int) -> Transfer:
    """The way from nodes with these grid nodes around them, by their numbers, to a grid with these owners. Collective.

    Parameters
    ----------
    corners, weights : int64 and float64, shape (n_nodes, 8)
    owned : int64, shape (n_owned,)
        Numbers of the grid nodes of this rank, rising.
    n : int
        Nodes of the whole grid.
    """
    spread = with_copies(comm, owned, corners, n)
    return Transfer(np.ascontiguousarray(spread.places(corners).astype(np.int32)), weights, spread.halo)


@dataclass(frozen=True)
class Level:
    """A grid that is smoothed: what a rank has of it.

    Attributes
    ----------
    nodes : int64, shape (n_owned,)
        Numbers of its grid nodes, rising.
    start, column, blocks
        Their rows of the stiffness, as in `kernels.grid_rows`.
    smoother : float64, shape (n_owned * 3,), dimension length / force
        Damping over the diagonal.
    halo : Halo
        Of these grid nodes and those of others that the rows meet.
    """

    nodes: np.ndarray
    start: np.ndarray
    column: np.ndarray
    blocks: np.ndarray
    smoother: np.ndarray
    halo: Halo

    def smooth(self, x: np.ndarray, right: np.ndarray, residual: np.ndarray) -> None:
        """A step towards the solution; overwrites the residual by that before it. Collective."""
        self.look(x, right, residual)
        x[: self.halo.n_owned] += (self.smoother * residual).reshape(-1, 3)

    def look(self, x: np.ndarray, right: np.ndarray, residual: np.ndarray) -> None:
        """``residual = right - A x``, shape (n_owned * 3,), and ``x``, (n_owned + n_ghost, 3), whole. Collective."""
        self.halo.scatter_forward(x)
        grid_residual(self.start, self.column, self.blocks, x.reshape(-1), right, residual)


@dataclass(frozen=True)
class LastLevel:
    """The last grid, on rank 0.

    Attributes
    ----------
    nodes : int64, shape (n_nodes,)
        Numbers of its grid nodes; none on other ranks.
    factor : Factor or None
    free : float64, shape (n_motions, 3 n_nodes)
        Orthonormal rigid motions that nothing holds. They are kept out of the solve: round-off along them would be
        amplified by the inverse of the pins.
    """

    nodes: np.ndarray
    factor: Factor | None
    free: np.ndarray

    def solve(self, right: np.ndarray) -> np.ndarray:
        """Solution for one right-hand side, both of shape (n_nodes * 3,)."""
        if self.factor is None:
            return right
        return without_components(self.free, self.factor.solve(without_components(self.free, right)))


@dataclass(frozen=True)
class Factor:
    """Cholesky factor of a banded matrix, laid out as in `kernels.banded`.

    Attributes
    ----------
    corners : float64, shape (n_groups * 16,)
    panels : float32, shape (n_groups * 4 * reach,)
    reach : int
        Rows of a panel.
    order : int64, shape (n_unknowns,)
        Unknowns in the order of the factor, the longest axis of the grid outermost.
    """

    corners: np.ndarray
    panels: np.ndarray
    reach: int
    order: np.ndarray

    def solve(self, right: np.ndarray) -> np.ndarray:
        """Solution for one right-hand side, both of shape (n_unknowns,)."""
        x = np.empty_like(right)
        x[self.order] = solution_of_band(self.corners, self.panels, self.reach, right[self.order])
        return x


def cycle(
    levels: tuple[Level, ...], last: LastLevel, down: tuple[Transfer, ...], right: np.ndarray, quantum: float
) -> np.ndarray:
    """``C^-1 right`` on the first level, directly or by one symmetric cycle. Collective.

    Parameters
    ----------
    levels, last : tuple of Level, LastLevel
        From fine to coarse.
    down : tuple of Transfer
        From each level to the next.
    right : float64, shape (n_owned * 3,)
    quantum : float
        Of the sums of forces on the first level.

    Returns
    -------
    float64, shape (n_owned * 3,)
    """
    if not levels:
        return last.solve(right)
    level, residual = levels[0], np.empty_like(right)
    x = np.zeros((level.halo.n_owned + level.halo.n_ghost, 3))
    own = x[: level.halo.n_owned].reshape(-1)
    own[:] = level.smoother * right
    for _ in range(SMOOTHINGS - 1):
        level.smooth(x, right, residual)
    level.look(x, right, residual)
    quantum *= GROWTH
    down[0].add(cycle(levels[1:], last, down[1:], down[0].restrict(residual, quantum), quantum), own)
    for _ in range(SMOOTHINGS):
        level.smooth(x, right, residual)
    return own


def factorise(matrix, number: np.ndarray, counts: np.ndarray) -> Factor:
    """Factor of a symmetric positive matrix on a grid's nodes in use, computed in double precision.

    Parameters
    ----------
    matrix : sparse, shape (n_unknowns, n_unknowns)
    number : int64, shape (n_grid_nodes,)
        Numbers of the grid nodes in use, -1 elsewhere.
    counts : int64, shape (3,)

    Raises
    ------
    ArithmeticError
        The matrix is not positive.
    """
    from scipy import sparse

    index = np.stack(np.unravel_index(np.flatnonzero(number >= 0), counts + 1))
    nodes = np.lexsort(index[np.argsort(counts, kind="stable")])
    order = (3 * nodes[:, None] + np.arange(3)).reshape(-1)
    place = np.empty(len(order), np.int32)
    place[order] = np.arange(len(order))
    entries = sparse.coo_array(matrix)
    row, column = place[entries.row], place[entries.col]
    lower = row >= column
    entries = row[lower], column[lower], entries.data[lower]
    del row, column, lower
    return Factor(*factor_of_band(*entries, len(order)), order)
