"""The cells whose bonds can soften: how long they are decides what planes of their lattice take."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pdfem_mpi.body.discretization import Discretization
from pdfem_mpi.body.materials import bond_materials
from pdfem_mpi.deck.scene import Scene


@dataclass(frozen=True)
class SofteningCells:
    """Sizes of the cells whose bonds can soften; a function of the deck and the mesh alone, the same on all ranks.

    Attributes
    ----------
    edge : float
        Median of the edges of the cells, taken as cubes; model units.
    spread : float, dimension 1
        The largest of these edges over the smallest.
    aspect : float, dimension 1
        The longest edge of a cell over its shortest, of the cell in which that is largest.
    """

    edge: float
    spread: float
    aspect: float


def softening_cells(scene: Scene, body: Discretization, can_turn: np.ndarray | None = None) -> SofteningCells | None:
    """Sizes of the cells whose bonds can soften; None where there are none. Collective, if ranks see parts.

    Parameters
    ----------
    can_turn : bool, shape (n_cells,), optional
        Of a region of bonds that is found: cells that could be turned. What is turned by now does not matter, so that
        bonds keep their law when the region grows.
    """
    if not scene.softens or not body.cutoff:
        return None
    everywhere = body.mesh.everywhere
    softens = np.array([any(material.softens for of in row for material in of) for row in bond_materials(scene)])
    may_fail = np.array([region.may_fail is not False for region in scene.regions])
    chosen = softens[body.material] & may_fail[body.region] & (body.is_peridynamic if can_turn is None else can_turn)
    if not everywhere.count(chosen)[0]:
        return None
    places = np.flatnonzero(everywhere.mine(chosen))
    cells = body.mesh.cells[places]
    edge = cube_edges(body.nodes, cells)
    edges = body.mesh.edges(places)
    aspect = edges.max(axis=0) / edges.min(axis=0)
    ends = np.array([edge.max(initial=0.0), -edge.min(initial=np.inf), aspect.max(initial=1.0)])
    middle = everywhere.median(edge)
    most, least, longest = everywhere.largest(ends).tolist()
    return SofteningCells(middle, most / -least, longest)


def cube_edges(nodes: np.ndarray, cells: np.ndarray) -> np.ndarray:
    """Edges of cells taken as cubes, from a diagonal; float64, shape (n_cells,), in the unit of the nodes."""
    return np.sqrt(((nodes[cells[:, 6]] - nodes[cells[:, 0]]) ** 2).sum(axis=1) / 3.0)
