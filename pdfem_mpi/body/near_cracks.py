"""Cells near the initial cracks of a deck: elements do not know of them."""

from __future__ import annotations

import numpy as np

from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.kernels.dense import lengths, product
from pdfem_mpi.mesh.hexmesh import HexMesh


def near_cracks(scene: Scene, mesh: HexMesh, distance: float) -> np.ndarray:
    """Cells whose centroid is within a distance, in the deck's units, of a crack; bool, shape (n_cells,)."""
    found = np.zeros(len(mesh.cells), bool)
    for crack in scene.cracks:
        corners = np.array(crack.corners(mesh.lower.tolist(), mesh.upper.tolist()))
        near = np.flatnonzero(mesh.cells_in_box(corners.min(axis=0) - distance, corners.max(axis=0) + distance))
        if len(near):
            found[near] |= distance_to_polygon(mesh.centroids[near], corners) <= distance
    return found


def distance_to_polygon(x: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Distance of places to a plane polygon, its inside included.

    Parameters
    ----------
    x : float64, shape (n, 3), dimension length
    corners : float64, shape (m, 3), dimension length

    Returns
    -------
    float64, shape (n,), dimension length
    """
    ends = np.roll(corners, -1, axis=0)
    nearest = np.full(len(x), np.inf)
    for a, b in zip(corners, ends, strict=True):
        way = b - a
        along = np.clip(product(x - a, way) / max(float(product(way, way)), np.finfo(float).tiny), 0.0, 1.0)
        nearest = np.minimum(nearest, lengths(x - a - along[:, None] * way))
    normal = np.cross(corners - corners[0], ends - corners[0]).sum(axis=0)
    size = lengths(normal)
    if not size > 0.0:
        return nearest
    height = product(x - corners[0], normal / size)
    foot = x - height[:, None] * (normal / size)
    return np.where(_inside(foot, corners, ends, normal), np.minimum(np.abs(height), nearest), nearest)


def _inside(x: np.ndarray, corners: np.ndarray, ends: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Whether places of its plane lie in the polygon, by the crossings of a ray in its plane; bool, shape (n,)."""
    one, two = (d for d in range(3) if d != int(np.abs(normal).argmax()))
    inside = np.zeros(len(x), bool)
    for a, b in zip(corners, ends, strict=True):
        between = (a[two] > x[:, two]) != (b[two] > x[:, two])
        with np.errstate(divide="ignore", invalid="ignore"):
            at = a[one] + (x[:, two] - a[two]) * (b[one] - a[one]) / (b[two] - a[two])
        inside ^= between & (x[:, one] < at)
    return inside
