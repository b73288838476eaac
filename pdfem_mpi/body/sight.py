"""What a rank sees of a body whose mesh is made: its own cells and those around them. No rank makes all of it.

A rank looks at a block of the body first, and at the cells around it that its own depend on; the blocks' cells are then
dealt out by their costs, and each rank makes its cells with those that it needs beside them. What is asked of all cells
is asked of those that each rank answers for (`mesh.everywhere`).

Where something is wrong with the body, `SeenInPart` is raised on all ranks: the sentences about it are made of the
whole. Mesh files, fits of bond factors and regions that are found see the whole body on every rank.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from pdfem_mpi.body.discretization import Discretization, cell_edge, discretize
from pdfem_mpi.body.meshing import layers_of, removals_of
from pdfem_mpi.body.partitioning import deal_out
from pdfem_mpi.body.subdomain import cell_balls, centroids_of
from pdfem_mpi.deck.meshes import FileMesh
from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.kernels.dense import lengths
from pdfem_mpi.kernels.exact_sums import MOST_RANKS
from pdfem_mpi.mesh.everywhere import Everywhere, SeenInPart
from pdfem_mpi.mesh.part import MeshPart
from pdfem_mpi.mesh.pieces import Pieces, make_pieces
from pdfem_mpi.parallel.comm import largest
from pdfem_mpi.parallel.directory import Directory

if TYPE_CHECKING:
    from mpi4py.MPI import Intracomm

#: Boxes of cells are wider than what is sought in them by this part of the longest edge.
SLACK = 1e-3


@dataclass(frozen=True)
class Sight:
    """The body around a rank's cells.

    Attributes
    ----------
    body : Discretization
        Of a part of the mesh, which answers for the rank's own cells.
    owner : int32, shape (n_cells,)
        Of the cells of the part.
    n_cells, n_nodes : int
        Of the whole mesh.
    """

    body: Discretization
    owner: np.ndarray
    n_cells: int
    n_nodes: int

    def rows_of_cells(self, chosen: np.ndarray, wanted: np.ndarray) -> np.ndarray:
        """Place of cells, by their numbers in the mesh, among the chosen ones, bool (n_cells,); else -1. Collective."""
        mesh = self.body.mesh
        own = mesh.cell_id[chosen & mesh.everywhere.own]
        return Directory.of_places(mesh.everywhere.comm, own, self.n_cells).ask(wanted)

    def rows_of_nodes(self, chosen: np.ndarray, wanted: np.ndarray) -> np.ndarray:
        """The same of nodes of the chosen cells. Collective."""
        mesh = self.body.mesh
        own = np.unique(mesh.node_id[mesh.cells[chosen & mesh.everywhere.own]])
        return Directory.of_places(mesh.everywhere.comm, own, self.n_nodes).ask(wanted)


def is_seen_in_part(scene: Scene, comm: Intracomm) -> bool:
    """Whether ranks see parts of the scene's body, and none sees the whole."""
    fitted = scene.has_peridynamics and scene.peridynamics.surface_correction == "fitted"
    return comm.size > 1 and not (isinstance(scene.mesh, FileMesh) or scene.is_adaptive or fitted)


def see(scene: Scene, comm: Intracomm) -> Sight:
    """Make a rank's cells and those around them. Collective.

    Raises
    ------
    SeenInPart
        Something is wrong with the body, or it cannot be divided among the ranks.
    """
    pieces = make_pieces(comm, layers_of(scene.mesh), removals_of(scene.mesh), scene.mesh.symmetry)
    if comm.size > min(MOST_RANKS, pieces.n_cells):
        raise SeenInPart
    body = discretize(scene, _block(scene, pieces), comm)
    reach = _reach(body)
    numbers, centroids = deal_out(body, comm)
    slack = reach + SLACK * body.mesh.largest_edge / body.units.length
    ends = np.array([centroids.min(axis=0) - slack, centroids.max(axis=0) + slack])
    mesh = pieces.near(*(ends * body.units.length + body.units.origin), 1 + _overlap(scene) + _deepest(scene))
    owner = Directory.of(comm, numbers, np.full(len(numbers), comm.rank), pieces.n_cells).ask(mesh.cell_id)
    mesh = replace(mesh, everywhere=Everywhere(comm, owner == comm.rank))
    body = discretize(scene, mesh, comm, body.quality)
    return Sight(body, owner.astype(np.int32), pieces.n_cells, pieces.n_nodes)


def _overlap(scene: Scene) -> int:
    """Layers around a cell on which it depends whether its points follow nodes."""
    return scene.coupling.overlap if scene.is_coupled else 0


def _deepest(scene: Scene) -> int:
    """Layers of cells beneath a face that a load, a support or a restraint takes."""
    entries = *scene.loads, *scene.supports, *scene.springs, *scene.ties
    return max((getattr(entry, "layers", 1) for entry in entries), default=1)


def surroundings(scene: Scene) -> float:
    """Width of what is around a rank's cells of a mesh that is made, about; the deck's units."""
    edge, cutoff = scene.mesh.spacing, 0.0
    if scene.has_peridynamics:
        cutoff = scene.peridynamics.lengths(edge)[1] + edge
    return cutoff + edge * (1 + _overlap(scene) + _deepest(scene))


def _block(scene: Scene, pieces: Pieces) -> MeshPart:
    """The cells of the rank's block, and those around it that their costs depend on. Collective."""
    edge = pieces.measures.largest_edge
    cutoff = scene.peridynamics.lengths(cell_edge(scene, pieces.measures))[1] if scene.has_peridynamics else 0.0
    margin = cutoff + SLACK * (cutoff + edge)
    mesh = pieces.near(pieces.lower - margin, pieces.upper + margin, _overlap(scene) + 1)
    return replace(mesh, everywhere=Everywhere(pieces.comm, pieces.own(mesh)))


def _reach(body: Discretization) -> float:
    """Distance of the centroids of two cells with points within the cutoff radius, at most. Collective."""
    everywhere = body.mesh.everywhere
    cells = np.flatnonzero(body.has_points & everywhere.own)
    centre, radius = cell_balls(body, cells)
    offset = lengths(centre - centroids_of(body)[cells])
    widest = largest(everywhere.comm, np.array([radius.max(initial=0.0), offset.max(initial=0.0)]))
    return body.cutoff + 2.0 * float(widest.sum())
