"""From the scene and its mesh to collocation points, finite elements and their overlap, in model units.

It is made of all cells, or on several ranks of those that a rank sees (`sight`): about 150 bytes a cell, against 20,000
bytes of bonds of a peridynamic cell. It ends in this folder: what a rank keeps is its `share.Share`.

**Model units.** Lengths are in units of the internal length ``l`` (without peridynamics: of the mean edge), measured
from the centre of the bounding box, stresses in units of the default material's Young's modulus. Numbers stored in
single precision then do not depend on the deck's units, and a body far from the origin loses nothing after this
subtraction (`model_units`).
"""

from __future__ import annotations

import hashlib
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from pdfem_mpi.body.describing import describe
from pdfem_mpi.body.materials import MaterialTable, material_table
from pdfem_mpi.body.meshing import describe_folded, make_mesh
from pdfem_mpi.body.model_units import ModelUnits, quantum_for
from pdfem_mpi.body.regions import assign_regions
from pdfem_mpi.deck.meshes import FileMesh, PlateWithHoleMesh
from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.deck.table import SceneError
from pdfem_mpi.kernels.families import CUTOFF_GUARD
from pdfem_mpi.mesh.hexmesh import HexMesh
from pdfem_mpi.mesh.mirrors import Mirrors, mirrors_at
from pdfem_mpi.mesh.quality import Quality, folded_cells, measure
from pdfem_mpi.parallel.comm import largest, report_progress, sum_integers

if TYPE_CHECKING:
    from mpi4py.MPI import Intracomm


@dataclass(frozen=True)
class Discretization:
    """What each cell of the mesh carries.

    Attributes
    ----------
    mesh : HexMesh
        In the deck's units.
    quality : Quality
    units : ModelUnits
    nodes : float64, shape (n_nodes, 3)
        Node positions in model units.
    region : int16, shape (n_cells,)
        Index of the deck's region.
    material : int16, shape (n_cells,)
        Index of the cell's material; 0 is the default.
    materials : MaterialTable
    is_peridynamic : bool, shape (n_cells,)
        Cells of peridynamic regions.
    has_points : bool, shape (n_cells,)
        Cells with collocation points: peridynamic cells and the overlap.
    is_overlap : bool, shape (n_cells,)
        Cells with points whose displacements are interpolated from nodes (eq. 25); peridynamic ones join fitted bodies.
    body : int32, shape (n_cells,)
        Body of each cell with points, no bonds between two bodies (see `fitted_bodies`); -1 for other cells.
    thin : int64, shape (n_thin,)
        Cells at which a body whose factors should be fitted is too thin for it.
    has_stiffness : bool, shape (n_cells,)
        Cells whose element has an internal force (eqs 15, 16).
    carries : bool, shape (n_nodes,)
        Nodes that carry unknowns: those of elements and overlap.
    cutoff : float
        Guarded cutoff radius in model units; 0 without peridynamics.
    mirrors : Mirrors
        Mirror planes in model units.
    has_cycle : bool
        Equilibria are found by conjugate gradients, whose preconditioner works on every cell.
    """

    mesh: HexMesh
    quality: Quality
    units: ModelUnits
    nodes: np.ndarray
    region: np.ndarray
    material: np.ndarray
    materials: MaterialTable
    is_peridynamic: np.ndarray
    has_points: np.ndarray
    is_overlap: np.ndarray
    body: np.ndarray
    thin: np.ndarray
    has_stiffness: np.ndarray
    carries: np.ndarray
    cutoff: float
    mirrors: Mirrors
    has_cycle: bool = False

    @property
    def n_point_cells(self) -> int:
        """Number of cells with points."""
        return int(np.count_nonzero(self.has_points))

    @property
    def n_bodies(self) -> int:
        """Number of bodies between which there are no bonds; 0 without peridynamics."""
        return int(self.body.max(initial=-1)) + 1

    @property
    def n_nodes(self) -> int:
        """Number of nodes that carry unknowns."""
        return int(np.count_nonzero(self.carries))

    @property
    def point_row(self) -> np.ndarray:
        """Number of each cell among the cells with points, by which result files are ordered; else -1; int64."""
        return number_among(self.has_points)

    @property
    def numbered(self) -> dict[str, np.ndarray]:
        """Cells that are numbered by themselves, by the name of that number in a share; bool, shape (n_cells,).

        Those with points and those with nodes order result files, those with free points checkpoints.
        """
        free = self.has_points & ~self.is_overlap
        return {"point_row": self.has_points, "free_row": free, "element_row": self.has_nodes}

    @property
    def node_row(self) -> np.ndarray:
        """Number of each node among the nodes with unknowns; else -1; int64, shape (n_nodes,)."""
        return number_among(self.carries)

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

    @cached_property
    def reflections(self) -> tuple[np.ndarray, np.ndarray]:
        """Signs and shifts, both (n, 3), of reflections that bring an image within the cutoff radius of the body."""
        body = self.units.places(np.array([self.mesh.lower, self.mesh.upper]))
        reach = self.cutoff + 2.0 * self.mesh.largest_edge / self.units.length  # and the size of cells
        return self.mirrors.reflections(body, body + np.array([[-reach], [reach]]))

    @property
    def notes(self) -> tuple[str, ...]:
        """What a user should know of the mesh: what the reader left out, and cells that elements just live on."""
        if self.quality.smallest_scaled_jacobian > 0.0:
            return self.mesh.notes
        self.mesh.everywhere.refused(True)
        folded = np.zeros(len(self.mesh.cells), bool)
        folded[folded_cells(self.mesh)] = True
        return (*self.mesh.notes, f"warning: {describe_folded(self.mesh, folded)}: results near them are poor.")

    def sha256(self) -> str:
        """Digest of the nodes in model units, the cells and their regions."""
        total = hashlib.sha256()
        for array in (self.nodes, self.mesh.cells, self.region):
            total.update(f"{array.dtype.str}{array.shape}".encode() + array.tobytes())
        return total.hexdigest()

    @property
    def has_nodes(self) -> np.ndarray:
        """Cells with nodes that carry unknowns: elements and overlap; bool, shape (n_cells,)."""
        return self.has_stiffness | self.is_overlap


