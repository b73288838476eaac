"""Which cells and nodes of the body a rank owns, and which it sees as ghosts.

A node belongs to one of the ranks with a cell around it, which is chosen so that few pairs of ranks have nodes in
common that one of them owns (`node_owners`). Ghost cells are those within the cutoff radius of an owned cell, ghost
nodes those of owned elements and overlap cells that another rank owns.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from pdfem_mpi.body.discretization import Discretization
from pdfem_mpi.body.near_places import NearPlaces
from pdfem_mpi.kernels.exact_sums import MOST_RANKS
from pdfem_mpi.kernels.hex8 import gauss_positions
from pdfem_mpi.mesh.hexmesh import HexMesh

if TYPE_CHECKING:
    from pdfem_mpi.mesh.part import MeshPart

#: Distance of two centroids beyond that of the two balls around their cells' Gauss points, and the balls' radii, in
#: longest edges, at most: two nodes of a cell are three edges apart or less.
WIDEST_BALLS = 12.0
#: Cells whose balls are found together.
BALLS = 1024


@dataclass(frozen=True)
class Subdomain:
    """Cells and nodes of one rank, by their numbers in the mesh; in a `Share`, by their places among its own.

    Attributes
    ----------
    free, overlap, ghosts : int64
        Owned cells with free points, owned overlap cells, ghost cells with points. Points are stored in this order.
    ghost_owner : int32, shape (n_ghosts,)
    images : int64
        Owned cells and ghosts whose mirror images lie within the cutoff radius; a cell may have several.
    reflection : int64, shape (n_images,)
        Number, from 1, of the reflection among those of the body.
    elements : int64
        Owned cells whose elements have an internal force.
    owned_nodes, ghost_nodes : int64
        Nodes that carry unknowns, owned ones first wherever nodes are stored.
    ghost_node_owner : int32
    """

    free: np.ndarray
    overlap: np.ndarray
    ghosts: np.ndarray
    ghost_owner: np.ndarray
    images: np.ndarray
    reflection: np.ndarray
    elements: np.ndarray
    owned_nodes: np.ndarray
    ghost_nodes: np.ndarray
    ghost_node_owner: np.ndarray

    @property
    def point_cells(self) -> np.ndarray:
        """Cell of each local cell with points, in the order they are stored in; int64."""
        return np.concatenate([self.free, self.overlap, self.ghosts, self.images])


def centroids_of(discretization: Discretization) -> np.ndarray:
    """Of all cells, model units."""
    return discretization.units.places(discretization.mesh.centroids)


def cut_out(discretization: Discretization, owner: np.ndarray, rank: int) -> Subdomain:
    """The share of one rank."""
    mesh = discretization.mesh
    mine = owner == rank
    order = locality_order(mesh)
    free = order[(mine & discretization.has_points & ~discretization.is_overlap)[order]]
    overlap = order[(mine & discretization.is_overlap)[order]]
    ghosts = _ghost_cells(discretization, owner, rank, order)
    images, reflection = _image_cells(discretization, np.concatenate([free, overlap]), ghosts)

    owner_of_node = node_owners(mesh, discretization.has_nodes, owner)
    owned_nodes, ghost_nodes = split_nodes(mesh, owner_of_node, mine & discretization.has_nodes, rank)
    return Subdomain(
        free=free,
        overlap=overlap,
        ghosts=ghosts,
        ghost_owner=owner[ghosts],
        images=images,
        reflection=reflection,
        elements=order[(mine & discretization.has_stiffness)[order]],
        owned_nodes=owned_nodes,
        ghost_nodes=ghost_nodes,
        ghost_node_owner=owner_of_node[ghost_nodes],
    )


def by_places(found: Subdomain, mesh: HexMesh, part: MeshPart) -> Subdomain:
    """The same cells and nodes by their places in a part of the mesh."""
    cells = {name: part.places_of_cells(mesh.cell_id[getattr(found, name)]) for name in
             ("free", "overlap", "ghosts", "images", "elements")}  # fmt: skip
    nodes = {name: part.places_of_nodes(mesh.node_id[getattr(found, name)]) for name in ("owned_nodes", "ghost_nodes")}
    return replace(found, **cells, **nodes)


def node_owners(mesh: HexMesh, carries: np.ndarray, owner: np.ndarray) -> np.ndarray:
    """Owner of each node of the cells that carry nodes: the first of the ranks around it; -1 for other nodes.

    Ranks come in one order, so that of any two the same one owns what they share, and messages between them go one way.
    Ranks whose numbers have an odd number of binary ones come first. Bisection numbers its halves with one digit each:
    ranks side by side differ in it, and take turns like the squares of a chessboard. Two squares that meet at a corner
    have one colour; of the four around an edge the two of the other colour own nothing of each other.

    Parameters
    ----------
    carries : bool, shape (n_cells,)
    owner : int32, shape (n_cells,)
    """
    found = np.full(len(mesh.nodes), -1, np.int32)
    carriers = np.flatnonzero(carries)
    last_first = np.argsort(_turn(owner[carriers]), kind="stable")[::-1]
    carriers = carriers[last_first]
    found[mesh.cells[carriers]] = owner[carriers, None]  # the last assignment stays: the first rank's
    return found


def _turn(rank: np.ndarray) -> np.ndarray:
    """When ranks take nodes; uint16, which sorts fast, as there are at most `MOST_RANKS`."""
    odd = rank.astype(np.uint16)
    for shift in (8, 4, 2, 1):
        odd ^= odd >> np.uint16(shift)
    return rank.astype(np.uint16) + np.uint16(MOST_RANKS) * (1 - (odd & np.uint16(1)))


def split_nodes(mesh: HexMesh, owner_of_node: np.ndarray, cells: np.ndarray, rank: int) -> tuple[np.ndarray, ...]:
    """Nodes that a rank owns, and those of its cells, bool (n_cells,), that others own; int64."""
    touched = np.zeros(len(mesh.nodes), bool)
    touched[mesh.cells[cells]] = True
    return np.flatnonzero(owner_of_node == rank), np.flatnonzero(touched & (owner_of_node != rank))


def locality_order(mesh: HexMesh) -> np.ndarray:
    """Cells in layers across the longest axis, then across the second longest: neighbours stay near in memory."""
    layer = np.floor((mesh.centroids - mesh.lower) / mesh.mean_edge * (1 + 1e-9)).astype(np.int64)
    short, middle, long = np.argsort(mesh.upper - mesh.lower, kind="stable")
    return np.lexsort((np.arange(len(layer)), layer[:, short], layer[:, middle], layer[:, long]))


def _ghost_cells(discretization, owner, rank, order) -> np.ndarray:
    """Cells of other ranks with a point within the cutoff radius of an owned point, or nearly so."""
    has_points = discretization.has_points
    mine = np.flatnonzero(has_points & (owner == rank))
    others = np.flatnonzero(has_points & (owner != rank))
    if not len(mine) or not len(others):
        return np.empty(0, np.int64)
    others = _near_box(discretization, mine, others)
    (centre, radius), (owned_centre, owned_radius) = (cell_balls(discretization, some) for some in (others, mine))
    if not len(others):
        return np.empty(0, np.int64)
    widest = max(radius.max(), owned_radius.max())
    distance = NearPlaces(owned_centre, discretization.cutoff + 2.0 * widest).distances(centre)
    near = np.isfinite(distance)
    # the nearest centre need not be the nearest cell when sizes differ: compare with the largest owned radius
    keep = distance[near] <= discretization.cutoff + radius[near] + owned_radius.max()
    chosen = np.zeros(len(owner), bool)
    chosen[others[near][keep]] = True
    return order[chosen[order]]


def _near_box(discretization, mine, others) -> np.ndarray:
    """Those of other cells whose balls may come within the cutoff radius of a ball of the rank's own; int64."""
    mesh, centroids = discretization.mesh, centroids_of(discretization)
    reach = discretization.cutoff + WIDEST_BALLS * mesh.largest_edge / discretization.units.length
    low, high = centroids[mine].min(axis=0) - reach, centroids[mine].max(axis=0) + reach
    return others[((centroids[others] >= low) & (centroids[others] <= high)).all(axis=1)]


