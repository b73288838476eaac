"""What was taken out of a box of cells keeps bonds apart: none reaches across a notch, a hole or a corner."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pdfem_mpi.body.model_units import ModelUnits
from pdfem_mpi.deck.meshes import BoxMesh
from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.kernels.gap_cuts import cut_gaps
from pdfem_mpi.mesh.carving import is_removed
from pdfem_mpi.mesh.hexmesh import POSITION_TOLERANCE
from pdfem_mpi.peridynamics.clusters import by_component
from pdfem_mpi.peridynamics.points import Points
from pdfem_mpi.peridynamics.rows import Rows


@dataclass(frozen=True)
class Gaps:
    """Removed cells in a window of the box that holds the points of a rank.

    Attributes
    ----------
    scale : float64, shape (2, 3), dimensions 1 / length and 1
    removed : uint8, shape (nx, ny, nz)
    sums : int32, shape (nx + 1, ny + 1, nz + 1)
        As `kernels.gap_cuts` takes them.
    """

    scale: np.ndarray
    removed: np.ndarray
    sums: np.ndarray

    def keep_apart(self, points: Points, rows: Rows, finite: bool, counts: np.ndarray) -> None:
        """Take out bonds across removed cells; ``counts`` of bonds by materials lose them."""
        cut_gaps(*rows.arrays, points.x, self.scale, self.removed, self.sums, points.material, finite, counts)


def with_gaps(scene: Scene, units: ModelUnits, points: Points) -> Points:
    """The points with the gaps between them, where the deck removes cells of its box."""
    if not isinstance(scene.mesh, BoxMesh) or not scene.mesh.remove or not points.n_clusters:
        return points
    mesh = scene.mesh
    lower, upper, n = np.array(mesh.lower), np.array(mesh.upper), np.array(mesh.n_cells)
    edge = (upper - lower) / n
    scale = np.stack([units.length / edge, (units.origin - lower) / edge])
    x = by_component(points.x)  # (n_clusters, 3, 4)
    place = scale[0][:, None] * x + scale[1][:, None]
    first = np.floor(place.min(axis=(0, 2))).astype(np.int64)
    last = np.floor(place.max(axis=(0, 2))).astype(np.int64)
    # images lie beyond the planes: their cells are those that the mirrors show
    along = [
        low + (_folded(np.arange(a, b + 1), count) + 0.5) * side
        for a, b, count, low, side in zip(first, last, n, lower, edge, strict=True)
    ]
    centroids = np.stack(np.meshgrid(*along, indexing="ij"), axis=-1)
    tolerance = POSITION_TOLERANCE * float((upper - lower).max())
    removed = is_removed(mesh.remove, centroids.reshape(-1, 3), tolerance).reshape(centroids.shape[:3])
    sums = np.zeros(np.array(removed.shape) + 1, np.int32)
    sums[1:, 1:, 1:] = removed.cumsum(axis=0, dtype=np.int32).cumsum(axis=1).cumsum(axis=2)
    scale[1] -= first
    return replace(points, gaps=Gaps(scale, removed.astype(np.uint8), sums))


def _folded(index: np.ndarray, count: int) -> np.ndarray:
    """Cells of a row of ``count`` that mirrors at its ends show at any index."""
    index = index % (2 * count)
    return np.where(index < count, index, 2 * count - 1 - index)
