"""The cells of a body as a user sees them: corners, regions, and what describes each."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.measure.geometry import Geometry


@dataclass(frozen=True)
class Cells:
    """The hexahedra of the mesh, in its order; the points of those with points are eight each, in the same order.

    Attributes
    ----------
    corners : float64, shape (n_cells, 8, 3), dimension length
    region : str array, shape (n_cells,)
        Name of the region.
    model : str array, shape (n_cells,)
        "peridynamics", "finite elements" or "overlap", whose points follow nodes.
    """

    corners: np.ndarray
    region: np.ndarray
    model: np.ndarray

    @property
    def has_points(self) -> np.ndarray:
        """Cells with peridynamic points, bool, shape (n_cells,)."""
        return self.model != "finite elements"

    @property
    def centroids(self) -> np.ndarray:
        """Means of the corners, shape (n_cells, 3)."""
        return self.corners.mean(axis=1)


def list_cells(scene: Scene, geometry: Geometry) -> Cells:
    """The cells of a scene's body."""
    mesh = geometry.mesh
    model = np.where(geometry.has_points, "peridynamics", "finite elements")
    model[geometry.is_overlap] = "overlap"
    names = np.array([region.name for region in scene.regions])
    return Cells(mesh.nodes[mesh.cells], names[geometry.region], model)
