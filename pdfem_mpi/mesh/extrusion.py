"""Meshes that are layers of one plane of cells: any piece of them is made by itself, with the numbers of the whole.

Planes lie one above the other along z. Node i of a plane with p nodes has the number ``p k + i`` on level k,
quadrilateral j of one with q of them makes the cell ``q k + j`` of layer k.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pdfem_mpi.mesh.hexmesh import HexMesh, with_own_nodes


@dataclass(frozen=True)
class Part:
    """Some quadrilaterals of a plane with their nodes, or some cells of a mesh.

    Attributes
    ----------
    nodes : float64, shape (n_nodes, 2 or 3), dimension length
    cells : int32, shape (n_cells, 4 or 8)
        Places among these nodes.
    cell_id, node_id : int64
        Numbers in the whole, rising.
    """

    nodes: np.ndarray
    cells: np.ndarray
    cell_id: np.ndarray
    node_id: np.ndarray


@dataclass(frozen=True)
class Grid:
    """A plane of rectangles between lines across x and y; x runs fastest.

    Attributes
    ----------
    lines : two float64 arrays, shapes (n_x + 1,), (n_y + 1,), dimension length
        Rising.
    """

    lines: tuple[np.ndarray, np.ndarray]

    @property
    def size(self) -> tuple[int, int]:
        """Quadrilaterals and nodes."""
        x, y = (len(lines) for lines in self.lines)
        return (x - 1) * (y - 1), x * y

    @property
    def box(self) -> tuple[np.ndarray, np.ndarray]:
        """Corners, shape (2,) each."""
        return tuple(np.array([lines[end] for lines in self.lines]) for end in (0, -1))

    def near(self, lower, upper, layers: int) -> Part:
        """Quadrilaterals with their middle in a half-open box, and layers of those that share a node with them."""
        (i, k), (j, m) = (_between(*ends, layers) for ends in zip(self.lines, lower, upper, strict=True))
        if not (k > i and m > j):
            i, k, j, m = 0, 0, 0, 0
        columns, rows = k - i + (k > i), m - j + (m > j)
        x, y = (lines[start : start + n] for lines, start, n in zip(self.lines, (i, j), (columns, rows), strict=True))
        nodes = np.column_stack([np.tile(x, rows), np.repeat(y, columns)])
        row, column = (index.reshape(-1) for index in np.mgrid[0 : m - j, 0 : k - i])
        first = (row * columns + column).astype(np.int32)
        cells = np.stack([first, first + 1, first + columns + 1, first + columns], axis=1)
        n = len(self.lines[0])
        node_id = ((j + np.arange(rows)) * n)[:, None] + i + np.arange(columns)
        return Part(nodes, cells, (j + row) * (n - 1) + i + column, node_id.reshape(-1))


@dataclass(frozen=True)
class Plane:
    """A plane of quadrilaterals that is stored whole.

    Attributes
    ----------
    nodes : float64, shape (n_nodes, 2), dimension length
    quads : int64, shape (n_quads, 4)
    """

    nodes: np.ndarray
    quads: np.ndarray

    @property
    def size(self) -> tuple[int, int]:
        """Quadrilaterals and nodes."""
        return len(self.quads), len(self.nodes)

    @property
    def box(self) -> tuple[np.ndarray, np.ndarray]:
        """Corners, shape (2,) each."""
        return self.nodes.min(axis=0), self.nodes.max(axis=0)

    @cached_property
    def middles(self) -> np.ndarray:
        """Of the quadrilaterals, shape (n_quads, 2), dimension length."""
        return self.nodes[self.quads].mean(axis=1)

    def near(self, lower, upper, layers: int) -> Part:
        """As `Grid.near`."""
        chosen = ((self.middles >= lower) & (self.middles < upper)).all(axis=1)
        used, quads = with_own_nodes(self.quads[chosen], len(self.nodes))
        for _ in range(layers):
            chosen = used[self.quads].any(axis=1)
            used, quads = with_own_nodes(self.quads[chosen], len(self.nodes))
        return Part(self.nodes[used], quads.astype(np.int32), np.flatnonzero(chosen), np.flatnonzero(used))


@dataclass(frozen=True)
class Extrusion:
    """Layers of a plane between levels.

    Attributes
    ----------
    plane : Grid or Plane
    levels : float64, shape (n_layers + 1,), dimension length
        Rising.
    """

    plane: Grid | Plane
    levels: np.ndarray

    @property
    def size(self) -> tuple[int, int]:
        """Cells and nodes."""
        quads, nodes = self.plane.size
        return quads * (len(self.levels) - 1), nodes * len(self.levels)

    @property
    def box(self) -> tuple[np.ndarray, np.ndarray]:
        """Corners, shape (3,) each, dimension length."""
        return tuple(np.append(corner, self.levels[end]) for corner, end in zip(self.plane.box, (0, -1), strict=True))

    def near(self, lower: np.ndarray, upper: np.ndarray, layers: int = 0) -> Part:
        """Cells with their middle in a half-open box, and layers of those that share a node with them.

        Parameters
        ----------
        lower, upper : float64, shape (3,), dimension length
        layers : int
        """
        plane = self.plane.near(lower[:2], upper[:2], layers)
        first, last = _between(self.levels, lower[2], upper[2], layers)
        if not (last > first and len(plane.cells)):
            none = np.empty(0, np.int64)
            return Part(np.empty((0, 3)), np.empty((0, 8), np.int32), none, none)
        quads, nodes = self.plane.size
        levels, n = self.levels[first : last + 1], len(plane.nodes)
        cell_id, node_id = (
            (size * np.arange(first, end)[:, None] + own).reshape(-1)
            for size, end, own in ((quads, last, plane.cell_id), (nodes, last + 1, plane.node_id))
        )
        return Part(*_extruded(plane.nodes, plane.cells, levels, n), cell_id, node_id)

    def whole(self) -> HexMesh:
        """All of it."""
        plane = self.plane.near(np.full(2, -np.inf), np.full(2, np.inf), 0)
        return HexMesh(*_extruded(plane.nodes, plane.cells, self.levels, len(plane.nodes)))


def _between(lines: np.ndarray, lower: float, upper: float, layers: int) -> tuple[int, int]:
    """First and last, exclusive, of the intervals between lines with their middle in a half-open range, and more."""
    middles = 0.5 * (lines[:-1] + lines[1:])
    first, last = np.searchsorted(middles, (lower, upper))
    return (max(int(first) - layers, 0), min(int(last) + layers, len(middles))) if last > first else (0, 0)


def _extruded(plane: np.ndarray, quads: np.ndarray, levels: np.ndarray, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Nodes and cells of a plane with n nodes on some levels."""
    nodes = np.column_stack([np.tile(plane, (len(levels), 1)), np.repeat(levels, n)])
    layers = (n * np.arange(len(levels) - 1, dtype=np.int32))[:, None, None]
    cells = np.concatenate([quads + layers, quads + layers + np.int32(n)], axis=2).reshape(-1, 8)
    return nodes, cells
