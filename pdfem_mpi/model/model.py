"""Model: the constants of a run on one rank. Parts that the scene does not have are None."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pdfem_mpi.body.model_units import ModelUnits
from pdfem_mpi.body.share import Share, Subdomain
from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.finite_elements.elements import Elements, make_elements
from pdfem_mpi.finite_elements.nodes import Nodes, local_nodes, make_nodes
from pdfem_mpi.finite_elements.overlap_cells import Overlap
from pdfem_mpi.mesh.mirrors import Mirrors
from pdfem_mpi.model.masses import make_masses
from pdfem_mpi.model.springs import Springs, make_springs
from pdfem_mpi.model.ties import Ties, make_ties
from pdfem_mpi.model.unknowns import Unknowns
from pdfem_mpi.peridynamics.bonds import Bonds
from pdfem_mpi.peridynamics.cracks import cut_crack, cut_faces
from pdfem_mpi.peridynamics.damage import family_weights
from pdfem_mpi.peridynamics.fit.fit import BodyFit
from pdfem_mpi.peridynamics.fracture_energy import energy_of_own_bonds
from pdfem_mpi.peridynamics.making_bonds import bonds_of_scene
from pdfem_mpi.peridynamics.points import Points
from pdfem_mpi.peridynamics.sharing_bonds import with_needed_ghosts
from pdfem_mpi.peridynamics.softened import in_their_rows
from pdfem_mpi.peridynamics.stable_masses import relaxes
from pdfem_mpi.peridynamics.uneven import CONVERGED, most_uneven_point
from pdfem_mpi.peridynamics.volumetric import Moment

if TYPE_CHECKING:
    from mpi4py.MPI import Intracomm


@dataclass(frozen=True)
class Model:
    """Constants of a run on one rank, in model units.

    Attributes
    ----------
    comm : Intracomm
    units : ModelUnits
    subdomain : Subdomain
        Places of its cells and nodes in the rank's share.
    points, bonds, nodes, elements, overlap : or None
        What the scene has; the same parts on every rank, though a rank's share may be empty.
    mass : float64, shape (n_unknowns,), dimension force / length
        Fictitious masses (eqs 11, 22) of the unknowns: free points in cluster layout, then owned nodes. Empty where
        the region of bonds is found, and in `build_intact_elements`.
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
    springs : Springs or None
        Between the body and the ground.
    ties : Ties or None
        Unknowns that are equal.
    """

    comm: Intracomm
    units: ModelUnits
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
    springs: Springs | None = None
    ties: Ties | None = None

    @property
    def finite(self) -> bool:
        """Whether anything follows finite displacements: bonds, elements or both. The same on all ranks."""
        return bool((self.bonds and self.bonds.finite) or (self.elements and self.elements.finite))

    @property
    def moments(self) -> tuple[Moment, ...]:
        """How near the points of materials with a volumetric part come to what is stable."""
        return self.bonds.volumetric.moments if self.bonds and self.bonds.volumetric else ()

    @cached_property
    def unknowns(self) -> Unknowns:
        """The order of a vector over this rank's unknowns."""
        return _unknowns_of(self.points, self.nodes)

    @property
    def n_unknowns(self) -> int:
        """Owned unknowns."""
        return self.unknowns.size

    @property
    def own_part(self) -> np.ndarray:
        """Part of each unknown on this side of mirror planes: 1/2 on one, 1/4 on two; float64, shape (n_unknowns,)."""
        planes = np.zeros(self.n_unknowns)
        planes[self.rollers] = 1.0
        of_nodes = self.unknowns.of_nodes(planes)
        of_nodes[:] = of_nodes.sum(axis=1)[:, None]
        return 0.5**planes