def discretize(
    scene: Scene, mesh: HexMesh | None = None, comm: Intracomm | None = None, quality: Quality | None = None
) -> Discretization:
    """Decide what every cell of the scene's mesh, or of a part of it, carries.

    Parameters
    ----------
    mesh : HexMesh, optional
        What `make_mesh` gave; made here, if not given.
    comm : Intracomm, optional
        Ranks that share the work; collective then.
    quality : Quality, optional
        Of the whole mesh, where it is known.

    Raises
    ------
    SeenInPart
        Something is wrong, and the mesh is a part.
    SceneError
        Cells inside out, regions that overlap or leave cells out, an empty region, an overlap that does not fit or
        where two Poisson's ratios meet, bodies that cannot be fitted.
    """
    mesh = make_mesh(scene) if mesh is None else mesh
    quality = _measure(mesh, comm) if quality is None else quality
    report_progress()
    region = assign_regions(scene, mesh)
    peridynamic = np.array([r.model == "peridynamics" for r in scene.regions])[region]
    materials = material_table(scene)
    material = np.array([materials.names.index(r.material) for r in scene.regions], np.int16)[region]
    described = describe(scene, mesh, quality, region, peridynamic, (materials, material))
    length, cutoff_radius, quantum = mesh.mean_edge, 0.0, 0.0
    if scene.is_adaptive or mesh.everywhere.count(described["has_points"])[0]:
        length, cutoff_radius = scene.peridynamics.lengths(cell_edge(scene, mesh))
        quantum = quantum_for(mesh.lower, mesh.upper, length) if scene.can_fail else 0.0
    units = ModelUnits(length, scene.material.youngs_modulus, 0.5 * (mesh.lower + mesh.upper), quantum)

    return Discretization(
        mesh=mesh,
        quality=quality,
        units=units,
        nodes=units.places(mesh.nodes),
        region=region,
        material=material,
        materials=materials.rounded(units),
        **described,
        cutoff=units.numbers(cutoff_radius / length) * (1.0 + CUTOFF_GUARD),
        mirrors=mirrors_at(scene.mesh.symmetry, *units.places(np.array([mesh.lower, mesh.upper]))),
        has_cycle=scene.has_cycle,
    )


def _measure(mesh: HexMesh, comm: Intracomm | None) -> Quality:
    """Quality of all cells, each rank measuring its own, or a block of them; errors are those of the whole mesh."""
    if comm is None or comm.size == 1:
        return measure(mesh)
    n, found, everywhere = len(mesh.cells), None, mesh.everywhere
    block = slice(n * comm.rank // comm.size, n * (comm.rank + 1) // comm.size)
    with suppress(SceneError):
        found = measure(HexMesh(mesh.nodes, mesh.cells[block if everywhere.own is None else everywhere.own]))
    if everywhere.refused(bool(sum_integers(comm, np.array([found is None]))[0])):
        return measure(mesh)
    low = largest(comm, -np.array([found.shortest_edge, found.smallest_scaled_jacobian, found.smallest_gauss_volume]))
    (longest,) = largest(comm, np.array([found.longest_edge])).tolist()
    shortest, jacobian, volume = (-low).tolist()
    return Quality(shortest, longest, jacobian, volume)


def cell_edge(scene: Scene, mesh: HexMesh) -> float:
    """The paper's Delta: graded cells of a plate are "approximately" as wide as its spacing (sec. 4.2)."""
    if isinstance(scene.mesh, FileMesh):
        return mesh.average_edge if scene.mesh.spacing is None else scene.mesh.spacing
    if isinstance(scene.mesh, PlateWithHoleMesh) or scene.can_fail:
        return scene.mesh.spacing  # of a box within 1e-6, and no difference of places far from the origin
    return mesh.largest_edge


def number_among(chosen: np.ndarray) -> np.ndarray:
    """Number of each cell or node among the chosen ones, bool (n,), from 0; else -1; int64, shape (n,)."""
    return np.where(chosen, np.cumsum(chosen) - 1, -1)
