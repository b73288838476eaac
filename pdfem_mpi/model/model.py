"""Model: the constants of a run on one rank. Parts that the scene does not have are None."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from pdfem_mpi.body.discretization import Discretization, ModelUnits
from pdfem_mpi.body.share import Subdomain, cut_out, partition
from pdfem_mpi.deck.peridynamics import polygon_normal
from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.kernels.finite_elements import (
    element_masses,
    element_stiffness,
    force_bound,
    gradient_tables,
    lame_moduli,
    stiffness_of_moduli,
    turning_masses,
)
from pdfem_mpi.kernels.hex8 import SHAPE_AT_GAUSS, gauss_positions, gauss_volumes
from pdfem_mpi.kernels.simd import W
from pdfem_mpi.mesh.mirrors import Mirrors
from pdfem_mpi.model.unknowns import Unknowns, cluster_layout
from pdfem_mpi.parallel.comm import largest
from pdfem_mpi.parallel.halo import Halo, build_halo
from pdfem_mpi.peridynamics.bonds import Bonds, Points, cut_bonds, fictitious_masses, make_bonds, pattern_for, perturbed
from pdfem_mpi.peridynamics.damage import family_weights
from pdfem_mpi.peridynamics.fit.fit import BodyFit, fit_body
from pdfem_mpi.peridynamics.fracture_energy import energy_of_own_bonds
from pdfem_mpi.peridynamics.images import Images, MirroredHalo
from pdfem_mpi.peridynamics.stable_masses import relaxes, stable_densities
from pdfem_mpi.peridynamics.uneven import CONVERGED, most_uneven_point
from pdfem_mpi.system.heap import large_arrays_together

if TYPE_CHECKING:
    from mpi4py.MPI import Intracomm

#: Cells whose corners agree within this fraction of the model unit of length share a stiffness matrix.
SHAPE_TOLERANCE = 1e-9
#: More shapes than this, and the cells are treated as general hexahedra.
MOST_SHAPES = 4
#: Elements whose stiffness matrices are formed together at set-up.
BATCH = 4096


@dataclass(frozen=True)
class Nodes:
    """Nodes of the owned elements and overlap cells, owned nodes first.

    Attributes
    ----------
    n_owned : int
    number : int64, shape (n_nodes,)
        Global number among the nodes with unknowns.
    x : float64, shape (n_nodes, 3), dimension length
    halo : Halo
    """

    n_owned: int
    number: np.ndarray
    x: np.ndarray
    halo: Halo


@dataclass(frozen=True)
class SharedElements:
    """Elements of one shape and Poisson's ratio: a stiffness matrix (24, 24) for E = 1, Young's modulus of each."""

    connectivity: np.ndarray
    stiffness: np.ndarray
    scale: np.ndarray


@dataclass(frozen=True)
class GeneralElements:
    """Elements of any shape: positions of their nodes, geometry tables and Lame's moduli per element."""

    connectivity: np.ndarray
    corners: np.ndarray
    tables: np.ndarray
    lam: np.ndarray
    mu: np.ndarray


@dataclass(frozen=True)
class TurningElements:
    """The same elements in finite kinematics: geometry tables (one group for one shape) and Lame's moduli of each."""

    connectivity: np.ndarray
    tables: np.ndarray
    lam: np.ndarray
    mu: np.ndarray


