"""Strain, stress and energy density at the eight points of each cell: of bonds, and of elements.

**Linear kinematics.** The strain is the symmetric part of the displacement gradient, the stress goes with it.

**Finite kinematics.** The strain is Green's, ``E = (F^T F - 1) / 2``; the stress is Cauchy's, the force on an area as
it is now: ``F S F^T / det F`` with the second stress ``S = lam tr(E) 1 + 2 mu E`` of an element, and
``1 / (2 w det F) sum f (x) y`` of bonds. The energy density counts per volume at rest in either.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pdfem_mpi.body.share import Share
from pdfem_mpi.finite_elements.nodes import local_nodes
from pdfem_mpi.kernels.element_tables import lame_moduli
from pdfem_mpi.kernels.hex8 import gauss_gradients
from pdfem_mpi.measure.tensors import determinants, matrices, products, six_of, trace
from pdfem_mpi.model.forces import Forces
from pdfem_mpi.model.thermal import Thermal
from pdfem_mpi.peridynamics.virial import bond_stresses, displacement_gradients

#: Elements that are worked on together: their gradients take 1.5 kB each.
BATCH = 4096


@dataclass(frozen=True)
class Mechanics:
    """At the eight points of a rank's own cells, in model units.

    Attributes
    ----------
    cells : int64, shape (n,)
        Number of each in the mesh.
    rows : int64, shape (n,)
        Number among the cells with points, or among those with nodes, of the whole body.
    volume : float64, shape (n, 8), dimension length^3
        What each of the eight points stands for.
    strain, stress : float64, shape (n, 8, 6), dimensions 1 and force / length^2
        xx, yy, zz, xy, yz, zx; the shears are those of the tensor, half of the angles.
    energy_density : float64, shape (n, 8), dimension force / length^2
    """

    cells: np.ndarray
    rows: np.ndarray
    volume: np.ndarray
    strain: np.ndarray
    stress: np.ndarray
    energy_density: np.ndarray


def mechanics_of_bonds(share: Share, forces: Forces, thermal: Thermal | None = None) -> Mechanics | None:
    """At the peridynamic points, at the displacements of the last evaluation; None without any. Collective.

    The stress is that of the bonds which are there, the strain that of least squares over the family; NaN where the
    family that is left lies in a plane.
    """
    model = forces.model
    if not model.points:
        return None
    points, bonds = model.points, model.bonds
    held = (thermal.of_points, thermal.common) if thermal else ()
    stress, energy = bond_stresses(model.comm, forces.of_bonds, *held)
    gradient = displacement_gradients(model.comm, points, bonds, forces.of_bonds.S)
    strain = strain_of(gradient, model.finite)
    if model.finite:
        ratio = determinants(np.eye(3) + gradient)
        stress /= np.where(ratio > 0.0, ratio, 1.0)[..., None]  # also where there is no family to tell it
    cells, volume = points.cell_number[: points.n_owned], points.volume[: 8 * points.n_owned].reshape(-1, 8)
    return Mechanics(cells, share.own_point_rows, volume, strain, stress, energy)


def mechanics_of_elements(share: Share, forces: Forces, thermal: Thermal | None = None) -> Mechanics | None:
    """At the Gauss points of elements and overlap, at the last evaluation's displacements; None without any.

    In the overlap it is what an element with the displacements of the nodes has, whether or not it carries a force.
    """
    model, mesh = forces.model, share.mesh
    if not model.nodes:
        return None
    own = np.union1d(share.subdomain.elements, share.subdomain.overlap)
    local = local_nodes(share)
    moduli = lame_moduli(share.youngs_modulus[own], share.poissons_ratio[own])
    finite = bool(model.elements and model.elements.finite)
    parts = [(np.empty((0, 8)), np.empty((0, 8, 6)), np.empty((0, 8, 6)), np.empty((0, 8)))]
    for start in range(0, len(own), BATCH):
        batch = own[start : start + BATCH]
        corners = mesh.cells[batch]
        u = forces.of_nodes.u[local[corners]]
        lam, mu = (modulus[start : start + BATCH] for modulus in moduli)
        expansion = np.zeros((len(batch), 8)) if thermal is None else thermal.of_cells[start : start + BATCH]
        parts.append(response(share.nodes[corners], u, lam, mu, finite, expansion))
    volume, strain, stress, energy = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
    return Mechanics(mesh.cell_id[own], share.element_row[own], volume, strain, stress, energy)


def response(
    corners: np.ndarray, u: np.ndarray, lam: np.ndarray, mu: np.ndarray, finite: bool, expansion: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """What elements have at their Gauss points.

    Parameters
    ----------
    corners, u : float64, shape (n, 8, 3), dimension length
        Positions and displacements of their nodes.
    lam, mu : float64, shape (n,), dimension force / length^2
    expansion : float64, shape (n, 8), dimension 1
        Thermal strain, which has no stress.

    Returns
    -------
    volume, strain, stress, energy_density
        As in `Mechanics`.
    """
    gradients, volume = gauss_gradients(corners)
    gradient = np.zeros((*volume.shape, 3, 3))
    for a in range(1, 8):  # differences to node 0: a translation gives nothing
        gradient += (u[:, a] - u[:, 0])[:, None, :, None] * gradients[:, :, a, None, :]
    strain = strain_of(gradient, finite)
    elastic = strain.copy()
    elastic[..., :3] -= expansion[..., None]
    lam, mu = lam[:, None], mu[:, None]
    pressure = lam * trace(elastic)
    stress = 2.0 * mu[..., None] * elastic
    stress[..., :3] += pressure[..., None]
    work = stress * elastic
    energy = 0.5 * trace(work) + (work[..., 3] + work[..., 4] + work[..., 5])
    if finite:
        turned = np.eye(3) + gradient
        ratio = determinants(turned)
        stress = six_of(products(products(turned, matrices(stress)), turned.swapaxes(-1, -2))) / ratio[..., None]
    return volume, strain, stress, energy


def strain_of(gradient: np.ndarray, finite: bool) -> np.ndarray:
    """Green's (else the linear) strain of displacement gradients, shape (..., 3, 3) to (..., 6)."""
    strain = six_of(gradient)
    if finite:
        strain += 0.5 * six_of(products(gradient.swapaxes(-1, -2), gradient))
    return strain
