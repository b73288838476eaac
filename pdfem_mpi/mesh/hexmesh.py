"""A mesh of eight-node hexahedra, and the selections of its nodes and cells that decks speak of."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from pdfem_mpi.kernels.dense import lengths
from pdfem_mpi.mesh.cell_boxes import CellBoxes
from pdfem_mpi.mesh.everywhere import Everywhere

#: A node lies on a plane, or a centroid in a box, within this fraction of the body's size.
POSITION_TOLERANCE = 1e-6
#: Local nodes of the six faces of a hexahedron (VTK order), seen from outside counter-clockwise.
FACES = np.array([(0, 4, 7, 3), (1, 2, 6, 5), (0, 1, 5, 4), (3, 7, 6, 2), (0, 3, 2, 1), (4, 5, 6, 7)])
#: Local nodes of the twelve edges: around the lower face, around the upper one, and between them.
EDGES = ((0, 1), (1, 2), (2, 3), (3, 0), (4, 5), (5, 6), (6, 7), (7, 4), (0, 4), (1, 5), (2, 6), (3, 7))
#: Cells whose edges are measured together.
BATCH = 2**12
#: Cells that a message names, at most.
LISTED = 3


@dataclass(frozen=True)
class HexMesh:
    """Hexahedra in VTK node order.

    Attributes
    ----------
    nodes : float64, shape (n_nodes, 3), dimension length
    cells : int32, shape (n_cells, 8)
        Node numbers of each cell.
    cell_sets, face_sets, node_sets : dict from name
        Named sets of a mesh file: numbers of cells, int64 (n,); nodes of faces, int32 (n, 4), -1 for nodes of no
        cell; numbers of nodes, int64 (n,).
    notes : tuple of str
        What the reader of a file left out by intention, or did; no part of the content.
    """

    nodes: np.ndarray
    cells: np.ndarray
    cell_sets: Mapping[str, np.ndarray] = field(default_factory=dict)
    face_sets: Mapping[str, np.ndarray] = field(default_factory=dict)
    node_sets: Mapping[str, np.ndarray] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    #: What it knows of cells beyond its own.
    everywhere = Everywhere()

    @cached_property
    def cell_id(self) -> np.ndarray:
        """Numbers of the cells in the whole mesh; int64, shape (n_cells,)."""
        return np.arange(len(self.cells))

    @cached_property
    def node_id(self) -> np.ndarray:
        """Numbers of the nodes in the whole mesh; int64, shape (n_nodes,)."""
        return np.arange(len(self.nodes))

    def sha256(self) -> str:
        """Identity of the content: the same nodes, cells and named sets in the same order have the same digest."""
        return _sha256(self)

    @cached_property
    def lower(self) -> np.ndarray:
        """Lower corner of the bounding box, shape (3,), dimension length."""
        return self.nodes.min(axis=0)

    @cached_property
    def upper(self) -> np.ndarray:
        """Upper corner of the bounding box, shape (3,), dimension length."""
        return self.nodes.max(axis=0)

    @cached_property
    def tolerance(self) -> float:
        """Distance within which positions count as equal, dimension length."""
        return POSITION_TOLERANCE * float((self.upper - self.lower).max())

    @cached_property
    def centroids(self) -> np.ndarray:
        """Mean of the eight nodes of each cell, shape (n_cells, 3), dimension length."""
        total = np.zeros((len(self.cells), 3))
        for a in range(8):
            total += self.nodes[self.cells[:, a]]
        return total / 8.0

    @cached_property
    def boxes(self) -> CellBoxes:
        """Which cells are near a place."""
        return CellBoxes(self.nodes, self.cells, self.centroids)

    @cached_property
    def _edge_range(self) -> tuple[float, float]:
        return _range_of_edges(self)

    @property
    def largest_edge(self) -> float:
        """Longest edge of all cells, dimension length."""
        return self._edge_range[1]

    @property
    def smallest_edge(self) -> float:
        """Shortest edge of all cells, dimension length."""
        return self._edge_range[0]

    @property
    def mean_edge(self) -> float:
        """Half-way between the shortest and the longest edge of all cells, dimension length."""
        return 0.5 * (self.smallest_edge + self.largest_edge)

    @cached_property
    def average_edge(self) -> float:
        """Mean over the twelve edges of all cells, the same bits in any numbering, dimension length."""
        return math.fsum(self.edges().reshape(-1)) / (12 * len(self.cells))

    def edges(self, cells: slice = slice(None)) -> np.ndarray:
        """Lengths of the twelve edges of some cells; float64, shape (12, n), dimension length."""
        corners = self.nodes[self.cells[cells]]
        return np.stack([lengths(corners[:, a] - corners[:, b]) for a, b in EDGES])

    def cells_in_box(self, lower, upper) -> np.ndarray:
        """Cells whose centroid lies in a closed box, bool (n_cells,); None for a corner sets no limit there."""
        inside = np.ones(len(self.cells), bool)
        if lower is not None:
            inside &= (self.centroids >= np.asarray(lower) - self.tolerance).all(axis=1)
        if upper is not None:
            inside &= (self.centroids <= np.asarray(upper) + self.tolerance).all(axis=1)
        return inside

    def nodes_on_face(self, face: str) -> np.ndarray:
        """Nodes on a plane of the bounding box, named ``x-``, ``x+``, ... ``z+``.

        Returns
        -------
        bool, shape (n_nodes,)
        """
        axis = "xyz".index(face[0])
        plane = (self.lower if face[1] == "-" else self.upper)[axis]
        return np.abs(self.nodes[:, axis] - plane) <= self.tolerance

    def faces_on_face(self, face: str) -> tuple[np.ndarray, np.ndarray]:
        """Cell faces whose four nodes lie on a plane of the bounding box.

        Returns
        -------
        cells : int64, shape (n_faces,)
        nodes : int32, shape (n_faces, 4)
        """
        on = self.nodes_on_face(face)[self.cells][:, FACES].all(axis=2)
        cell, side = np.nonzero(on)
        return cell, self.cells[cell[:, None], FACES[side]]

    @cached_property
    def boundary(self) -> tuple[np.ndarray, np.ndarray]:
        """Faces that belong to one cell only, in the order of cells: their cells and rows of ``FACES``; int64."""
        return _boundary(self)

    def neighbours(self, chosen: np.ndarray) -> np.ndarray:
        """The chosen cells and all cells that share a node with one of them.

        Parameters
        ----------
        chosen : bool, shape (n_cells,)

        Returns
        -------
        bool, shape (n_cells,)
        """
        touched = np.zeros(len(self.nodes), bool)
        touched[self.cells[chosen]] = True
        return touched[self.cells].any(axis=1)


def _range_of_edges(mesh: HexMesh) -> tuple[float, float]:
    """Shortest and longest edge of all cells, dimension length."""
    batches = (mesh.edges(slice(k, k + BATCH)) for k in range(0, len(mesh.cells), BATCH))
    ranges = [(float(edges.min()), float(edges.max())) for edges in batches]
    return min(low for low, _ in ranges), max(high for _, high in ranges)


def _boundary(mesh: HexMesh) -> tuple[np.ndarray, np.ndarray]:
    number = equal_rows(np.sort(mesh.cells[:, FACES].reshape(-1, 4), axis=1))
    return np.divmod(np.flatnonzero(np.bincount(number)[number] == 1), len(FACES))


def _sha256(mesh: HexMesh) -> str:
    digest = hashlib.sha256()
    for array, dtype in ((mesh.nodes, "<f8"), (mesh.cells, "<i4")):
        digest.update(f"{array.shape} ".encode() + np.ascontiguousarray(array, dtype).tobytes())
    for kind in ("cell_sets", "face_sets", "node_sets"):
        for name, members in sorted(getattr(mesh, kind).items()):
            digest.update(f"{kind} {len(name)} {name} {members.size} ".encode())
            digest.update(np.ascontiguousarray(members, "<i8").tobytes())
    return digest.hexdigest()


def list_cells(mesh: HexMesh, cells: np.ndarray) -> str:
    """The first few of some cells and where they are. Collective, if the mesh is a part.

    Parameters
    ----------
    cells : int64, shape (n,), or bool, shape (n_cells,)
        Places of the cells in any order, or which they are.
    """
    places = np.flatnonzero(cells) if cells.dtype == bool else np.unique(cells)
    places = places[mesh.everywhere.of_own(places)][:LISTED]
    first = [(int(mesh.cell_id[place]), mesh.centroids[place].tolist()) for place in places]
    first = sorted(mesh.everywhere.gathered(first))[:LISTED]
    return ", ".join(f"{number} at ({', '.join(f'{c:.6g}' for c in centroid)})" for number, centroid in first)


def with_own_nodes(cells: np.ndarray, n_nodes: int) -> tuple[np.ndarray, np.ndarray]:
    """Which of all nodes some cells have, bool (n_nodes,), and the cells by their places among these, as ``cells``.

    Parameters
    ----------
    cells : int, shape (n, k)
        Places among all nodes.
    """
    used = np.zeros(n_nodes, bool)
    used[cells] = True
    place = (np.cumsum(used) - 1).astype(cells.dtype)
    return used, place[cells]


def equal_rows(rows: np.ndarray) -> np.ndarray:
    """Number the distinct rows of a table from 0; int64, shape (n,).

    Parameters
    ----------
    rows : int32, shape (n, k)
    """
    order = np.lexsort(rows.T)
    changes = (rows[order][1:] != rows[order][:-1]).any(axis=1)
    number = np.empty(len(rows), np.int64)
    number[order] = np.concatenate([[0], np.cumsum(changes)]) if len(rows) else 0
    return number