@dataclass(frozen=True)
class Elements:
    """Finite elements owned by this rank.

    Attributes
    ----------
    shared : tuple of SharedElements
    general : GeneralElements or None
    bound : float, dimension force / length
        Largest force component per largest difference of nodal displacements, on all ranks; of linear forces.
    turning : tuple of TurningElements
        Finite kinematics: what forces are made from, on every rank; the stiffness above is that at rest. Else empty.
    """

    shared: tuple[SharedElements, ...]
    general: GeneralElements | None
    bound: float
    turning: tuple[TurningElements, ...] = ()

    @property
    def finite(self) -> bool:
        """Finite (else linear) kinematics."""
        return bool(self.turning)

    def per_node(self, pick: Callable[[np.ndarray], np.ndarray]) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Numbers taken from the elements' stiffness matrices, for their nodes.

        Parameters
        ----------
        pick : callable
            From stiffness matrices (n, 24, 24) to numbers (n, 8, k).

        Yields
        ------
        connectivity : int32, shape (n, 8)
        numbers : float64, shape (n, 8, k)
        """
        for part in self.shared:
            yield part.connectivity, part.scale[:, None, None] * pick(part.stiffness[None])
        if self.general:
            part = self.general
            for start in range(0, len(part.connectivity), BATCH):
                batch = slice(start, start + BATCH)
                stiffness = stiffness_of_moduli(part.corners[batch], part.lam[batch], part.mu[batch])
                yield part.connectivity[batch], pick(stiffness)


@dataclass(frozen=True)
class Overlap:
    """Overlap cells owned by this rank: ``points.n_free`` is the first; local nodes of each, shape (n, 8)."""

    connectivity: np.ndarray


@dataclass(frozen=True)
class Model:
    """Constants of a run on one rank, in model units.

    Attributes
    ----------
    comm : Intracomm
    units : ModelUnits
    owner : int32, shape (n_cells,)
        Rank of every cell of the mesh.
    subdomain : Subdomain
    points, bonds, nodes, elements, overlap : or None
        What the scene has; the same parts on every rank, though a rank's share may be empty.
    mass : float64, shape (n_unknowns,), dimension force / length
        Fictitious masses (eqs 11, 22) of the unknowns: free points in cluster layout, then owned nodes.
    raised_masses : int
        Points of the whole body whose masses are above those of eq. (11), which do not bound its stiffness.
    correction_remaining : float
        Largest ``|G / g_inf - 1|`` of the surface correction before its last sweep.
    body_fit : BodyFit or None
        Of the bond factors, where the deck asks for them.
    cut : tuple of int
        Bonds cut by each initial crack, on all ranks.
    mirrors : Mirrors
    rollers : int64
        Unknowns of nodes on mirror planes, normal to them: their displacement is 0, and forces on them are answered by
        the mirror image of the body.
    intact_weights : int64, shape (n_owned, 8), or None
        Denominators of the local damage (eq. 5), where the deck asks for it.
    own_energy : float64, shape (n_materials, 3), dimension force / length, or None
        What `energy_of_own_bonds` says of the body before cracks, where bonds can break.
    most_uneven : float64, shape (3,), dimension length, or None
        Where the response of the corrected bonds differs most from that inside of a body, if the correction did not
        converge.
    """

    comm: Intracomm
    units: ModelUnits
    owner: np.ndarray
    subdomain: Subdomain
    points: Points | None
    bonds: Bonds | None
    nodes: Nodes | None
    elements: Elements | None
    overlap: Overlap | None
    mass: np.ndarray
    correction_remaining: float
    body_fit: BodyFit | None
    cut: tuple[int, ...]
    mirrors: Mirrors
    rollers: np.ndarray
    intact_weights: np.ndarray | None = None
    raised_masses: int = 0
    own_energy: np.ndarray | None = None
    most_uneven: np.ndarray | None = None

    @property
    def finite(self) -> bool:
        """Whether anything follows finite displacements: bonds, elements or both. The same on all ranks."""
        return bool((self.bonds and self.bonds.finite) or (self.elements and self.elements.finite))

    @cached_property
    def unknowns(self) -> Unknowns:
        """The order of a vector over this rank's unknowns."""
        return Unknowns(8 * self.points.n_free if self.points else 0, self.nodes.n_owned if self.nodes else 0)

    @property
    def n_unknowns(self) -> int:
        """Owned unknowns."""
        return self.unknowns.size

    @property
    def share(self) -> np.ndarray:
        """Part of each unknown on this side of mirror planes: 1/2 on one, 1/4 on two; float64, shape (n_unknowns,)."""
        planes = np.zeros(self.n_unknowns)
        planes[self.rollers] = 1.0
        of_nodes = self.unknowns.of_nodes(planes)
        of_nodes[:] = of_nodes.sum(axis=1)[:, None]
        return 0.5**planes


