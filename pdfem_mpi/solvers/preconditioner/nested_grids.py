"""Grids over a body, and coarser ones below them down to one that is small enough for its factors."""

from __future__ import annotations

import numpy as np

from pdfem_mpi.body.share import Share
from pdfem_mpi.mesh.background_grid import CORNERS

#: Spacing of the grid in cell edges; of bodies with more cells than that, the wider one: a third of the grid's work and
#: memory for one or two iterations more (docs/scaling.md).
COARSENING, WIDER, MANY_CELLS = 2.0, 3.0, 50_000
#: Most unknowns of the last grid, which rank 0 has and factorises, and entries of its factor, 4 bytes each: a solve
#: takes about a millisecond, while the other ranks wait.
MOST_UNKNOWNS, MOST_FILL = 10_000, 2.5e6


def grid_counts(share: Share) -> tuple[np.ndarray, int]:
    """Cells of the grid along the axes, int64 (3,), and how often they are halved; by the whole body alone."""
    spacing = share.typical_edge * (WIDER if share.counts.cells > MANY_CELLS else COARSENING)
    counts = np.maximum(1, np.rint((share.upper - share.lower) / spacing)).astype(np.int64)
    n_halvings = 0
    while not _is_small(halved(counts, n_halvings)):
        n_halvings += 1
    return _nested(counts, n_halvings), n_halvings


def _is_small(counts: np.ndarray) -> bool:
    """Whether a grid can be the last: half the band of its factor is set by the two shorter axes."""
    nodes = np.sort(counts + 1)
    unknowns = 3 * int(np.prod(nodes))
    return unknowns <= MOST_UNKNOWNS and 3.0 * unknowns * float(nodes[0] * nodes[1]) <= MOST_FILL


def halved(counts: np.ndarray, times: int = 1) -> np.ndarray:
    """Cells along each axis of the grid ``times`` levels coarser; an axis of one cell stays."""
    for _ in range(times):
        counts = (counts + 1) // 2
    return counts


def ratio_of(counts: np.ndarray) -> np.ndarray:
    """Cells along each axis in one of the next coarser grid: 2, or 1 where there is but one; int64, shape (3,)."""
    return np.where(counts == halved(counts), 1, 2)


def number_in(counts: np.ndarray, index: np.ndarray) -> np.ndarray:
    """Numbers of the cells with these indices, (n, 3), among so many along the axes; int64, shape (n,)."""
    return (index[:, 0] * counts[1] + index[:, 1]) * counts[2] + index[:, 2]


def coarser_nodes(nodes: np.ndarray, counts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Trilinear interpolation from the grid of half the cells.

    Parameters
    ----------
    nodes : int64, shape (n_nodes,)
        Numbers of nodes of the grid with so many cells along the axes.
    counts : int64, shape (3,)

    Returns
    -------
    corners : int64, shape (n_nodes, 8)
        Numbers of nodes of the coarser grid; one without weight is named again in place of one beside the body.
    weights : float64, shape (n_nodes, 8)
    """
    ratio = ratio_of(counts)
    index = np.stack(np.unravel_index(nodes, counts + 1), axis=1)
    base, odd = index // ratio, index % ratio
    # an odd node lies half-way between two coarser ones, an even one on one of them
    corners = [number_in(halved(counts) + 1, base + corner * odd) for corner in CORNERS]
    weights = [np.prod(np.where(odd == 1, 0.5, 1.0 - corner), axis=1) for corner in CORNERS]
    return np.stack(corners, axis=1), np.stack(weights, axis=1)


def _nested(counts: np.ndarray, times: int) -> np.ndarray:
    """The next larger counts that can be halved so often, or down to 1."""
    for axis, count in enumerate(counts):
        whole = 2 ** min(times, int(count - 1).bit_length())
        counts = np.where(np.arange(3) == axis, -(-count // whole) * whole, counts)
    return counts
