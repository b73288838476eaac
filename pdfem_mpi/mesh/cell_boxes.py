"""Which cells are near a place, without a look at all of them: boxes around bundles of cells that lie together."""

from __future__ import annotations

import numpy as np

#: Cells of a bundle.
BUNDLE = 64
#: Bundles whose boxes are made at a time.
BATCH = 2**8


class CellBoxes:
    """Boxes around bundles of a mesh's cells; those of single cells are made where they are needed.

    Parameters
    ----------
    nodes : float64, shape (n_nodes, 3), dimension length
    cells : int32, shape (n_cells, 8)
    centroids : float64, shape (n_cells, 3), dimension length
    """

    def __init__(self, nodes: np.ndarray, cells: np.ndarray, centroids: np.ndarray):
        self._nodes, self._cells, self._centroids = nodes, cells, centroids
        self._order = _lying_together(centroids)
        starts = np.arange(0, len(cells), BUNDLE)
        self._lower, self._upper = np.empty((2, len(starts), 3))
        for first in range(0, len(starts), BATCH):
            some = starts[first : first + BATCH]
            lower, upper = self._boxes(self._order[some[0] : some[-1] + BUNDLE])
            self._lower[first : first + BATCH] = np.minimum.reduceat(lower, some - some[0])
            self._upper[first : first + BATCH] = np.maximum.reduceat(upper, some - some[0])

    def within(self, lower: np.ndarray, upper: np.ndarray, reach: float) -> np.ndarray:
        """Cells whose boxes come as near as that to a box between two corners, or to a place; rising, int64 (n,)."""
        cells = self._of_bundles(_apart(self._lower, self._upper, lower, upper) <= reach)
        return cells[_apart(*self._boxes(cells), lower, upper) <= reach]

    def nearest(self, place: np.ndarray) -> tuple[float, int]:
        """Squared distance of a place from the nearest of the cells' middles, and that cell; the first of equals."""
        about = _apart(self._lower, self._upper, place, place)
        cells = self._of_bundles(about <= about.min())
        reach = np.sqrt(self._squares(cells, place).min())
        cells = self.within(place, place, reach)  # a cell's box is no farther than its middle
        square = self._squares(cells, place)
        first = int(np.argmin(square))
        return float(square[first]), int(cells[first])

    def around(self, cell: int) -> np.ndarray:
        """A cell and those that share a node with it, as `HexMesh.neighbours` has them; rising, int64 (n,)."""
        nodes = self._cells[cell]
        cells = self.within(self._nodes[nodes].min(axis=0), self._nodes[nodes].max(axis=0), 0.0)
        return cells[np.isin(self._cells[cells], nodes).any(axis=1)]

    def _boxes(self, cells: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        corners = self._nodes[self._cells[cells]]
        return corners.min(axis=1), corners.max(axis=1)

    def _of_bundles(self, chosen: np.ndarray) -> np.ndarray:
        places = (BUNDLE * np.flatnonzero(chosen)[:, None] + np.arange(BUNDLE)).reshape(-1)
        return np.sort(self._order[places[places < len(self._order)]]).astype(np.int64)

    def _squares(self, cells: np.ndarray, place: np.ndarray) -> np.ndarray:
        return ((self._centroids[cells] - place) ** 2).sum(axis=1)


def _lying_together(centroids: np.ndarray) -> np.ndarray:
    """An order of cells in which bundles lie together: slabs along x, columns along y in them, bundles along z.

    Returns
    -------
    int32, shape (n_cells,)
    """
    n, group = len(centroids), np.zeros(len(centroids), np.int64)
    across = int(np.ceil((n / BUNDLE) ** (1.0 / 3.0)))  # bundles of a column, and columns of a slab
    for axis, size in enumerate((BUNDLE * across**2, BUNDLE * across, BUNDLE)):
        order = np.lexsort((centroids[:, axis], group))
        group[order] = np.arange(n) // size
    return order.astype(np.int32)


def _apart(lower: np.ndarray, upper: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Distances of boxes, shape (n, 3) each, from one box, shape (3,) each; shape (n,), 0 where they meet."""
    gap = np.maximum(np.maximum(lower - high, low - upper), 0.0)
    return np.sqrt((gap * gap).sum(axis=1))