def build_model(
    scene: Scene, discretization: Discretization, comm: Intracomm, fits: tuple[Path, ...] = ()
) -> Model:
    """Cut out this rank's share and compute its constants. Collective.

    Parameters
    ----------
    fits : paths
        Folders where fits of bond factors are looked for and left.

    Raises
    ------
    SceneError
        More ranks than cells; a body whose bond factors cannot be fitted.
    """
    owner = partition(discretization, comm.size)
    subdomain = cut_out(discretization, owner, comm.rank)
    points = bonds = nodes = elements = overlap = body_fit = None
    remaining, cut, intact_weights, own_energy = 0.0, [], None, None
    most_uneven = None
    if discretization.has_points.any():
        points = _make_points(discretization, subdomain, comm)
        finite = scene.kinematics == "finite"
        correction = scene.peridynamics.surface_correction
        fitted = correction == "fitted"
        settings = (comm, points, discretization.materials, discretization.cutoff, finite)
        settings += ("virial" if fitted else correction,)
        bonds, remaining = make_bonds(*settings)
        if fitted:
            signs = scene.peridynamics.signs
            with large_arrays_together():
                bonds, body_fit = fit_body(comm, discretization, subdomain, points, bonds, signs, fits)
            if body_fit.fit:
                remaining = 0.0
            elif not len(discretization.thin):  # the fit that does not serve is written over them
                bonds, remaining = make_bonds(*settings)
        if remaining > CONVERGED:
            virial = correction != "appendix_a"
            most_uneven = most_uneven_point(comm, points, discretization.materials, bonds, virial)
        if scene.peridynamics.stiffness_noise:
            bonds = perturbed(points, bonds, scene.peridynamics.stiffness_noise, scene.peridynamics.seed)
        if scene.output.damage:
            intact_weights = family_weights(comm, points, bonds)
        if scene.can_fail:
            own_energy = energy_of_own_bonds(comm, scene, discretization, subdomain.point_cells, points, bonds)
        for crack in scene.cracks:
            corners = (np.array(crack.polygon) - discretization.units.origin) / discretization.units.length
            normal, _ = polygon_normal(crack.polygon)
            cut.append(_cut_with_images(discretization, comm, points, bonds, corners, np.array(normal)))
    if discretization.has_nodes.any():
        nodes = _make_nodes(discretization, subdomain, comm)
        local = local_nodes(discretization, subdomain)
    if discretization.has_stiffness.any():
        elements = _make_elements(discretization, subdomain, local, comm, scene.kinematics == "finite")
    if discretization.is_overlap.any():
        overlap = Overlap(local[discretization.mesh.cells[subdomain.overlap]])
    mass, raised = _masses(comm, points, bonds, nodes, elements, overlap, relaxes(scene))
    return Model(
        comm=comm,
        units=discretization.units,
        owner=owner,
        subdomain=subdomain,
        points=points,
        bonds=bonds,
        nodes=nodes,
        elements=elements,
        overlap=overlap,
        mass=mass,
        correction_remaining=remaining,
        most_uneven=most_uneven,
        body_fit=body_fit,
        cut=tuple(cut),
        mirrors=discretization.mirrors,
        rollers=_rollers(discretization, subdomain, points, nodes),
        intact_weights=intact_weights,
        raised_masses=raised,
        own_energy=own_energy,
    )


def with_stable_masses(model: Model) -> Model:
    """The same model with masses for relaxation, as its bonds are now. Collective.

    They depend on nothing but the surviving bonds, so that a run that goes on from a checkpoint finds the same.
    """
    parts = model.points, model.bonds, model.nodes, model.elements, model.overlap
    mass, raised = _masses(model.comm, *parts, True)
    return replace(model, mass=mass, raised_masses=raised)


def build_intact_elements(discretization: Discretization, model: Model) -> Model:
    """The same body with a finite element in every cell, on the same ranks. Collective.

    Its stiffness is the local limit of the bonds: what coarse spaces are made of. Masses are left 0.
    """
    everywhere = np.ones(len(discretization.mesh.cells), bool)
    intact = replace(
        discretization,
        has_points=~everywhere,
        is_overlap=~everywhere,
        body=np.full(len(everywhere), -1, np.int32),
        has_stiffness=everywhere,
        point_cell_number=np.full(len(everywhere), -1),
        node_number=np.arange(len(discretization.nodes)),
    )
    subdomain = cut_out(intact, model.owner, model.comm.rank)
    nodes = _make_nodes(intact, subdomain, model.comm)
    elements = _make_elements(intact, subdomain, local_nodes(intact, subdomain), model.comm, False)
    return replace(
        model,
        subdomain=subdomain,
        points=None,
        bonds=None,
        nodes=nodes,
        elements=elements,
        overlap=None,
        mass=np.zeros(3 * nodes.n_owned),
        rollers=_rollers(intact, subdomain, None, nodes),
        intact_weights=None,
    )


