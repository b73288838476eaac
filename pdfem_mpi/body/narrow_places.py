"""Places narrower than a cell: the node at a point, nodes on a line, nodes in a box, and peridynamic points there.

A roller or a pin must not clamp the rotation about it. Nodes on a line do not. Of the points of bonds, which lie inside
of cells, only one row is taken: two rows, on both sides of the line, would.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from pdfem_mpi.body.discretization import Discretization
from pdfem_mpi.deck.table import SceneError
from pdfem_mpi.kernels.dense import lengths, product
from pdfem_mpi.kernels.hex8 import gauss_positions

#: A node is on a point or a line within this part of the shortest edge.
NEAR = 1e-3
#: Points are as near to a line as the nearest of their cell within this part of the distance.
AS_NEAR = 1e-6
#: Points lie on the same side of a line as the first of them where the cosine of the angle between is above this.
SAME_SIDE = 0.7
NO_POINTS = np.empty((0, 2), np.int64)


def is_narrow(entry: Any) -> bool:
    """Whether a support speaks of nodes and points by themselves."""
    return any(getattr(entry, name, None) is not None for name in ("point", "line")) or (
        getattr(entry, "of", "cells") == "nodes"
    )


def select_narrow(whole: Discretization, entry: Any, where: str) -> tuple[np.ndarray, np.ndarray]:
    """Nodes with unknowns, rising, and rows of cell and Gauss point, int64, shape (n, 2).

    Raises
    ------
    SceneError
        Nothing is there.
    """
    mesh, free = whole.mesh, whole.has_points & ~whole.is_overlap
    if entry.point is None and entry.line is None:
        return _in_box(whole, entry, free, where)
    ends = (entry.point, entry.point) if entry.line is None else entry.line
    near = NEAR * mesh.smallest_edge
    distance, _ = _from_line(mesh.nodes, *ends)
    on = distance <= near
    if not on.any():
        first = int(np.argmin(distance))
        place = ", ".join(f"{c:.6g}" for c in mesh.nodes[first])
        key = "point" if entry.line is None else "line"
        raise SceneError(
            [
                f"{where}.{key} has no node of the mesh on it; the nearest is {distance[first]:.3g} away, at ({place})."
                ' Give a place where nodes are, or a box with of = "nodes".'
            ]
        )
    touching = np.flatnonzero(free)
    touching = touching[on[mesh.cells[touching]].sum(axis=1) >= (1 if entry.line is None else 2)]
    return np.flatnonzero(on & whole.carries), _nearest_points(whole, touching, ends)


def spread(whole: Discretization, entry: Any, where: str) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Nodes and points of a force, as `select_narrow` finds them, each with its part: its length of the line.

    Returns
    -------
    nodes, parts of nodes, points, parts of points
    """
    nodes, points = select_narrow(whole, entry, where)
    mesh = whole.mesh
    if entry.line is None:
        of_nodes, of_points = np.ones(len(nodes)), np.ones(len(points))
    else:
        start, way = np.array(entry.line[0]), np.array(entry.line[1]) - np.array(entry.line[0])
        along = product(mesh.nodes - start, way)
        of_nodes = _tributary(along[nodes])
        cells, which, count = np.unique(points[:, 0], return_inverse=True, return_counts=True)
        lengths = np.ptp(along[mesh.cells[cells]], axis=1) if len(cells) else np.empty(0)
        of_points = (lengths / count)[which]
    whole_length = float(of_nodes.sum() + of_points.sum())
    return nodes, of_nodes / whole_length, points, of_points / whole_length


def _tributary(place: np.ndarray) -> np.ndarray:
    """Half of the way to the neighbours on both sides, of places on a line; 1 for a single one."""
    if len(place) < 2:
        return np.ones(len(place))
    order = np.argsort(place, kind="stable")
    half = 0.5 * np.diff(place[order])
    lengths = np.empty(len(place))
    lengths[order] = np.append(half, 0.0) + np.append(0.0, half)
    return lengths


def _nearest_points(whole: Discretization, cells: np.ndarray, ends: Any) -> np.ndarray:
    """Points of each cell that are nearest to a line, on one side of it; rows of cell and Gauss point."""
    if not len(cells):
        return NO_POINTS
    x = gauss_positions(whole.mesh.nodes[whole.mesh.cells[cells]])
    distance, offset = _from_line(x.reshape(-1, 3), *ends)
    distance, offset = distance.reshape(-1, 8), offset.reshape(-1, 8, 3)
    cell, g = np.nonzero(distance <= distance.min(axis=1)[:, None] * (1.0 + AS_NEAR))
    offset = offset[cell, g]
    first = np.round(offset / (AS_NEAR * whole.mesh.smallest_edge))
    first = offset[np.lexsort(first.T[::-1])[0]]
    size = lengths(offset) * lengths(first)
    side = product(offset, first) >= SAME_SIDE * size
    return np.column_stack([cells[cell[side]], g[side]])


def _from_line(x: np.ndarray, start: Any, stop: Any) -> tuple[np.ndarray, np.ndarray]:
    """Distances of places (n, 3) from a straight line with two ends, and their offsets from it, (n, 3)."""
    start, way = np.array(start), np.array(stop) - np.array(start)
    square = float((way * way).sum())
    share = np.clip(product(x - start, way) / square, 0.0, 1.0) if square else np.zeros(len(x))
    offset = x - start - share[:, None] * way
    return np.sqrt((offset**2).sum(axis=1)), offset


def _in_box(whole: Discretization, entry: Any, free: np.ndarray, where: str) -> tuple[np.ndarray, np.ndarray]:
    """Nodes with unknowns and free points that lie in a closed box."""
    mesh = whole.mesh
    lower = np.full(3, -np.inf) if entry.lower is None else np.array(entry.lower) - mesh.tolerance
    upper = np.full(3, np.inf) if entry.upper is None else np.array(entry.upper) + mesh.tolerance

    def inside(x: np.ndarray) -> np.ndarray:
        return ((x >= lower) & (x <= upper)).all(axis=-1)

    nodes = np.flatnonzero(inside(mesh.nodes) & whole.carries)
    corners = mesh.nodes[mesh.cells]
    reached = (corners.max(axis=1) >= lower).all(axis=1) & (corners.min(axis=1) <= upper).all(axis=1)
    cells = np.flatnonzero(free & reached)
    cell, g = np.nonzero(inside(gauss_positions(corners[cells])))
    if not len(nodes) and not len(cell):
        raise SceneError(
            [f"{where} has no node of elements and no peridynamic point in its box. Widen it, or leave out of."]
        )
    return nodes, np.column_stack([cells[cell], g])