def _image_cells(discretization, owned, ghosts) -> tuple[np.ndarray, np.ndarray]:
    """Cells with a mirror image within the cutoff radius of an owned cell, or nearly so, and the reflections."""
    if not discretization.mirrors or not len(owned):
        return np.empty(0, np.int64), np.empty(0, np.int64)
    cells = np.concatenate([owned, ghosts])
    centre, radius = cell_balls(discretization, cells)
    own = slice(0, len(owned))
    near, reflection, images = near_images(discretization, centre, centre[own], 2.0 * radius.max())
    distance = NearPlaces(centre[own], discretization.cutoff + 2.0 * radius.max()).distances(images)
    keep = distance <= discretization.cutoff + radius[near] + radius[own].max()
    return cells[near][keep], reflection[keep]


def near_images(discretization, x, target, margin=0.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mirror images of positions within the cutoff radius and a margin of the box around others; model units.

    Parameters
    ----------
    x, target : float64, shapes (n, 3), (m, 3), dimension length
    margin : float, dimension length

    Returns
    -------
    index : int64, shape (n_images,)
        Of the positions; reflection by reflection, each in the positions' order.
    reflection : int64, shape (n_images,)
        Number, from 1.
    image : float64, shape (n_images, 3), dimension length
    """
    reach = discretization.cutoff + margin
    low, high = target.min(axis=0) - reach, target.max(axis=0) + reach
    found = [(np.empty(0, np.int64), np.empty(0, np.int64), np.empty((0, 3)))]
    for number, (sign, shift) in enumerate(zip(*discretization.reflections, strict=True), start=1):
        image = sign * x + shift
        index = np.flatnonzero(((image >= low) & (image <= high)).all(axis=1))
        found.append((index, np.full(len(index), number), image[index]))
    return tuple(np.concatenate(parts) for parts in zip(*found, strict=True))


def cell_balls(discretization, cells) -> tuple[np.ndarray, np.ndarray]:
    """Centre and radius of a ball around the Gauss points of some cells, model units."""
    centre, radius = np.empty((len(cells), 3)), np.empty(len(cells))
    for start in range(0, len(cells), BALLS):
        part = slice(start, start + BALLS)
        points = gauss_positions(discretization.nodes[discretization.mesh.cells[cells[part]]])
        centre[part] = 0.5 * (points.min(axis=1) + points.max(axis=1))
        radius[part] = np.sqrt(((points - centre[part, None]) ** 2).sum(axis=2).max(axis=1))
    return centre, radius
