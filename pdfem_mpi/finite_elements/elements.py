"""Finite elements of a rank: those of one shape share a stiffness matrix, others have tables of their own."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from pdfem_mpi.body.share import Share
from pdfem_mpi.kernels.element_tables import (
    element_masses,
    element_stiffness,
    force_bound,
    gradient_tables,
    lame_moduli,
    stiffness_of_moduli,
    turning_masses,
)
from pdfem_mpi.parallel.comm import broadcast, largest

#: Cells whose corners agree within this fraction of the model unit of length share a stiffness matrix.
SHAPE_TOLERANCE = 1e-9
#: More shapes than this, and the cells are treated as general hexahedra.
MOST_SHAPES = 4
#: Elements whose stiffness matrices are formed together at set-up: few enough for the second cache.
BATCH = 64
#: Cells that are compared with a shape together.
COMPARED = 2**14


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
        """Numbers taken from the elements' stiffness matrices, for their nodes, some elements at a time.

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
            numbers = pick(part.stiffness[None])
            for start in range(0, len(part.connectivity), BATCH):
                batch = slice(start, start + BATCH)
                yield part.connectivity[batch], part.scale[batch, None, None] * numbers
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


def _shapes(share: Share) -> tuple[list[tuple[np.ndarray, float]], np.ndarray, bool]:
    """Sort the elements of all ranks by shape and Poisson's ratio, so that every rank treats a cell alike. Collective.

    Returns
    -------
    shapes : list of (float64 (8, 3), float)
        Corners and Poisson's ratio of the lowest-numbered cell of each shape.
    shape : int64, shape (n_cells,)
        Index of each owned element's shape, -1 for a general hexahedron, other cells and those of other ranks.
    general : bool
        There are more shapes on some rank.
    """
    comm, ratios = share.comm, share.poissons_ratio
    shape = np.full(len(share.has_stiffness), -1)
    shapes: list[tuple[np.ndarray, float]] = []
    left = np.sort(share.subdomain.elements)
    while True:
        own = -int(share.mesh.cell_id[left[0]]) * comm.size - comm.rank if len(left) else -math.inf
        lowest = -float(largest(comm, np.array([own], float))[0])
        if lowest == math.inf:
            return shapes, shape, False
        if len(shapes) == MOST_SHAPES:
            return shapes, shape, True
        owner = int(lowest) % comm.size
        found = (share.nodes[share.mesh.cells[left[0]]], ratios[left[0]]) if comm.rank == owner else None
        first, ratio = broadcast(comm, found, owner)
        shapes.append((first, ratio))
        same = ratios[left] == ratio
        for start in range(0, len(left), COMPARED):
            some = slice(start, start + COMPARED)
            corners = share.nodes[share.mesh.cells[left[some]]]
            offset = np.abs(corners[:, 1:] - corners[:, :1] - (first[1:] - first[:1]))
            same[some] &= (offset <= SHAPE_TOLERANCE).all(axis=(1, 2))
        shape[left[same]] = len(shapes) - 1
        left = left[~same]


def make_elements(share: Share, local, comm, finite: bool) -> Elements:
    """The elements of a rank. Collective.

    Parameters
    ----------
    local : int32, shape (n_nodes,)
        From `nodes.local_nodes`.
    finite : bool
        Finite (else linear) kinematics.
    """
    shapes, shape, any_general = _shapes(share)
    elements = share.subdomain.elements
    modulus, nu = share.youngs_modulus, share.poissons_ratio
    shared, turning, bound = [], [], 0.0
    for index, (corners, ratio) in enumerate(shapes):
        stiffness = element_stiffness(corners[None], np.ones(1), ratio)
        mine = elements[shape[elements] == index]
        shared.append(SharedElements(local[share.mesh.cells[mine]], stiffness[0], modulus[mine]))
        moduli = lame_moduli(modulus[mine], ratio)
        turning.append(TurningElements(shared[-1].connectivity, gradient_tables(corners[None]), *moduli))
        bound = max(bound, force_bound(stiffness) * float(modulus[mine].max(initial=0.0)))
    general = None
    if any_general:
        mine = elements[shape[elements] < 0]
        corners = share.nodes[share.mesh.cells[mine]]
        lam, mu = lame_moduli(modulus[mine], nu[mine])
        general = GeneralElements(local[share.mesh.cells[mine]], corners, gradient_tables(corners), lam, mu)
        turning.append(TurningElements(general.connectivity, general.tables, lam, mu))
        for start in range(0, len(mine), BATCH):
            batch = slice(start, start + BATCH)
            stiffness = stiffness_of_moduli(corners[batch], lam[batch], mu[batch])
            bound = max(bound, force_bound(stiffness))
    turning = tuple(turning) if finite else ()
    return Elements(tuple(shared), general, float(largest(comm, np.array([bound]))[0]), turning)
