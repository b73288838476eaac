"""Some cells of a mesh with their nodes, as a mesh that knows how large the whole one is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pdfem_mpi.mesh.everywhere import Everywhere
from pdfem_mpi.mesh.hexmesh import HexMesh, with_own_nodes


@dataclass(frozen=True)
class Measures:
    """What selections and tolerances take from a whole mesh, dimension length; see `HexMesh`."""

    lower: np.ndarray
    upper: np.ndarray
    tolerance: float
    smallest_edge: float
    largest_edge: float


@dataclass(frozen=True)
class MeshPart(HexMesh):
    """Cells of a mesh in its order, with nodes in its order; box, edges and tolerance are the whole mesh's.

    Attributes
    ----------
    measures : Measures
        Of the whole mesh.
    cell_id, node_id : int64, shapes (n_cells,), (n_nodes,)
        Numbers in the whole mesh, rising.
    everywhere : Everywhere, or None
        Of which cells this rank answers for all ranks, where they ask together.
    """

    measures: Measures | None = None
    cell_id: np.ndarray | None = None
    node_id: np.ndarray | None = None
    everywhere: Everywhere | None = None

    @property
    def lower(self) -> np.ndarray:
        return self.measures.lower

    @property
    def upper(self) -> np.ndarray:
        return self.measures.upper

    @property
    def tolerance(self) -> float:
        return self.measures.tolerance

    @property
    def smallest_edge(self) -> float:
        return self.measures.smallest_edge

    @property
    def largest_edge(self) -> float:
        return self.measures.largest_edge

    @property
    def mean_edge(self) -> float:
        return 0.5 * (self.measures.smallest_edge + self.measures.largest_edge)

    def places_of_cells(self, numbers: np.ndarray) -> np.ndarray:
        """Places of cells of the part by their numbers in the whole mesh; int64, shape (n,)."""
        return np.searchsorted(self.cell_id, numbers)

    def places_of_nodes(self, numbers: np.ndarray) -> np.ndarray:
        """Places of nodes of the part by their numbers in the whole mesh; int64, shape (n,)."""
        return np.searchsorted(self.node_id, numbers)


def take_part(mesh: HexMesh, cells: np.ndarray) -> MeshPart:
    """The part of a mesh that some cells make; its arrays are the mesh's own where these are all cells.

    Named sets stay behind.

    Parameters
    ----------
    cells : bool, shape (n_cells,)
    """
    measures = Measures(mesh.lower, mesh.upper, mesh.tolerance, mesh.smallest_edge, mesh.largest_edge)
    if cells.all():
        part = MeshPart(mesh.nodes, mesh.cells, measures=measures, cell_id=mesh.cell_id, node_id=mesh.node_id)
        vars(part)["centroids"] = mesh.centroids  # cached, once for both
        return part
    used, own = with_own_nodes(mesh.cells[cells], len(mesh.nodes))
    return MeshPart(mesh.nodes[used], own, measures=measures, cell_id=mesh.cell_id[cells], node_id=mesh.node_id[used])
