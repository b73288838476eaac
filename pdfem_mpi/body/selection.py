"""The places of the body that the loads, the supports and the probes of a deck speak of."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from pdfem_mpi.body.discretization import Discretization
from pdfem_mpi.body.narrow_places import NO_POINTS, is_narrow, select_narrow, spread
from pdfem_mpi.deck.loads import Force, Pressure, Traction
from pdfem_mpi.deck.mechanical_probes import SetProbe
from pdfem_mpi.deck.restraints import Spring
from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.deck.table import SceneError
from pdfem_mpi.mesh import named_sets
from pdfem_mpi.mesh.hexmesh import FACES, HexMesh
from pdfem_mpi.mesh.layers import cells_near_face
from pdfem_mpi.mesh.part import MeshPart


@dataclass(frozen=True)
class ChosenFaces:
    """Faces that a traction pulls at.

    Attributes
    ----------
    cells : int64, shape (n_faces,)
    nodes : int, shape (n_faces, 4)
    total, on_points, on_free_points, on_mirrors : int
        Faces on all ranks: all of them, those of cells with points and with free points, those on mirror planes.
    """

    cells: np.ndarray
    nodes: np.ndarray
    total: int
    on_points: int
    on_free_points: int
    on_mirrors: int

    def part(self, mesh: MeshPart) -> ChosenFaces:
        """Those of the cells of a part of the mesh, by the places there."""
        here = np.isin(self.cells, mesh.cell_id)
        cells, nodes = mesh.places_of_cells(self.cells[here]), mesh.places_of_nodes(self.nodes[here])
        return replace(self, cells=cells, nodes=nodes)


@dataclass(frozen=True)
class ChosenPlaces:
    """Cells that a body force or support speaks of, and the nodes with unknowns that a support does; int64, rising.

    Of some cells a support speaks of single points: rows of cell and Gauss point, int64, shape (n, 2).
    """

    cells: np.ndarray
    nodes: np.ndarray
    points: np.ndarray = field(default_factory=NO_POINTS.copy)

    def part(self, mesh: MeshPart) -> ChosenPlaces:
        """Those of a part of the mesh, by the places there."""
        cells, nodes = (
            own[np.isin(own, here, assume_unique=True)]
            for own, here in ((self.cells, mesh.cell_id), (self.nodes, mesh.node_id))
        )
        points = self.points[np.isin(self.points[:, 0], mesh.cell_id)]
        points = np.column_stack([mesh.places_of_cells(points[:, 0]), points[:, 1]])
        return ChosenPlaces(mesh.places_of_cells(cells), mesh.places_of_nodes(nodes), points)


@dataclass(frozen=True)
class ChosenSpots:
    """Nodes with unknowns, int64, rising, and rows of cell and Gauss point, int64, (n, 2), with their parts of a force.

    The parts of all, on all ranks, sum to 1.
    """

    nodes: np.ndarray
    node_parts: np.ndarray
    points: np.ndarray
    point_parts: np.ndarray

    def part(self, mesh: MeshPart) -> ChosenSpots:
        """Those of a part of the mesh, by the places there."""
        here, there = np.isin(self.nodes, mesh.node_id), np.isin(self.points[:, 0], mesh.cell_id)
        points = self.points[there]
        points = np.column_stack([mesh.places_of_cells(points[:, 0]), points[:, 1]])
        nodes = mesh.places_of_nodes(self.nodes[here])
        return ChosenSpots(nodes, self.node_parts[here], points, self.point_parts[there])


@dataclass(frozen=True)
class Selections:
    """What each load and each support of the deck speaks of, and what is wrong with it.

    Attributes
    ----------
    loads : tuple of ChosenFaces, ChosenPlaces or ChosenSpots, or None where nothing could be chosen
    supports, probes, ties : tuple of ChosenPlaces, or None
    springs : tuple of ChosenFaces or ChosenSpots, or None
    problems : dict of tuples of tuples of str
        Of each table, by the names of the fields above.
    """

    loads: tuple[ChosenFaces | ChosenPlaces | ChosenSpots | None, ...] = ()
    supports: tuple[ChosenPlaces | None, ...] = ()
    probes: tuple[ChosenPlaces | None, ...] = ()
    springs: tuple[ChosenFaces | ChosenSpots | None, ...] = ()
    ties: tuple[ChosenPlaces | None, ...] = ()
    problems: dict[str, tuple[tuple[str, ...], ...]] = field(default_factory=dict)

    def part(self, mesh: MeshPart) -> Selections:
        """The same on a part of the mesh, by the places there."""
        parts = {kind: tuple(chosen and chosen.part(mesh) for chosen in getattr(self, kind)) for kind in self.problems}
        return replace(self, **parts)


def select_places(scene: Scene, discretization: Discretization) -> Selections:
    """Find what the loads, the supports, springs and ties and the probes of sets of the deck speak of.

    Cells and nodes are numbers in the whole mesh. Collective, if the mesh is a part.

    Raises
    ------
    SeenInPart
        Something is wrong with a selection, and the mesh is a part.
    """
    names = [region.name for region in scene.regions]
    entries_of = {
        "loads": scene.loads,
        "supports": scene.supports,
        "probes": [probe if isinstance(probe, SetProbe) else None for probe in scene.probes],
        "springs": [spring.pull(1.0) or spring for spring in scene.springs],
        "ties": scene.ties,
    }
    found: dict[str, list] = {kind: [] for kind in entries_of}
    problems: dict[str, list] = {kind: [] for kind in entries_of}
    for kind, entries in entries_of.items():
        for index, entry in enumerate(entries):
            chosen, messages = None, ()
            try:
                if isinstance(entry, Traction | Pressure):
                    chosen = _select_faces(discretization, entry, f"{kind}.{index}")
                elif isinstance(entry, Force | Spring):
                    chosen = ChosenSpots(*spread(discretization, entry, f"{kind}.{index}"))
                elif is_narrow(entry):
                    nodes, points = select_narrow(discretization, entry, f"{kind}.{index}")
                    chosen = ChosenPlaces(np.empty(0, np.int64), nodes, points)
                elif entry is not None:
                    cells = _select_cells(discretization, entry, f"{kind}.{index}", names)
                    nodes = np.zeros(len(discretization.mesh.nodes), bool)
                    if kind in ("supports", "ties"):
                        nodes, messages = _select_nodes(discretization, entry, f"{kind}.{index}", cells)
                    mesh = discretization.mesh
                    chosen = ChosenPlaces(mesh.cell_id[cells], mesh.node_id[nodes])
            except SceneError as error:
                messages = error.messages
            found[kind].append(chosen)
            problems[kind].append(tuple(messages))
    wrong = {kind: tuple(messages) for kind, messages in problems.items()}
    return Selections(**{kind: tuple(chosen) for kind, chosen in found.items()}, problems=wrong)


def _select_cells(discretization: Discretization, entry, where: str, names: list[str]) -> np.ndarray:
    """Cells a load or support speaks of; bool, shape (n_cells,)."""
    mesh = discretization.mesh
    if entry.region is not None:
        chosen = discretization.region == names.index(entry.region)
    elif entry.face is not None:
        chosen = cells_near_face(mesh, entry.face, entry.layers)
    elif entry.set is not None:
        chosen = named_sets.cells_of(mesh, entry, where)
    else:
        chosen = mesh.cells_in_box(entry.lower, entry.upper)
    if entry.set is None and mesh.everywhere.lacks(chosen):
        raise SceneError(
            [f"{where} selects no cell of the mesh, whose cells are {mesh.largest_edge:.6g} wide. Widen its box."]
        )
    return chosen


def _select_faces(discretization: Discretization, load: Traction | Pressure, where: str) -> ChosenFaces:
    """Faces a traction or pressure speaks of."""
    mesh = discretization.mesh
    if load.set is not None:
        cells, faces = named_sets.faces_of(mesh, load, where)
    elif load.face is not None:
        cells, faces = mesh.faces_on_face(load.face)
    else:
        cells, faces = _faces_in_box(mesh, load, where)
    has_points = discretization.has_points[cells]
    of_points = has_points & ~discretization.is_overlap[cells]
    corners = discretization.nodes[faces]
    tolerance = mesh.tolerance / discretization.units.length
    flat = np.ptp(corners, axis=1) <= tolerance
    on_planes = discretization.mirrors.normal_components(corners.reshape(-1, 3), tolerance).reshape(corners.shape)
    mirrored = (flat & on_planes.all(axis=1)).any(axis=1)
    own = mesh.everywhere.of_own(cells)
    counts = mesh.everywhere.total(*(np.count_nonzero(own & kind) for kind in (own, has_points, of_points, mirrored)))
    return ChosenFaces(mesh.cell_id[cells], mesh.node_id[faces], *counts)


def _faces_in_box(mesh: HexMesh, load: Traction | Pressure, where: str) -> tuple[np.ndarray, np.ndarray]:
    """Faces of the boundary whose middle lies in a closed box: their cells and nodes.

    Raises
    ------
    SceneError
        There is none.
    """
    cells, sides = mesh.boundary
    faces = mesh.cells[cells[:, None], FACES[sides]]
    middles = mesh.nodes[faces].mean(axis=1)
    inside = np.ones(len(faces), bool)
    for corner, sign in ((load.lower, 1.0), (load.upper, -1.0)):
        if corner is not None:
            inside &= (sign * (middles - np.array(corner)) >= -mesh.tolerance).all(axis=1)
    everywhere = mesh.everywhere
    if everywhere.refused(everywhere.total(np.count_nonzero(inside & everywhere.of_own(cells)))[0] == 0):
        raise SceneError(
            [f"{where} selects no face of the boundary: its box holds the middle of none. Widen it, or move it."]
        )
    return cells[inside], faces[inside]


def _select_nodes(discretization: Discretization, support, where: str, cells: np.ndarray):
    """Nodes of elements that a support holds, bool, (n_nodes,), and what its set holds where nothing can be."""
    mesh = discretization.mesh
    if support.set is None:
        nodes = np.zeros(len(mesh.nodes), bool)
        nodes[mesh.cells[cells & discretization.has_nodes]] = True
        if support.face is not None:
            nodes &= mesh.nodes_on_face(support.face)
        return nodes, ()
    wanted = named_sets.nodes_of(mesh, support, where)
    chosen = wanted & discretization.carries
    wanted[mesh.cells[cells]] = False
    stray = np.flatnonzero(wanted & ~chosen)
    if not len(stray):
        return chosen, ()
    place = ", ".join(f"{c:.6g}" for c in mesh.nodes[stray[0]])
    return chosen, (
        f"{where}.set = {support.set} has {len(stray)} nodes of peridynamic cells that make up no face of one, the "
        f"first at ({place}): peridynamic points are held beneath faces or in cells. Use such a set.",
    )
