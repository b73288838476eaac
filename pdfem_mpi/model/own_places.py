"""Unknowns of the points and nodes that a table of the deck chose, as far as this rank owns them."""

from __future__ import annotations

import numpy as np

from pdfem_mpi.body.selection import ChosenPlaces
from pdfem_mpi.body.share import Share
from pdfem_mpi.model.unknowns import Unknowns


class OwnPlaces:
    """Rows, unknowns and numbers of chosen points and nodes: points first."""

    def __init__(self, share: Share, unknowns: Unknowns):
        self.share, self.order = share, unknowns
        self.free = _inverse(share.subdomain.free, len(share.mesh.cells))
        self.owned = _inverse(share.subdomain.owned_nodes, len(share.nodes))
        self.table = unknowns.rows(np.arange(unknowns.size)).astype(np.int64) if unknowns.size else None

    def rows(self, chosen: ChosenPlaces) -> tuple[np.ndarray, np.ndarray]:
        """Rows of points and of nodes, in the order of `Unknowns.rows`."""
        cells = self.free[chosen.cells]
        whole = 8 * cells[cells >= 0][:, None] + np.arange(8)
        cell = self.free[chosen.points[:, 0]]
        single = 8 * cell[cell >= 0] + chosen.points[cell >= 0, 1]
        nodes = self.owned[chosen.nodes] if self.order.n_nodes else np.empty(0, np.int64)
        return np.concatenate([whole.reshape(-1), single]), self.order.n_points + nodes[nodes >= 0]

    def unknowns(self, chosen: ChosenPlaces) -> tuple[np.ndarray, np.ndarray]:
        """Unknowns of points and of nodes, shape (n, 3) each."""
        none = np.empty((0, 3), np.int64)
        return tuple(none if self.table is None else self.table[rows] for rows in self.rows(chosen))

    def cells_of(self, chosen: ChosenPlaces) -> np.ndarray:
        """Number of each point's cell in the mesh."""
        return self.share.mesh.cell_id[self.share.subdomain.free[self.rows(chosen)[0] // 8]]

    def nodes_of(self, chosen: ChosenPlaces) -> np.ndarray:
        """Number of each node in the mesh."""
        rows = self.rows(chosen)[1] - self.order.n_points
        return self.share.mesh.node_id[self.share.subdomain.owned_nodes[rows]]


def _inverse(places: np.ndarray, n: int) -> np.ndarray:
    """Where each of n things stands in a list, -1 where it does not."""
    inverse = np.full(n, -1)
    inverse[places] = np.arange(len(places))
    return inverse
