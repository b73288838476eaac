"""Grids over a body, and coarser ones below them down to one that can be factorised."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pdfem_mpi.body.share import Share
from pdfem_mpi.mesh.background_grid import CORNERS
from pdfem_mpi.solvers.preconditioner.levels import DAMPING, Level, factorise

if TYPE_CHECKING:
    from scipy import sparse

#: Spacing of the grid in cell edges; of bodies with more cells than that, the wider one: a third of the grid's work and
#: memory for one or two iterations more (docs/scaling.md).
COARSENING, WIDER, MANY_CELLS = 2.0, 3.0, 50_000
#: Most entries of the factor, unknowns times half a band: 4 bytes each on rank 0, and 8 more while it is made.
MOST_FILL = 2.5e7


def grid_counts(share: Share) -> tuple[np.ndarray, int]:
    """Cells of the grid along the axes, int64 (3,), and how often they are halved; by the whole body alone."""
    spacing = share.typical_edge * (WIDER if share.counts.cells > MANY_CELLS else COARSENING)
    counts = np.maximum(1, np.rint((share.upper - share.lower) / spacing)).astype(np.int64)
    n_halvings = 0
    while _fill(_halved(counts, n_halvings)) > MOST_FILL:
        n_halvings += 1
    return _nested(counts, n_halvings), n_halvings


def nested_levels(number: np.ndarray, matrix, counts: np.ndarray, n_halvings: int) -> tuple[Level, ...]:
    """Levels from the finest grid to the one that is factorised."""
    levels = []
    for _ in range(n_halvings):
        below, prolongation = _prolongation(number, counts)
        levels.append(Level(None, matrix.tocsr(), DAMPING / matrix.diagonal(), prolongation))
        matrix = prolongation.T @ matrix @ prolongation
        number, counts = below, _halved(counts, 1)
    levels.append(Level(factorise(matrix, number, counts)))
    return tuple(levels)


def _halved(counts: np.ndarray, times: int) -> np.ndarray:
    """Cells along each axis of the grid ``times`` levels coarser; an axis of one cell stays."""
    for _ in range(times):
        counts = (counts + 1) // 2
    return counts


def _nested(counts: np.ndarray, times: int) -> np.ndarray:
    """The next larger counts that can be halved so often, where they are not 1."""
    coarsest = _halved(counts, times)
    return np.where(counts == 1, 1, coarsest * 2**times)


def _fill(counts: np.ndarray) -> float:
    """Entries of the factor: unknowns times half the band, which the two shorter axes set."""
    nodes = np.sort(counts + 1).astype(float)
    return 9.0 * float(np.prod(nodes)) * nodes[0] * nodes[1]


def _prolongation(number: np.ndarray, counts: np.ndarray) -> tuple[np.ndarray, sparse.csr_array]:
    """Trilinear interpolation from the grid of half the cells.

    Parameters
    ----------
    number : int64, shape (n_grid_nodes,)
        Numbers of the grid nodes in use, -1 elsewhere.
    counts : int64, shape (3,)

    Returns
    -------
    number : int64, shape (n_coarser_grid_nodes,)
    prolongation : sparse, shape (n_unknowns, n_coarser_unknowns)
    """
    from scipy import sparse

    coarser = _halved(counts, 1)
    ratio = np.where(counts == coarser, 1, 2)
    index = np.stack(np.unravel_index(np.flatnonzero(number >= 0), counts + 1), axis=1)
    base, odd = index // ratio, index % ratio
    rows, columns, weights = [], [], []
    for corner in CORNERS:
        # an odd node lies half-way between two coarser ones, an even one on one of them
        used = ((corner == 0) | (odd == 1)).all(axis=1)
        node = base[used] + corner
        rows.append(np.flatnonzero(used))
        columns.append((node[:, 0] * (coarser[1] + 1) + node[:, 1]) * (coarser[2] + 1) + node[:, 2])
        weights.append(np.prod(np.where(odd[used] == 1, 0.5, 1.0), axis=1))
    columns = np.concatenate(columns)
    below = np.full(int(np.prod(coarser + 1)), -1)
    below[np.unique(columns)] = np.arange(len(np.unique(columns)))
    scalar = sparse.coo_array(
        (np.concatenate(weights), (np.concatenate(rows), below[columns])), shape=(len(index), int(below.max()) + 1)
    )
    return below, sparse.csr_array(sparse.kron(scalar, sparse.eye_array(3)))
