"""The order of a vector over the unknowns of a rank, known in this file alone.

First the free points, in clusters of four as the bond kernels read them: x of the four points, then y, then z. Then the
owned nodes: x, y and z of each.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pdfem_mpi.kernels.simd import W
from pdfem_mpi.peridynamics.clusters import by_component, cluster_layout, point_rows


@dataclass(frozen=True)
class Unknowns:
    """How many there are, and which is where.

    Attributes
    ----------
    n_points : int
        Free points of this rank, whole clusters of them.
    n_nodes : int
        Nodes that it owns.
    """

    n_points: int
    n_nodes: int

    @property
    def size(self) -> int:
        """Length of a vector over the unknowns."""
        return 3 * (self.n_points + self.n_nodes)

    def of_points(self, vector: np.ndarray) -> np.ndarray:
        """A view of the points' part, in cluster layout; shape (3 n_points,)."""
        return vector[: 3 * self.n_points]

    def of_nodes(self, vector: np.ndarray) -> np.ndarray:
        """A view of the nodes' part, shape (n_nodes, 3)."""
        return vector[3 * self.n_points :].reshape(-1, 3)

    def rows(self, vector: np.ndarray) -> np.ndarray:
        """A copy as rows of three, shape (n_points + n_nodes, 3): points by cluster and lane, then nodes."""
        return np.concatenate([point_rows(self.of_points(vector)), self.of_nodes(vector)])

    def join(self, rows: np.ndarray) -> np.ndarray:
        """The inverse of `rows`: a vector over the unknowns."""
        return np.concatenate([cluster_layout(rows[: self.n_points]), rows[self.n_points :].reshape(-1)])

    def components(self) -> np.ndarray:
        """0, 1 or 2 for unknowns along x, y or z; int64, shape (size,)."""
        along_points = np.arange(3 * self.n_points) // W % 3
        return np.concatenate([along_points, np.arange(3 * self.n_nodes) % 3])

    def along(self, vector: np.ndarray, d: int) -> np.ndarray:
        """The values along axis ``d``, shape (n_points + n_nodes,)."""
        return np.concatenate([by_component(self.of_points(vector))[:, d].reshape(-1), self.of_nodes(vector)[:, d]])
