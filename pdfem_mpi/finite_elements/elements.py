"""Finite elements of a rank: those of one shape share a stiffness matrix, others have tables of their own."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from pdfem_mpi.body.discretization import Discretization
from pdfem_mpi.body.share import Subdomain
from pdfem_mpi.kernels.element_tables import (
    element_masses,
    element_stiffness,
    force_bound,
    gradient_tables,
    lame_moduli,
    stiffness_of_moduli,
    turning_masses,
)
from pdfem_mpi.parallel.comm import largest

#: Cells whose corners agree within this fraction of the model unit of length share a stiffness matrix.
SHAPE_TOLERANCE = 1e-9
#: More shapes than this, and the cells are treated as general hexahedra.
MOST_SHAPES = 4
#: Elements whose stiffness matrices are formed together at set-up.
BATCH = 4096


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

    def masses(self) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Fictitious masses (eq. 22) for the elements' nodes, (n, 8, 3); see `per_node`."""
        of_stiffness = turning_masses if self.finite else element_masses
        return self.per_node(lambda stiffness: of_stiffness(stiffness).reshape(-1, 8, 3))


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


def make_elements(discretization: Discretization, subdomain: Subdomain, local, comm, finite: bool) -> Elements:
    """The elements of a rank. Collective.

    Parameters
    ----------
    local : int32, shape (n_mesh_nodes,)
        From `nodes.local_nodes`.
    finite : bool
        Finite (else linear) kinematics.
    """
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