def local_nodes(discretization: Discretization, subdomain: Subdomain) -> np.ndarray:
    """Local index of each node of the mesh on this rank, -1 for nodes it does not see; int32, shape (n_nodes,)."""
    local = np.full(len(discretization.nodes), -1, np.int32)
    seen = np.concatenate([subdomain.owned_nodes, subdomain.ghost_nodes])
    local[seen] = np.arange(len(seen))
    return local


def _make_points(discretization: Discretization, subdomain: Subdomain, comm) -> Points:
    owned = np.concatenate([subdomain.free, subdomain.overlap])
    cells = np.concatenate([owned, subdomain.ghosts])
    corners = discretization.nodes[discretization.mesh.cells[cells]]
    number = discretization.point_cell_number
    x, volume = gauss_positions(corners), gauss_volumes(corners)
    halo = build_halo(comm, number[owned], number[subdomain.ghosts], subdomain.ghost_owner)
    images = None
    if discretization.mirrors:
        local = np.full(len(number), -1)
        local[cells] = np.arange(len(cells))
        sign, shift = (rows[subdomain.reflection - 1] for rows in discretization.reflections)
        images = Images(local[subdomain.images], subdomain.reflection, sign, shift)
        halo = MirroredHalo(halo, images)
        x = np.concatenate([x, images.sign[:, None] * x[images.source] + images.shift[:, None]])
        volume = np.concatenate([volume, volume[images.source]])
        cells = np.concatenate([cells, subdomain.images])
    return Points(
        n_free=len(subdomain.free),
        n_owned=len(owned),
        cell_number=number[cells],
        material=discretization.material[cells],
        x=cluster_layout(x),
        volume=volume.reshape(-1),
        halo=halo,
        images=images,
        n_numbers=discretization.n_point_cells,
        body=discretization.body[cells] if discretization.n_bodies > 1 else None,
    )


def _cut_with_images(discretization: Discretization, comm, points: Points, bonds: Bonds, corners, normal) -> int:
    """Cut the bonds that cross a polygon or one of its mirror images. Collective."""
    reach = np.array([[-1.0], [1.0]]) * discretization.cutoff
    body = np.array([discretization.nodes.min(axis=0), discretization.nodes.max(axis=0)]) + reach
    box = np.array([corners.min(axis=0), corners.max(axis=0)])
    cut = cut_bonds(comm, points, bonds, corners, normal)
    for sign, shift in zip(*discretization.mirrors.reflections(box, body), strict=True):
        cut += cut_bonds(comm, points, bonds, sign * corners + shift, sign * normal)
    return cut


def _rollers(discretization: Discretization, subdomain: Subdomain, points: Points | None, nodes: Nodes | None):
    """Unknowns of owned nodes that are normal to a mirror plane through the node, int64."""
    if not nodes:
        return np.empty(0, np.int64)
    first = 24 * points.n_free if points else 0
    return first + np.flatnonzero(discretization.plane_components[subdomain.owned_nodes])


def _make_nodes(discretization: Discretization, subdomain: Subdomain, comm) -> Nodes:
    number = discretization.node_number
    owned, ghosts = subdomain.owned_nodes, subdomain.ghost_nodes
    local = np.concatenate([owned, ghosts])
    return Nodes(
        n_owned=len(owned),
        number=number[local],
        x=discretization.nodes[local],
        halo=build_halo(comm, number[owned], number[ghosts], subdomain.ghost_node_owner),
    )


def _shapes(discretization: Discretization) -> tuple[np.ndarray, np.ndarray]:
    """Sort the elements of the whole mesh by shape and Poisson's ratio, so that every rank treats a cell alike.

    Returns
    -------
    representatives : int64, shape (n_shapes,)
        The lowest-numbered cell of each shape; empty when there are too many shapes.
    shape : int64, shape (n_cells,)
        Index of each element's shape, -1 for a general hexahedron or a cell without element.
    """
    cells = np.flatnonzero(discretization.has_stiffness)
    corners = discretization.nodes[discretization.mesh.cells[cells]]
    relative = corners[:, 1:] - corners[:, :1]
    nu = discretization.poissons_ratio[cells]
    shape = np.full(len(discretization.has_stiffness), -1)
    representatives: list[int] = []
    left = np.arange(len(cells))
    while len(left):
        if len(representatives) == MOST_SHAPES:
            shape[cells[left]] = -1
            break
        same = (np.abs(relative[left] - relative[left[0]]) <= SHAPE_TOLERANCE).all(axis=(1, 2))
        same &= nu[left] == nu[left[0]]
        shape[cells[left[same]]] = len(representatives)
        representatives.append(int(cells[left[0]]))
        left = left[~same]
    return np.array(representatives, np.int64), shape


