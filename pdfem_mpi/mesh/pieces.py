"""A generated mesh of which each rank makes pieces, with the numbers and measures of the whole, which nobody makes.

The box around the body is dealt out in blocks by halving it; what is asked of all cells is asked of each block's. Where
parts are taken out of a box, what is left is numbered by a directory.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from pdfem_mpi.mesh.carving import is_removed
from pdfem_mpi.mesh.everywhere import Everywhere
from pdfem_mpi.mesh.extrusion import Extrusion, Part
from pdfem_mpi.mesh.faces import connected
from pdfem_mpi.mesh.hexmesh import FACES, POSITION_TOLERANCE, HexMesh, equal_rows, with_own_nodes
from pdfem_mpi.mesh.part import Measures, MeshPart
from pdfem_mpi.parallel.comm import largest, sum_before, sum_integers
from pdfem_mpi.parallel.directory import Directory

if TYPE_CHECKING:
    from mpi4py.MPI import Intracomm


@dataclass(frozen=True)
class Pieces:
    """A generated mesh.

    Attributes
    ----------
    comm : Intracomm
    layers : Extrusion
        The mesh before anything is removed.
    removals : tables of `deck.removals`
    lower, upper : float64, shape (3,), dimension length
        The half-open block of this rank: cells with their middle in it.
    own_ids : int64, shape (n_own,)
        Numbers of what is left of these cells, rising.
    measures : Measures
        Of what is left.
    cells, nodes : Directory, or None
        Numbers of what is left by those before; None where nothing is removed.
    n_cells, n_nodes : int
        Of what is left.
    """

    comm: Intracomm
    layers: Extrusion
    removals: Sequence[Any]
    lower: np.ndarray
    upper: np.ndarray
    own_ids: np.ndarray
    measures: Measures
    cells: Directory | None
    nodes: Directory | None
    n_cells: int
    n_nodes: int

    def near(self, lower: np.ndarray, upper: np.ndarray, layers: int) -> MeshPart:
        """Cells with their middle in a half-open box, and some layers of cells around them. Collective."""
        part = self.layers.near(lower, upper, layers)
        if self.cells is None:
            return MeshPart(part.nodes, part.cells, measures=self.measures, cell_id=part.cell_id, node_id=part.node_id)
        centroids = HexMesh(part.nodes, part.cells).centroids
        part = without(part, is_removed(self.removals, centroids, _tolerance(*self.layers.box)))
        numbers = {"cell_id": self.cells.ask(part.cell_id), "node_id": self.nodes.ask(part.node_id)}
        return MeshPart(part.nodes, part.cells, measures=self.measures, **numbers)

    def own(self, mesh: MeshPart) -> np.ndarray:
        """Cells of a part that are of this rank's block; bool, shape (n_cells,)."""
        return np.isin(mesh.cell_id, self.own_ids)


def make_pieces(comm: Intracomm, layers: Extrusion, removals: Sequence[Any], symmetry: Sequence[str]) -> Pieces:
    """Look at all cells, a block on each rank. Collective.

    Parameters
    ----------
    symmetry : faces
        Mirror planes.

    Raises
    ------
    SeenInPart
        Something is wrong with what is removed.
    """
    lower, upper = block_of(*layers.box, comm.rank, comm.size)
    block = layers.near(lower, upper)
    if not removals:
        measures = _measures(comm, block)
        return Pieces(comm, layers, removals, lower, upper, block.cell_id, measures, None, None, *layers.size)
    centroids = HexMesh(block.nodes, block.cells).centroids
    gone = [is_removed((removal,), centroids, _tolerance(*layers.box)) for removal in removals]
    left = without(block, np.any(gone, axis=0))
    measures = _measures(comm, left)
    cells, nodes = (
        Directory.of_places(comm, ids, n) for ids, n in zip((left.cell_id, left.node_id), layers.size, strict=True)
    )
    own_ids, size = cells.ask(left.cell_id), (cells.count(), nodes.count())
    pieces = Pieces(comm, layers, removals, lower, upper, own_ids, measures, cells, nodes, *size)
    _check(pieces, gone, left, symmetry)
    return pieces


