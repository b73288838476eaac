"""Thermal strain in linear kinematics: forces of bonds and elements that are held at their length at rest.

A bond that would like to be longer by ``theta |xi|``, the mean of its ends' ``alpha dT``, pulls with
``K' (eta . xi - theta |xi|^2) xi``, an element has the stress ``C (eps - alpha dT 1)``. The parts without displacement
are constant: they stand on the right-hand side with the loads, and a body that is free to expand is in equilibrium
with ``u = alpha dT x``, bond by bond and element by element.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pdfem_mpi.body.share import Share
from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.finite_elements.nodes import assemble, local_nodes
from pdfem_mpi.finite_elements.thermal_forces import element_forces
from pdfem_mpi.kernels.hex8 import SHAPE_AT_GAUSS
from pdfem_mpi.model.model import Model
from pdfem_mpi.model.temperatures import thermal_strains
from pdfem_mpi.peridynamics.clusters import cluster_layout
from pdfem_mpi.peridynamics.thermal_bonds import thermal_bond_forces, thermal_dilatations


@dataclass(frozen=True)
class Thermal:
    """At a load factor, 1 where it is made; model units.

    Attributes
    ----------
    forces : float64, shape (n_unknowns,), dimension force
        What the strain adds to the loads, held unknowns included.
    of_points : float64, shape (n_clusters * 4,), dimension 1
        ``alpha dT`` of the local points, ghosts and images included; empty without points.
    common : float64, shape (n_clusters * 4,), dimension 1
        What the strain gives the bonds of a point in common; empty without a volumetric part.
    of_cells : float64, shape (n, 8), dimension 1
        The same of the rank's own cells with elements or overlap, in the order of the mesh.
    """

    forces: np.ndarray
    of_points: np.ndarray
    common: np.ndarray
    of_cells: np.ndarray

    def at(self, load_factor: float) -> Thermal:
        """The same at another load factor."""
        arrays = self.forces, self.of_points, self.common, self.of_cells
        return Thermal(*(load_factor * array for array in arrays))


def make_thermal(scene: Scene, share: Share, model: Model) -> Thermal | None:
    """The thermal strain of the scene's ``[temperature]``; None without. Collective."""
    strains_of = thermal_strains(scene, share)
    if strains_of is None:
        return None
    forces, of_points, common, contributions = np.zeros(model.n_unknowns), np.empty(0), np.empty(0), []
    if model.points:
        of_points = np.ascontiguousarray(strains_of(model.subdomain.point_cells)).reshape(-1)
        body = model.comm, model.points, model.bonds, of_points
        common = thermal_dilatations(*body)
        on_points = thermal_bond_forces(*body, common)
        model.unknowns.of_points(forces)[:] = cluster_layout(on_points[: model.points.n_free])
        if model.overlap:  # lumped on the nodes, eq. (26)
            on_overlap, lumped = on_points[model.points.n_free :], np.zeros((len(share.subdomain.overlap), 8, 3))
            for p in range(8):
                lumped += SHAPE_AT_GAUSS[p][:, None] * on_overlap[:, p, None, :]
            contributions.append((model.overlap.connectivity, lumped))
    if model.elements:
        cells = share.subdomain.elements
        nodes = share.mesh.cells[cells]
        moduli = share.youngs_modulus[cells], share.poissons_ratio[cells]
        local = local_nodes(share)[nodes]
        contributions.append((local, element_forces(share.nodes[nodes], *moduli, strains_of(cells))))
    if model.nodes:
        model.unknowns.of_nodes(forces)[:] = assemble(model.comm, model.nodes, lambda: contributions, 3)
    return Thermal(forces, of_points, common, strains_of(np.union1d(share.subdomain.elements, share.subdomain.overlap)))