def _make_elements(discretization: Discretization, subdomain: Subdomain, local, comm, finite: bool) -> Elements:
    representatives, shape = _shapes(discretization)
    modulus, nu = discretization.youngs_modulus, discretization.poissons_ratio
    corners = discretization.nodes[discretization.mesh.cells]
    shared, turning, bound = [], [], 0.0
    for index, cell in enumerate(representatives):
        stiffness = element_stiffness(corners[cell][None], np.ones(1), nu[cell])
        mine = subdomain.elements[shape[subdomain.elements] == index]
        shared.append(SharedElements(local[discretization.mesh.cells[mine]], stiffness[0], modulus[mine]))
        moduli = lame_moduli(modulus[mine], nu[cell])
        turning.append(TurningElements(shared[-1].connectivity, gradient_tables(corners[cell][None]), *moduli))
        bound = max(bound, force_bound(stiffness) * float(modulus[mine].max(initial=0.0)))
    general = None
    if (shape[discretization.has_stiffness] < 0).any():
        mine = subdomain.elements[shape[subdomain.elements] < 0]
        lam, mu = lame_moduli(modulus[mine], nu[mine])
        general = GeneralElements(
            local[discretization.mesh.cells[mine]], corners[mine], gradient_tables(corners[mine]), lam, mu
        )
        turning.append(TurningElements(general.connectivity, general.tables, lam, mu))
        for start in range(0, len(mine), BATCH):
            batch = slice(start, start + BATCH)
            stiffness = stiffness_of_moduli(corners[mine[batch]], lam[batch], mu[batch])
            bound = max(bound, force_bound(stiffness))
    turning = tuple(turning) if finite else ()
    return Elements(tuple(shared), general, float(largest(comm, np.array([bound]))[0]), turning)


def _masses(comm, points, bonds, nodes, elements, overlap, stable) -> tuple[np.ndarray, int]:
    """Fictitious masses of the unknowns, and how many points have more than eq. (11) gives them.

    A node of the overlap carries the lumped densities of its points, ``sum_p N_I(x_p) lambda_p w_p``: by Gershgorin
    this bounds the stiffness N^T K N that it feels, as (22) does for the elements that have an internal force.
    ``stable``: with the densities of `stable_densities`; where nothing relaxes they are left out, and so is their time.
    """
    parts, raised = [], 0
    if points:
        densities = fictitious_masses(points, bonds)
        if stable:
            found = stable_densities(comm, points, bonds, densities)
            densities, raised = found.values, found.raised
        parts.append(np.repeat(densities.reshape(-1, 1, W)[: 2 * points.n_free], 3, axis=1).reshape(-1))
    if nodes:
        contributions = []
        if elements:
            masses = turning_masses if elements.finite else element_masses
            contributions += elements.per_node(lambda stiffness: masses(stiffness).reshape(-1, 8, 3))
        if overlap:
            density = densities.reshape(-1, 8)[points.n_free : points.n_owned]
            lumped = np.zeros((len(density), 8))
            for p in range(8):
                lumped += SHAPE_AT_GAUSS[p] * density[:, p, None]
            contributions.append((overlap.connectivity, np.repeat(lumped[:, :, None], 3, axis=2)))
        parts.append(assemble(comm, nodes, contributions, 3).reshape(-1))
    return np.concatenate(parts), raised


def assemble(comm, nodes: Nodes, contributions, width: int) -> np.ndarray:
    """Sum numbers of cells at their nodes, in any order to the same bits. Collective.

    Parameters
    ----------
    contributions : list of (int32 (n, 8), float64 (n, 8, width))
        Local nodes of cells, and a row of numbers for each.

    Returns
    -------
    float64, shape (n_owned, width)
    """
    top = max((float(np.abs(numbers).max(initial=0.0)) for _, numbers in contributions), default=0.0)
    quantum, _ = pattern_for(float(largest(comm, np.array([top]))[0]))
    total = np.zeros((len(nodes.number), width), np.int64)
    for where, numbers in contributions:
        np.add.at(total, where.reshape(-1), np.rint(numbers / quantum).astype(np.int64).reshape(-1, width))
    nodes.halo.scatter_reverse(total)
    return total[: nodes.n_owned] * quantum
