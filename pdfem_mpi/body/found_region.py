"""A region of bonds that is found: which cells may be turned, which are, and what a rank must know to ask for more.

Cells are elements at the beginning. A run tells where bonds are needed; the cells near to these are *turned*:
described by bonds that may fail, with layers of bonds that may not fail around them. All of it is a function of the
deck, the mesh and the set of turned cells, so that a run that goes on from a checkpoint finds the same body.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from pdfem_mpi.body.describing import describe
from pdfem_mpi.body.discretization import Discretization
from pdfem_mpi.body.near_cracks import near_cracks
from pdfem_mpi.body.near_places import NearPlaces
from pdfem_mpi.body.selection import ChosenFaces, ChosenSpots, select_places
from pdfem_mpi.body.subdomain import Subdomain, cut_out
from pdfem_mpi.deck.loads import BodyForce
from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.deck.table import SceneError

if TYPE_CHECKING:
    from pdfem_mpi.mesh.part import MeshPart

#: Distances are compared with this relative tolerance, so that twins in a mirror are turned together.
DISTANCE_TOLERANCE = 1e-9
#: Bodies of so many cells are kept as they are without bonds, on every rank: 50 MB, and a switch need not make them
#: again. One rank keeps any.
FEW_CELLS = 2**18


@dataclass(frozen=True)
class Turning:
    """What to turn: cells that are turned already, and places near which others are; the same on all ranks.

    Attributes
    ----------
    turned : int64, shape (n,)
        Numbers of cells in the mesh, rising.
    near_cells : int64, shape (m,)
        Numbers of cells around which all within ``radius`` is turned.
    near_places : float64, shape (k, 3), dimension length
        Places in the deck's units, all cells within ``place_radius`` of which are turned.
    radius : float
        In internal lengths.
    place_radius : float, dimension length
        In the deck's units.
    cracks : bool
        Whether what is around initial cracks is turned as well.
    """

    turned: np.ndarray
    near_cells: np.ndarray
    radius: float = 0.0
    near_places: np.ndarray | None = None
    place_radius: float = 0.0
    cracks: bool = False


@dataclass(frozen=True)
class Unturned:
    """The whole body before any cell was turned.

    Attributes
    ----------
    elements : Discretization
    can_turn, at_the_end : bool, shape (n_cells,)
        As of `FoundRegion`, of all cells.
    """

    elements: Discretization
    can_turn: np.ndarray
    at_the_end: np.ndarray


@dataclass(frozen=True)
class FoundRegion:
    """What a rank knows of a region that is found; rows of arrays are the cells of its share.

    Attributes
    ----------
    turned : int64, shape (n,)
        All turned cells of the body, numbers in the mesh, rising; the same on all ranks.
    is_turned : bool, shape (n_cells,)
        Cells whose bonds may fail.
    is_held : bool, shape (n_cells,)
        Cells of bonds that may not fail, around these.
    can_turn : bool, shape (n_cells,)
        Cells that could be turned.
    too_near : bool, shape (n_cells,)
        Cells with one within the reach that could be turned and is not.
    at_the_end : bool, shape (n_cells,)
        Cells with one within the reach that can never be turned.
    around : Subdomain
        The share with points in every cell: free ones where its points are free, others that follow nodes.
    left : int
        Cells of the body that could still be turned.
    before : Unturned or None
        What does not hang on which cells are turned, where it is kept.
    """

    turned: np.ndarray
    is_turned: np.ndarray
    is_held: np.ndarray
    can_turn: np.ndarray
    too_near: np.ndarray
    at_the_end: np.ndarray
    around: Subdomain
    left: int
    before: Unturned | None = None

    def part(self, mesh: MeshPart, places: Subdomain) -> FoundRegion:
        """The rows of a part of the mesh, and its places."""
        here = mesh.cell_id
        names = ("is_turned", "is_held", "can_turn", "too_near", "at_the_end")
        return replace(self, around=places, **{name: getattr(self, name)[here] for name in names})


@dataclass(frozen=True)
class WholeRegion:
    """The body with its bonds, and all of what `FoundRegion` has rows of."""

    whole: Discretization
    rows: FoundRegion


def turn(
    scene: Scene,
    elements: Discretization,
    turning: Turning | None,
    ranks: int = 1,
    before: Unturned | None = None,
) -> WholeRegion:
    """Turn cells of a body that has elements everywhere.

    Parameters
    ----------
    turning : Turning or None
        None: no cell.
    ranks : int
        That have a share of it.
    before : Unturned, optional
        What was kept of the same body.

    Raises
    ------
    SceneError
        No cell can be turned, or bonds leave no element outside.
    """
    mesh, settings = elements.mesh, scene.adaptive
    reach = settings.reach * elements.units.length
    can_turn = before.can_turn if before else _can_turn(scene, elements)
    if not can_turn.any():
        raise SceneError([
            'regions with model = "auto" have no cell that could be turned into bonds: all are held or loaded, or '
            f"within adaptive.buffer_layers = {settings.buffer_layers} of such cells or of elements that stay. Use a "
            "finer mesh, or hold and load less."
        ])  # fmt: skip
    if before is None and (ranks == 1 or len(can_turn) <= FEW_CELLS):
        before = Unturned(elements, can_turn, _within(mesh.centroids, ~can_turn, reach))
    is_turned = np.zeros(len(mesh.cells), bool)
    if turning is not None:
        is_turned[turning.turned] = True
        is_turned |= can_turn & _chosen(scene, elements, turning)
    bonds = is_turned
    for _ in range(settings.buffer_layers if is_turned.any() else 0):
        bonds = mesh.neighbours(bonds)
    materials = elements.materials, elements.material
    whole = replace(elements, **describe(scene, mesh, elements.quality, elements.region, bonds, materials))
    rows = FoundRegion(
        turned=np.flatnonzero(is_turned),
        is_turned=is_turned,
        is_held=bonds & ~is_turned,
        can_turn=can_turn,
        too_near=_within(mesh.centroids, can_turn & ~is_turned, reach),
        at_the_end=before.at_the_end if before else _within(mesh.centroids, ~can_turn, reach),
        around=_NO_SUBDOMAIN,
        left=int(np.count_nonzero(can_turn & ~is_turned)),
        before=before,
    )
    return WholeRegion(whole, rows)


def cut_around(whole: Discretization, owner: np.ndarray, rank: int) -> Subdomain:
    """The share of one rank with points in every cell, by numbers in the mesh."""
    free = whole.has_points & ~whole.is_overlap
    none = np.zeros(len(free), bool)
    return cut_out(replace(whole, has_points=~none, is_overlap=~free, has_stiffness=none), owner, rank)


_NONE = np.empty(0, np.int64)
_NO_SUBDOMAIN = Subdomain(*[_NONE] * 10)


def _chosen(scene: Scene, elements: Discretization, turning: Turning) -> np.ndarray:
    """Cells near what the turning names; bool, shape (n_cells,)."""
    mesh, length = elements.mesh, elements.units.length
    seeds = np.zeros(len(mesh.cells), bool)
    seeds[turning.near_cells] = True
    found = _within(mesh.centroids, seeds, turning.radius * length)
    if turning.cracks:
        cracked = near_cracks(scene, mesh, elements.cutoff * length)
        found |= _within(mesh.centroids, cracked, scene.adaptive.reach * length)
    if turning.near_places is not None and len(turning.near_places):
        found |= _are_near(turning.near_places, mesh.centroids, turning.place_radius)
    return found


def _within(centroids: np.ndarray, chosen: np.ndarray, radius: float) -> np.ndarray:
    """Cells whose centroid is within a radius of that of a chosen one; bool, shape (n_cells,)."""
    if not chosen.any() or chosen.all():
        return chosen.copy()
    found, others = chosen.copy(), np.flatnonzero(~chosen)
    found[others] = _are_near(centroids[chosen], centroids[others], radius)
    return found


def _are_near(places: np.ndarray, x: np.ndarray, radius: float) -> np.ndarray:
    """Which of other places, (n, 3), are within a radius of some; bool, shape (n,)."""
    return np.isfinite(NearPlaces(places, radius * (1.0 + DISTANCE_TOLERANCE)).distances(x))


def _can_turn(scene: Scene, elements: Discretization) -> np.ndarray:
    """Cells that could be described by bonds that may fail; bool, shape (n_cells,).

    Not those that the deck says stay, nor cells so coarse that a point would not reach the next, nor what is held or
    loaded: that stays elements, with room for the layers of bonds that may not fail and for the overlap.
    """
    mesh = elements.mesh
    stays = np.array([r.model != "auto" or r.always_elements or r.may_fail is False for r in scene.regions])
    stays = stays[elements.region] | (mesh.edges().max(axis=0) > elements.cutoff * elements.units.length)
    used = _used_cells(scene, elements)
    for _ in range(scene.coupling.overlap):
        used = mesh.neighbours(used) if used.any() else used
    stays |= used
    for _ in range(scene.adaptive.buffer_layers):
        stays = mesh.neighbours(stays) if stays.any() else stays
    return ~stays


def _used_cells(scene: Scene, elements: Discretization) -> np.ndarray:
    """Cells at which supports, springs, ties and loads act; bool, (n_cells,). Forces on volumes act on both kinds."""
    found = select_places(scene, elements)
    used = np.zeros(len(elements.mesh.cells), bool)
    nodes = np.zeros(len(elements.mesh.nodes), bool)
    entries = *scene.loads, *scene.supports, *scene.springs, *scene.ties
    for entry, chosen in zip(entries, (*found.loads, *found.supports, *found.springs, *found.ties), strict=True):
        if chosen is None or isinstance(entry, BodyForce):
            continue
        if isinstance(chosen, ChosenFaces):
            used[chosen.cells] = True
            continue
        nodes[chosen.nodes] = True
        used[chosen.points[:, 0]] = True
        if not isinstance(chosen, ChosenSpots):
            used[chosen.cells] = True
    return used | nodes[elements.mesh.cells].any(axis=1)
