"""Levels of the coarse grid: factors of its stiffness, and a symmetric cycle over nested grids."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from pdfem_mpi.kernels.banded import factor_of_band, solution_of_band

if TYPE_CHECKING:
    from scipy import sparse

#: Damping and number of Jacobi steps before and after each correction of a multigrid cycle.
DAMPING, SMOOTHINGS = 0.5, 2


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


@dataclass(frozen=True)
class Level:
    """A grid of the cycle: its stiffness and the way to the next coarser one, or, on the last, its factors."""

    factor: Factor | None
    matrix: sparse.csr_array | None = None
    smoother: np.ndarray | None = None
    prolongation: sparse.csr_array | None = None


def solve(levels: tuple[Level, ...], right: np.ndarray) -> np.ndarray:
    """``C^-1 right`` on the first level, directly or by one symmetric cycle; float64, shape (n_unknowns,)."""
    level = levels[0]
    if level.factor is not None:
        return level.factor.solve(right)
    x = level.smoother * right
    for _ in range(SMOOTHINGS - 1):
        x += level.smoother * (right - level.matrix @ x)
    x += level.prolongation @ solve(levels[1:], level.prolongation.T @ (right - level.matrix @ x))
    for _ in range(SMOOTHINGS):
        x += level.smoother * (right - level.matrix @ x)
    return x


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
    place = np.empty(len(order), np.int64)
    place[order] = np.arange(len(order))
    entries = sparse.coo_array(matrix)
    row, column = place[entries.row], place[entries.col]
    lower = row >= column
    row, column, values = row[lower], column[lower], entries.data[lower]
    return Factor(*factor_of_band(row, column, values, len(order)), order)
