"""A straight line through the mesh: nodes on it, points beside it, and how much of its length each of them has.

The nodes on a line cut it into stretches. Where a cell with unknowns at its nodes has an edge along a stretch, each end
has half of it. Where only cells of bonds have, their points nearest to the line have it, of one side of the line: that
along which most of the line is. What it leaves, as along a step, goes to the next side. No cell has an edge across a
notch, and nobody has what the line passes over there.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from pdfem_mpi.kernels.dense import lengths, product
from pdfem_mpi.kernels.hex8 import gauss_positions
from pdfem_mpi.mesh.hexmesh import HexMesh

#: Points are as near to a line as the nearest of their cell within this part of the distance.
AS_NEAR = 1e-6
#: Points lie on the same side of a line as the first of them where the cosine of the angle between is above this.
SAME_SIDE = 0.7


@dataclass(frozen=True)
class Stretches:
    """What lies between neighbouring stations, the places of nodes on a line.

    Attributes
    ----------
    station : int64, shape (n_nodes,)
        Of each node, rising along the line; -1 off the line.
    length : float64, shape (n_stations - 1,), dimension length^2
        Times the length of the line.
    """

    station: np.ndarray
    length: np.ndarray


@dataclass(frozen=True)
class Along:
    """Cells, or their edges, and the stretches along which each lies, one pair a row.

    Attributes
    ----------
    owner, stretch : int64, shape (n_pairs,)
    """

    owner: np.ndarray
    stretch: np.ndarray

    def parts(self, length: np.ndarray, chosen: np.ndarray) -> np.ndarray:
        """What each of the chosen pairs, bool (n_pairs,), has: all that are along a stretch have the same of it."""
        stretch = self.stretch[chosen]
        return length[stretch] / np.bincount(stretch, minlength=len(length))[stretch]


def from_line(x: np.ndarray, start: Any, stop: Any) -> tuple[np.ndarray, np.ndarray]:
    """Distances of places (n, 3) from a straight line with two ends, and their offsets from it, (n, 3)."""
    start, way = np.array(start), np.array(stop) - np.array(start)
    square = float((way * way).sum())
    share = np.clip(product(x - start, way) / square, 0.0, 1.0) if square else np.zeros(len(x))
    offset = x - start - share[:, None] * way
    return np.sqrt((offset**2).sum(axis=1)), offset


def points_at(mesh: HexMesh, cells: np.ndarray, point: Any) -> np.ndarray:
    """The points of cells that are nearest to a place, on the side of lower coordinates: rows of cell and point."""
    cell, g, side = _beside(mesh, cells, (point, point))
    return np.column_stack([cells[cell], g])[side == 0]


def share_line(mesh: HexMesh, on: np.ndarray, carries: np.ndarray, free: np.ndarray, line: Any, near: float):
    """Deal a line out among nodes with unknowns and points.

    Parameters
    ----------
    on, carries : bool, shape (n_nodes,)
        Nodes on the line, and those with unknowns.
    free : bool, shape (n_cells,)
        Cells of bonds with unknowns at their points; all others have them at their nodes.
    near : float
        Nodes less than this apart are at one place.

    Returns
    -------
    of_nodes : float64, shape (n_nodes,), dimension length^2
        Times the length of the line.
    points : int64, shape (n, 2)
        Rows of cell and Gauss point.
    of_points : float64, shape (n,)
    """
    stretches = _stretches(mesh, on, line, near)
    length = stretches.length
    cells = np.flatnonzero(on[mesh.cells].sum(axis=1, dtype=np.int8) >= 2)
    ends = _ends(mesh, stretches, cells)
    along = ends[:, 3] > ends[:, 2]
    cells, ends = cells[along], ends[along]
    of_nodes, taken = np.zeros(len(mesh.nodes)), np.zeros(len(length), bool)
    edges = np.unique(ends[~free[cells]], axis=0)
    if len(edges):
        pairs = _along(edges)
        half = 0.5 * pairs.parts(length, np.ones(len(pairs.owner), bool))
        for end in range(2):
            np.add.at(of_nodes, edges[pairs.owner, end], half)
        taken[pairs.stretch] = True
    _add_lonely(of_nodes, stretches, taken, np.flatnonzero(on & carries), ends)
    points, of_points = _share_beside(mesh, cells[free[cells]], _along(ends[free[cells]]), length, taken, line)
    if not of_nodes.any() and not len(points):
        of_nodes[on & carries] = 1.0
    return of_nodes, points, of_points


def _stretches(mesh: HexMesh, on: np.ndarray, line: Any, near: float) -> Stretches:
    start, way = np.array(line[0]), np.array(line[1]) - np.array(line[0])
    nodes = np.flatnonzero(on)
    along = product(mesh.nodes[nodes] - start, way)
    order = np.argsort(along, kind="stable")
    along = along[order]
    begins = np.append(True, np.diff(along) > near * float(np.sqrt((way * way).sum())))
    station = np.full(len(on), -1)
    station[nodes[order]] = np.cumsum(begins) - 1
    return Stretches(station, np.diff(along[begins]))


def _ends(mesh: HexMesh, stretches: Stretches, cells: np.ndarray) -> np.ndarray:
    """First and last node of each cell on the line, and their stations; int64, shape (n, 4)."""
    corners = mesh.cells[cells]
    station = stretches.station[corners]
    beyond = len(stretches.length) + 1
    pick = np.arange(len(cells))
    first, last = np.where(station < 0, beyond, station).argmin(axis=1), station.argmax(axis=1)
    return np.column_stack([corners[pick, first], corners[pick, last], station[pick, first], station[pick, last]])


def _along(ends: np.ndarray) -> Along:
    """Pairs of rows of `_ends` and the stretches between their stations."""
    count = ends[:, 3] - ends[:, 2]
    owner = np.repeat(np.arange(len(ends)), count)
    return Along(owner, np.arange(len(owner)) + np.repeat(ends[:, 2] - (np.cumsum(count) - count), count))


def _add_lonely(of_nodes, stretches: Stretches, taken: np.ndarray, carrying: np.ndarray, ends: np.ndarray) -> None:
    """A line through the inside of cells meets nodes of which no two are of one cell: halves of the ways between."""
    lonely = np.ones(len(stretches.length) + 1, bool)
    lonely[ends[:, 2:]] = False
    half = np.where((lonely[:-1] | lonely[1:]) & ~taken, 0.5 * stretches.length, 0.0)
    station = stretches.station[carrying]
    of_stations = np.append(half, 0.0) + np.append(0.0, half)
    of_nodes[carrying] += of_stations[station] / np.bincount(station, minlength=len(lonely))[station]


def _share_beside(mesh: HexMesh, cells: np.ndarray, pairs: Along, length: np.ndarray, taken: np.ndarray, line: Any):
    """Deal the stretches that are not taken out among points of cells: rows of cell and point, and their parts."""
    if taken[pairs.stretch].all():
        return np.empty((0, 2), np.int64), np.empty(0)
    cell, g, side = _beside(mesh, cells, line)
    of_rows, left = np.zeros(len(cell)), ~taken
    there = [np.isin(pairs.owner, cell[side == k]) for k in range(side.max() + 1)]
    while True:
        best, most = None, 0.0
        for k, chosen in enumerate(there):
            reached = np.zeros(len(length), bool)
            reached[pairs.stretch[chosen]] = True
            size = float(length[reached & left].sum())
            if size > most * (1.0 + AS_NEAR):
                best, most = k, size
        if best is None:
            break
        chosen = there[best] & left[pairs.stretch]
        of_cells = np.zeros(len(cells))
        np.add.at(of_cells, pairs.owner[chosen], pairs.parts(length, chosen))
        rows = side == best
        of_rows[rows] += (of_cells / np.maximum(np.bincount(cell[rows], minlength=len(cells)), 1))[cell[rows]]
        left[pairs.stretch[chosen]] = False
    has = of_rows > 0.0
    return np.column_stack([cells[cell[has]], g[has]]), of_rows[has]


def _beside(mesh: HexMesh, cells: np.ndarray, ends: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points of each cell that are nearest to a line: places among the cells, Gauss points, and numbers of their sides.

    Side 0 is that of lower coordinates, and so on.
    """
    if not len(cells):
        return (np.empty(0, np.int64),) * 3
    x = gauss_positions(mesh.nodes[mesh.cells[cells]])
    distance, offset = from_line(x.reshape(-1, 3), *ends)
    distance, offset = distance.reshape(-1, 8), offset.reshape(-1, 8, 3)
    cell, g = np.nonzero(distance <= distance.min(axis=1)[:, None] * (1.0 + AS_NEAR))
    offset = offset[cell, g]
    rounded = np.round(offset / (AS_NEAR * mesh.smallest_edge))
    offset[~rounded.any(axis=1)] = 0.0
    order, size = np.lexsort(rounded.T[::-1]), lengths(offset)
    side, sides = np.full(len(offset), -1), 0
    while len(left := order[side[order] < 0]):
        first = left[0]
        alike = (size > 0.0) & (product(offset, offset[first]) >= SAME_SIDE * (size * size[first]))
        alike |= (rounded == rounded[first]).all(axis=1)
        side[alike & (side < 0)] = sides
        sides += 1
    return cell, g, side
