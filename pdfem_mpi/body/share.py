"""A rank's share of the body: all that later stages see of it.

A share holds the rank's cells, the cells that share a node with one of them, and those with a point within the cutoff
radius; all in the order of the mesh. Sums at a node of the rank, and over the bonds of its points, can so be made whole
on this rank, term by term in the order of the mesh: their bits do not depend on the number of ranks.

Cells and nodes are known on all ranks by their numbers in the mesh; points are ``8 * cell + g``.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from pdfem_mpi.body.boundaries import Boundaries
from pdfem_mpi.body.counts import Counts
from pdfem_mpi.body.found_region import FoundRegion
from pdfem_mpi.body.locating import Weights
from pdfem_mpi.body.materials import MaterialTable
from pdfem_mpi.body.model_units import ModelUnits
from pdfem_mpi.body.selection import Selections
from pdfem_mpi.body.softening_cells import SofteningCells
from pdfem_mpi.body.subdomain import Subdomain, locality_order, node_owners, split_nodes
from pdfem_mpi.mesh.hexmesh import HexMesh
from pdfem_mpi.mesh.mirrors import Mirrors
from pdfem_mpi.mesh.part import MeshPart
from pdfem_mpi.mesh.quality import Quality
from pdfem_mpi.parallel.comm import sum_integers
from pdfem_mpi.parallel.sums import exact_dots

if TYPE_CHECKING:
    from mpi4py.MPI import Intracomm


@dataclass(frozen=True)
class Share:
    """What a rank knows of the body. Rows of arrays are the cells and nodes of ``mesh``, which has their numbers.

    Attributes
    ----------
    comm : Intracomm
    mesh : MeshPart
        In the deck's units.
    subdomain : Subdomain
        Of places among the share's cells and nodes.
    cell_owner : int32, shape (n_cells,)
    units, materials : ModelUnits, MaterialTable
    nodes : float64, shape (n_nodes, 3)
    lower, upper : float64, shape (3,)
        Positions in model units, and corners of the whole body's box.
    region, material, body : int16, int16, int32, shape (n_cells,)
    is_peridynamic, has_points, is_overlap, has_stiffness : bool, shape (n_cells,)
        As in `Discretization`.
    point_row, element_row : int64, shape (n_cells,)
        Number of a cell among those with points, or with nodes, of the whole body, as in result files; else -1.
    free_row : int64, shape (n_cells,)
        The same among the cells with free points, by which checkpoints are ordered.
    node_row : int64, shape (n_nodes,)
        Number of a node among the nodes with unknowns of the whole body; else -1.
    cutoff : float
        Guarded cutoff radius in model units; 0 without peridynamics.
    mirrors, reflections : Mirrors, two float64 arrays of shape (n, 3)
        Mirror planes; signs and shifts of reflections that bring an image within the cutoff radius of the body.
    doubled, surface : float64, shape (n, 4, 3)
        Faces of the whole mesh that are a crack by their doubled nodes, and those of `surface_near`; model units.
    counts, typical_edge, softening_cells : Counts, float, SofteningCells or None
        Sizes of the body; median edge of its cells, as cubes, in model units; sizes of those whose bonds can soften.
    joint_regions, overlap_regions : int64
        Regions with peridynamic cells that follow nodes, and those with overlap cells; rising.
    quality, notes, crack_notes : Quality, tuples of str
        Of the whole mesh; what a user should know of it, and of cracks through the overlap.
    mesh_sha256, body_sha256 : str
        Of the mesh's content, and of nodes, cells and regions in model units.
    probes, selections : dict of Weights, Selections
        What columns of probes read; where the deck's loads and supports act, and what its probes of sets read.
    boundaries, found : Boundaries, FoundRegion, or None
        What the fit of bond factors asks of the body; a region of bonds that the run finds. Where the deck wants them.
    """

    comm: Intracomm
    mesh: MeshPart
    subdomain: Subdomain
    cell_owner: np.ndarray
    units: ModelUnits
    nodes: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    region: np.ndarray
    material: np.ndarray
    materials: MaterialTable
    is_peridynamic: np.ndarray
    has_points: np.ndarray
    is_overlap: np.ndarray
    has_stiffness: np.ndarray
    body: np.ndarray
    point_row: np.ndarray
    free_row: np.ndarray
    element_row: np.ndarray
    node_row: np.ndarray
    cutoff: float
    mirrors: Mirrors
    reflections: tuple[np.ndarray, np.ndarray]
    doubled: np.ndarray
    surface: np.ndarray
    counts: Counts
    typical_edge: float
    softening_cells: SofteningCells | None
    joint_regions: np.ndarray
    overlap_regions: np.ndarray
    quality: Quality
    notes: tuple[str, ...]
    crack_notes: tuple[str, ...]
    mesh_sha256: str
    body_sha256: str
    probes: dict[str, Weights]
    selections: Selections
    boundaries: Boundaries | None
    found: FoundRegion | None = None

    @property
    def is_owned(self) -> np.ndarray:
        """Cells of this rank; bool, shape (n_cells,)."""
        return self.cell_owner == self.comm.rank

    @property
    def has_nodes(self) -> np.ndarray:
        """Cells with nodes that carry unknowns: elements and overlap; bool, shape (n_cells,)."""
        return self.has_stiffness | self.is_overlap

    @property
    def own_point_rows(self) -> np.ndarray:
        """``point_row`` of the rank's cells with points, in the order they are stored in; int64."""
        return self.point_row[np.concatenate([self.subdomain.free, self.subdomain.overlap])]

    @property
    def own_node_rows(self) -> np.ndarray:
        """``node_row`` of the rank's nodes, in the order they are stored in; int64."""
        return self.node_row[self.subdomain.owned_nodes]

    @property
    def youngs_modulus(self) -> np.ndarray:
        """Young's modulus of each cell in model units; float64, shape (n_cells,)."""
        return self.materials.youngs_modulus[self.material]

    @property
    def poissons_ratio(self) -> np.ndarray:
        """Poisson's ratio of each cell; float64, shape (n_cells,)."""
        return self.materials.poissons_ratio[self.material]

    @property
    def plane_components(self) -> np.ndarray:
        """Displacement components of nodes that mirror planes hold; bool, shape (n_nodes, 3)."""
        return self.mirrors.normal_components(self.nodes, self.mesh.tolerance / self.units.length)

    def exact_sums(self, terms: Iterable[np.ndarray]) -> np.ndarray:
        """Sums over all ranks of numbers of owned cells or nodes, each rounded once; float64. Collective."""
        return exact_dots(self.comm, [(x, np.ones_like(x)) for x in terms])

    def any(self, cells: np.ndarray) -> bool:
        """Whether some of the cells, bool (n_cells,), exist on any rank. Collective."""
        return bool(sum_integers(self.comm, np.array([np.count_nonzero(cells & self.is_owned)]))[0])

    def average_edge(self, cells: np.ndarray) -> float:
        """Mean over the twelve edges of all ranks' chosen cells, bool (n_cells,), dimension length. Collective."""
        edges = HexMesh(self.mesh.nodes, self.mesh.cells[cells & self.is_owned]).edges()
        return float(self.exact_sums([edges])[0]) / int(sum_integers(self.comm, np.array([edges.size]))[0])

    def with_elements_everywhere(self) -> Share:
        """The same cells on the same ranks, each of them a finite element and nothing else."""
        mesh, rank, owned = self.mesh, self.comm.rank, self.is_owned
        everywhere = np.ones(len(mesh.cells), bool)
        owner_of_node = node_owners(mesh, everywhere, self.cell_owner)
        owned_nodes, ghost_nodes = split_nodes(mesh, owner_of_node, owned, rank)
        order, none = locality_order(mesh), np.empty(0, np.int64)
        elements, ghost_owner = order[owned[order]], owner_of_node[ghost_nodes]
        no_points = none, none, none, none.astype(np.int32), none, none
        return replace(
            self,
            subdomain=Subdomain(*no_points, elements, owned_nodes, ghost_nodes, ghost_owner),
            has_points=~everywhere,
            is_overlap=~everywhere,
            has_stiffness=everywhere,
            body=np.full(len(everywhere), -1, np.int32),
            node_row=mesh.node_id,
        )