def build_model(
    scene: Scene, share: Share, comm: Intracomm, fits: tuple[Path, ...] = (), without: Collection[str] = ()
) -> Model:
    """Compute the constants of a rank's share. Collective.

    Where the region of bonds is found, nothing relaxes but by masses of its own, and there are none.

    Parameters
    ----------
    fits : paths
        Folders where fits of bond factors are looked for and left.
    without : names
        Of attributes that nobody will ask for: "intact_weights", "own_energy".

    Raises
    ------
    SceneError
        A body whose bond factors cannot be fitted, or whose bonds do not bear its Poisson's ratio.
    """
    counts, made = share.counts, _NO_BONDS
    nodes = elements = overlap = None
    if counts.point_cells:
        share, made = _make_bonds(scene, share, comm, fits, without)
    if counts.node_cells:
        nodes = make_nodes(share, comm)
        local = local_nodes(share)
    if counts.elements:
        elements = make_elements(share, local, comm, scene.kinematics == "finite")
    if counts.overlap_cells:
        overlap = Overlap(local[share.mesh.cells[share.subdomain.overlap]])
    points, mass, raised = made["points"], np.empty(0), 0
    springs, ties = (make(scene, share, _unknowns_of(points, nodes)) for make in (make_springs, make_ties))
    if not scene.is_adaptive:
        mass, raised = make_masses(comm, points, made["bonds"], nodes, elements, overlap, relaxes(scene))
        mass = _restrained(comm, mass, springs, ties)
    return Model(
        comm=comm,
        units=share.units,
        subdomain=share.subdomain,
        **made,
        nodes=nodes,
        elements=elements,
        overlap=overlap,
        mass=mass,
        mirrors=share.mirrors,
        rollers=_rollers(share, points, nodes),
        raised_masses=raised,
        springs=springs,
        ties=ties,
    )


#: What of a model its bonds are, where there are none.
_NO_BONDS = {"points": None, "bonds": None, "correction_remaining": 0.0, "body_fit": None, "cut": ()}


def _make_bonds(scene, share, comm, fits, without) -> tuple[Share, dict[str, Any]]:
    """The share with the ghosts that its bonds reach, and what of a model these are; as `build_model`. Collective."""
    share, points = with_needed_ghosts(share, comm, scene.kinematics == "finite")
    bonds, remaining, body_fit = bonds_of_scene(scene, share, comm, points, fits)
    points = replace(points, depths=None)
    made = {"points": points, "bonds": bonds, "correction_remaining": remaining, "body_fit": body_fit}
    if remaining > CONVERGED:
        virial = scene.peridynamics.surface_correction != "appendix_a"
        made["most_uneven"] = most_uneven_point(comm, points, share.materials, bonds, virial)
    if scene.output.has_damage and "intact_weights" not in without:
        made["intact_weights"] = family_weights(comm, points, bonds)
    if scene.can_fail and "own_energy" not in without:
        made["own_energy"] = energy_of_own_bonds(comm, scene, share, points, bonds)
    made["cut"] = tuple(cut_crack(share, comm, points, bonds, crack) for crack in scene.cracks)
    cut_faces(share, points, bonds)
    return share, made


def _unknowns_of(points: Points | None, nodes: Nodes | None) -> Unknowns:
    return Unknowns(8 * points.n_free if points else 0, nodes.n_owned if nodes else 0)


def _restrained(comm, mass: np.ndarray, springs: Springs | None, ties: Ties | None) -> np.ndarray:
    """Masses that bound springs too, and are one for places that move as one. Collective."""
    if springs:
        mass[springs.index] += springs.stiffness
    if ties:
        ties.raise_to_largest(comm, mass)
    return mass


def with_stable_masses(model: Model) -> Model:
    """The same model with masses for relaxation, as its bonds are now. Collective.

    They depend on nothing but the surviving bonds, softened ones as if they were intact, so that a run that goes on
    from a checkpoint finds the same.
    """
    parts = model.points, model.bonds, model.nodes, model.elements, model.overlap
    with in_their_rows(model.bonds):
        mass, raised = make_masses(model.comm, *parts, True)
    return replace(model, mass=_restrained(model.comm, mass, model.springs, model.ties), raised_masses=raised)


def build_intact_elements(share: Share, model: Model) -> Model:
    """The same body with a finite element in every cell, on the same ranks. Collective.

    Its stiffness is the local limit of the bonds: what coarse spaces are made of. It has no masses.
    """
    intact = share.with_elements_everywhere()
    nodes = make_nodes(intact, model.comm)
    elements = make_elements(intact, local_nodes(intact), model.comm, False)
    return replace(
        model,
        subdomain=intact.subdomain,
        points=None,
        bonds=None,
        nodes=nodes,
        elements=elements,
        overlap=None,
        mass=np.empty(0),
        rollers=_rollers(intact, None, nodes),
        intact_weights=None,
        springs=model.springs and model.springs.on_nodes(intact.subdomain.owned_nodes, len(share.nodes)),
        ties=None,
    )


def _rollers(share: Share, points: Points | None, nodes: Nodes | None):
    """Unknowns of owned nodes that are normal to a mirror plane through the node, int64."""
    if not nodes:
        return np.empty(0, np.int64)
    first = 24 * points.n_free if points else 0
    return first + np.flatnonzero(share.plane_components[share.subdomain.owned_nodes])