def block_of(lower: np.ndarray, upper: np.ndarray, rank: int, n_blocks: int) -> tuple[np.ndarray, np.ndarray]:
    """Corners, shape (3,), of one of the blocks that all places are divided into: a box is halved, and again.

    Outwards blocks have no end.
    """
    ends, block = np.array([lower, upper]), np.array([np.full(3, -np.inf), np.full(3, np.inf)])
    first = 0
    while n_blocks > 1:
        axis, n_left = int(np.argmax(ends[1] - ends[0])), n_blocks // 2
        cut = ends[0, axis] + (ends[1, axis] - ends[0, axis]) * n_left / n_blocks
        is_left = rank < first + n_left
        ends[int(is_left), axis] = block[int(is_left), axis] = cut
        first, n_blocks = (first, n_left) if is_left else (first + n_left, n_blocks - n_left)
    return block[0], block[1]


def without(part: Part, gone: np.ndarray) -> Part:
    """What is left of some cells where others are gone, bool (n_cells,), and the nodes of these."""
    used, cells = with_own_nodes(part.cells[~gone], len(part.nodes))
    return Part(part.nodes[used], cells, part.cell_id[~gone], part.node_id[used])


def _tolerance(lower: np.ndarray, upper: np.ndarray) -> float:
    return POSITION_TOLERANCE * float((upper - lower).max())


def _measures(comm: Intracomm, block: Part) -> Measures:
    """Measures of the body of which each rank has a block. Collective."""
    mesh, ends = HexMesh(block.nodes, block.cells), np.full(8, -np.inf)
    if len(block.cells):
        ends = np.concatenate([-mesh.lower, mesh.upper, [-mesh.smallest_edge, mesh.largest_edge]])
    ends = largest(comm, ends)
    lower, upper = 0.0 - ends[:3], ends[3:6].copy()
    return Measures(lower, upper, _tolerance(lower, upper), float(-ends[6]), float(ends[7]))


def _check(pieces: Pieces, gone: list[np.ndarray], left: Part, symmetry: Sequence[str]) -> None:
    """Whether what is removed leaves a body: see `carving.carve`. Collective.

    Parameters
    ----------
    gone : list of bool, shape (n_cells,) each
        Cells of the block that each table removes.
    """
    everywhere, tolerance = Everywhere(pieces.comm, np.ones(len(gone[0]), bool)), _tolerance(*pieces.layers.box)
    for inside in gone:
        everywhere.lacks(inside)
    everywhere.refused(pieces.n_cells == 0)
    for face in symmetry:
        axis = "xyz".index(face[0])
        plane = pieces.layers.box[int(face[1] == "+")][axis]
        on = np.count_nonzero(np.abs(left.nodes[:, axis] - plane) <= tolerance)
        everywhere.refused(everywhere.total(on)[0] == 0)
    everywhere.refused(_count_pieces(pieces) > 1)


def _count_pieces(pieces: Pieces) -> int:
    """How many parts that share no face there are: those of each block, joined where blocks meet. Collective."""
    comm, mesh = pieces.comm, pieces.near(pieces.lower, pieces.upper, 1)
    own, n = pieces.own(mesh), len(mesh.cells)
    number = equal_rows(np.sort(mesh.cells[:, FACES].reshape(-1, 4), axis=1))
    order = np.argsort(number, kind="stable")
    same = number[order[1:]] == number[order[:-1]]
    one, two = order[:-1][same] // len(FACES), order[1:][same] // len(FACES)
    inside = own[one] & own[two]
    _, label = connected(n, one[inside], two[inside])
    names, label_of_own = np.unique(label[own], return_inverse=True)
    first = int(sum_before(comm, len(names)))
    part = np.full(n, -1, np.int64)
    part[own] = first + label_of_own
    total = int(sum_integers(comm, np.array([len(names)]))[0])
    part[~own] = Directory.of(comm, mesh.cell_id[own], part[own], pieces.n_cells).ask(mesh.cell_id[~own])
    across = own[one] != own[two]
    pairs = np.unique(np.sort(np.column_stack([part[one[across]], part[two[across]]]), axis=1), axis=0)
    pairs = np.concatenate(comm.allgather(pairs))
    return connected(total, *pairs.T)[0]
