"""The shape of the whole body on rank 0, for what is read off its fields there and for the files of a viewer."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pdfem_mpi.body.materials import MaterialTable
from pdfem_mpi.body.model_units import ModelUnits
from pdfem_mpi.body.share import Share
from pdfem_mpi.kernels.hex8 import gauss_positions
from pdfem_mpi.mesh.hexmesh import HexMesh
from pdfem_mpi.mesh.mirrors import Mirrors
from pdfem_mpi.parallel.slabs import gather_rows


@dataclass(frozen=True)
class Geometry:
    """The whole body as rank 0 sees it, in the order of the mesh.

    Attributes
    ----------
    mesh : HexMesh
        In the deck's units, without named sets.
    units : ModelUnits
    materials : MaterialTable
    mirrors : Mirrors
        Mirror planes in model units.
    cutoff : float
        Guarded cutoff radius in model units; 0 without peridynamics.
    region, material : int16, shape (n_cells,)
    is_peridynamic, is_overlap, has_points, has_nodes : bool, shape (n_cells,)
        See `Share`.
    point_row : int64, shape (n_cells,)
        Rows of cells in the fields of points, eight each; -1 elsewhere.
    node_row : int64, shape (n_nodes,)
        Rows of nodes in the fields of nodes; -1 elsewhere.
    """

    mesh: HexMesh
    units: ModelUnits
    materials: MaterialTable
    mirrors: Mirrors
    cutoff: float
    region: np.ndarray
    material: np.ndarray
    is_peridynamic: np.ndarray
    is_overlap: np.ndarray
    has_points: np.ndarray
    has_nodes: np.ndarray
    point_row: np.ndarray
    node_row: np.ndarray

    @property
    def model_nodes(self) -> np.ndarray:
        """Positions of the nodes of the mesh in model units; float64, shape (n_nodes, 3)."""
        return (self.mesh.nodes - self.units.origin) / self.units.length

    @property
    def point_positions(self) -> np.ndarray:
        """Positions of all collocation points in the order of their fields, shape (n_points, 3), deck units."""
        return gauss_positions(self.mesh.nodes[self.mesh.cells[self.has_points]]).reshape(-1, 3)

    def rows_of_points(self, ids: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Rows in the fields of points by their ids, and which reflection is meant, 0 for none; int64 as the ids."""
        number, point = np.divmod(ids, 8)
        reflection, cell = np.divmod(number, len(self.mesh.cells))
        return 8 * self.point_row[cell] + point, reflection

    @property
    def node_positions(self) -> np.ndarray:
        """Positions of all nodes of elements in the order of their fields, shape (n_nodes, 3), deck units."""
        return self.mesh.nodes[self.node_row >= 0]


#: What is gathered cell by cell.
OF_CELLS = ("region", "material", "is_peridynamic", "is_overlap", "has_points", "has_nodes", "point_row")


def gather_geometry(share: Share) -> Geometry | None:
    """Collect the shape of the body; None except on rank 0. Collective."""
    same = {name: getattr(share, name) for name in ("units", "materials", "mirrors", "cutoff")}
    if share.comm.size == 1:  # nothing is copied
        arrays = {name: getattr(share, name) for name in (*OF_CELLS, "node_row")}
        return Geometry(HexMesh(share.mesh.nodes, share.mesh.cells), **same, **arrays)
    comm, mesh, counts = share.comm, share.mesh, share.counts
    own = np.flatnonzero(share.is_owned)
    own_nodes = share.with_elements_everywhere().subdomain.owned_nodes

    def of_cells(rows: np.ndarray) -> np.ndarray | None:
        return gather_rows(comm, mesh.cell_id[own], rows[own], counts.cells)

    def of_nodes(rows: np.ndarray) -> np.ndarray | None:
        return gather_rows(comm, mesh.node_id[own_nodes], rows[own_nodes], counts.mesh_nodes)

    nodes, node_row = of_nodes(mesh.nodes), of_nodes(share.node_row)
    cells = of_cells(mesh.node_id[mesh.cells].astype(mesh.cells.dtype))
    arrays = {name: of_cells(getattr(share, name)) for name in OF_CELLS}
    return Geometry(HexMesh(nodes, cells), **same, **arrays, node_row=node_row) if comm.rank == 0 else None
