"""From the scene and its mesh to collocation points, finite elements and their overlap, in model units.

The discretization is global and the same on every rank: about 150 bytes a cell, against 20,000 bytes of bonds of a
peridynamic cell. What a rank keeps of it is cut out in ``model.py``.

**Model units.** Lengths are in units of the internal length ``l`` (without peridynamics: of the mean edge), measured
from the centre of the bounding box, stresses in units of the default material's Young's modulus. Numbers stored in
single precision then do not depend on the deck's units, and a body far from the origin loses nothing after this
subtraction.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pdfem_mpi.body.fitted_bodies import find_fitted_bodies, same_bonds
from pdfem_mpi.body.materials import MaterialTable, material_table
from pdfem_mpi.deck.materials import PERIDYNAMIC_POISSONS_RATIO
from pdfem_mpi.deck.meshes import FileMesh, PlateWithHoleMesh
from pdfem_mpi.deck.peridynamics import cutoff_problems
from pdfem_mpi.deck.regions import Region
from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.deck.table import SceneError, show
from pdfem_mpi.kernels.families import CUTOFF_GUARD
from pdfem_mpi.kernels.hex8 import GAUSS_POINTS, gauss_positions
from pdfem_mpi.mesh import generators, named_sets
from pdfem_mpi.mesh.crossings import cross_polygon
from pdfem_mpi.mesh.defects import face_problems, find_defects, mirror_problems
from pdfem_mpi.mesh.faces import match_faces
from pdfem_mpi.mesh.hexmesh import HexMesh
from pdfem_mpi.mesh.mirrors import Mirrors, mirrors_at
from pdfem_mpi.mesh.quality import Quality, folded_cells, measure
from pdfem_mpi.mesh.reader import read_mesh

#: A spacing of a deck may lie outside of the edges of the file's cells by this fraction.
SPACING_MISFIT = 1e-3

#: Pairs of the eight points of a cell that differ in one coordinate.
_POINT_EDGES = np.array([(a, b) for a in range(8) for b in range(a) if (GAUSS_POINTS[a] != GAUSS_POINTS[b]).sum() == 1])


@dataclass(frozen=True)
class ModelUnits:
    """One model unit of length and of stress, in the deck's units, and the deck's position of the model's origin."""

    length: float
    stress: float
    origin: np.ndarray

    @property
    def force(self) -> float:
        """One model unit of force, in the deck's."""
        return self.stress * self.length**2


@dataclass(frozen=True)
class Discretization:
    """What each cell of the mesh carries.

    Attributes
    ----------
    mesh : HexMesh
        In the deck's units.
    quality : Quality
    units : ModelUnits
    nodes : float64, shape (n_nodes, 3)
        Node positions in model units.
    region : int16, shape (n_cells,)
        Index of the deck's region.
    material : int16, shape (n_cells,)
        Index of the cell's material; 0 is the default.
    materials : MaterialTable
    is_peridynamic : bool, shape (n_cells,)
        Cells of peridynamic regions.
    has_points : bool, shape (n_cells,)
        Cells with collocation points: peridynamic cells and the overlap.
    is_overlap : bool, shape (n_cells,)
        Cells with points whose displacements are interpolated from nodes (eq. 25); peridynamic ones join fitted bodies.
    body : int32, shape (n_cells,)
        Body of each cell with points, no bonds between two bodies (see `fitted_bodies`); -1 for other cells.
    thin : int64, shape (n_thin,)
        Cells at which a body whose factors should be fitted is too thin for it.
    has_stiffness : bool, shape (n_cells,)
        Cells whose element has an internal force (eqs 15, 16).
    point_cell_number : int64, shape (n_cells,)
        Number of a cell among the cells with points, else -1; its points are ``8 number + g``.
    node_number : int64, shape (n_nodes,)
        Number of a node among the nodes of elements and overlap, else -1.
    cutoff : float
        Guarded cutoff radius in model units; 0 without peridynamics.
    mirrors : Mirrors
        Mirror planes in model units.
    """

    mesh: HexMesh
    quality: Quality
    units: ModelUnits
    nodes: np.ndarray
    region: np.ndarray
    material: np.ndarray
    materials: MaterialTable
    is_peridynamic: np.ndarray
    has_points: np.ndarray
    is_overlap: np.ndarray
    body: np.ndarray
    thin: np.ndarray
    has_stiffness: np.ndarray
    point_cell_number: np.ndarray
    node_number: np.ndarray
    cutoff: float
    mirrors: Mirrors

    @property
    def n_point_cells(self) -> int:
        """Number of cells with points."""
        return int(np.count_nonzero(self.has_points))

    @property
    def n_bodies(self) -> int:
        """Number of bodies between which there are no bonds; 0 without peridynamics."""
        return int(self.body.max(initial=-1)) + 1

    @property
    def n_nodes(self) -> int:
        """Number of nodes that carry unknowns."""
        return int(np.count_nonzero(self.node_number >= 0))

    @property
    def youngs_modulus(self) -> np.ndarray:
        """Young's modulus of each cell in model units; float64, shape (n_cells,)."""
        return self.materials.youngs_modulus[self.material]

    @property
    def poissons_ratio(self) -> np.ndarray:
        """Poisson's ratio of each cell; float64, shape (n_cells,)."""
        return self.materials.poissons_ratio[self.material]

    @property
    def plane_components(self) -> np.ndarray:
        """Displacement components of nodes that mirror planes hold; bool, shape (n_nodes, 3)."""
        return self.mirrors.normal_components(self.nodes, self.mesh.tolerance / self.units.length)

    @cached_property
    def reflections(self) -> tuple[np.ndarray, np.ndarray]:
        """Signs and shifts, both (n, 3), of reflections that bring an image within the cutoff radius of the body."""
        body = np.array([self.nodes.min(axis=0), self.nodes.max(axis=0)])
        reach = self.cutoff + 2.0 * self.mesh.largest_edge / self.units.length  # and the size of cells
        return self.mirrors.reflections(body, body + np.array([[-reach], [reach]]))

    @property
    def notes(self) -> tuple[str, ...]:
        """What a user should know of the mesh: what the reader left out, and cells that elements just live on."""
        if self.quality.smallest_scaled_jacobian > 0.0:
            return self.mesh.notes
        folded = np.zeros(len(self.mesh.cells), bool)
        folded[folded_cells(self.mesh)] = True
        return (*self.mesh.notes, f"warning: {_describe_folded(self.mesh, folded)}: results near them are poor.")

    @property
    def has_nodes(self) -> np.ndarray:
        """Cells with nodes that carry unknowns: elements and overlap; bool, shape (n_cells,)."""
        return self.has_stiffness | self.is_overlap


def make_mesh(scene: Scene) -> HexMesh:
    """The mesh a deck asks for; one from a file is looked at as a whole, with what the deck says of it.

    Raises
    ------
    SceneError
        A file that cannot be read, or all that is wrong with its cells, its nodes, and the sets that the deck names.
    """
    entry = scene.mesh
    if isinstance(entry, PlateWithHoleMesh):
        return generators.plate_with_hole(entry.lower, entry.upper, entry.hole_radius, entry.spacing, entry.symmetry)
    if not isinstance(entry, FileMesh):
        return generators.box(entry.lower, entry.upper, entry.n_cells)
    mesh, node_number = read_mesh(entry)
    messages = find_defects(mesh, node_number) + _spacing_problems(scene, mesh)
    for face in entry.symmetry:
        messages += mirror_problems(mesh, face)
    for table, entries in (("loads", scene.loads), ("supports", scene.supports)):
        for index, item in enumerate(entries):
            if item.set is not None:
                messages += named_sets.find_problems(mesh, item, f"{table}.{index}")
            elif item.face is not None:
                messages += face_problems(mesh, item.face, f"{table}.{index}")
    try:
        _assign_regions(scene, mesh)
    except SceneError as error:
        messages += error.messages
    if messages:
        raise SceneError(messages)
    return mesh


def _spacing_problems(scene: Scene, mesh: HexMesh) -> list[str]:
    """A spacing that is not the cells', and what ``scene.CHECKS`` say of one that the deck leaves to the cells."""
    edge = scene.mesh.spacing
    if edge is None:
        if not scene.has_peridynamics:
            return []
        problems = cutoff_problems(scene.peridynamics, mesh.average_edge, "the mean edge of the cells")
        return [f"{problem.key} {problem.text}" for problem in problems]
    if mesh.smallest_edge * (1.0 - SPACING_MISFIT) <= edge <= mesh.largest_edge * (1.0 + SPACING_MISFIT):
        return []
    return [
        f"mesh.spacing = {show(edge)} is not between the shortest and the longest edge of the cells, "
        f"{mesh.smallest_edge:.6g} and {mesh.largest_edge:.6g}. Leave it out, or correct it or mesh.scale."
    ]


def discretize(scene: Scene, mesh: HexMesh | None = None) -> Discretization:
    """Decide what every cell of the scene's mesh carries.

    Parameters
    ----------
    mesh : HexMesh, optional
        What `make_mesh` gave; made here, if not given.

    Raises
    ------
    SceneError
        Cells inside out, regions that overlap or leave cells out, an empty region, an overlap that does not fit or
        whose material cannot have bonds, bodies that cannot be fitted.
    """
    mesh = make_mesh(scene) if mesh is None else mesh
    quality = measure(mesh)
    region = _assign_regions(scene, mesh)
    peridynamic = np.array([r.model == "peridynamics" for r in scene.regions])[region]
    materials = material_table(scene)
    material = np.array([materials.names.index(r.material) for r in scene.regions], np.int16)[region]
    body = thin = None
    if scene.peridynamics.surface_correction == "fitted" and peridynamic.any():
        kind = same_bonds(materials)[material]
        is_overlap = _find_overlap(scene, mesh, peridynamic, ~np.isin(kind, kind[peridynamic]))
        found = find_fitted_bodies(mesh, peridynamic, is_overlap, kind)
        thin = found.thin
        if not len(thin):
            body, is_overlap = found.number, found.is_overlap
            _check_joints(scene, materials, material, body)
            _check_cracks(scene, mesh, peridynamic & is_overlap)
    if body is None:
        is_overlap = _find_overlap(scene, mesh, peridynamic)
        body = np.where(peridynamic | is_overlap, 0, -1).astype(np.int32)
    has_points = body >= 0
    _check_folded(mesh, quality, has_points)
    cannot_bond = materials.poissons_ratio != PERIDYNAMIC_POISSONS_RATIO
    _check_overlap_materials(scene, mesh, region, is_overlap & cannot_bond[material])
    keeps_both = scene.coupling.kind == "paper_a"
    has_stiffness = ~peridynamic & (keeps_both | ~is_overlap)

    if has_points.any():
        length, cutoff_radius = scene.peridynamics.lengths(_cell_edge(scene, mesh))
        cutoff = cutoff_radius / length * (1.0 + CUTOFF_GUARD)
    else:
        length, cutoff = mesh.mean_edge, 0.0
    units = ModelUnits(length, scene.material.youngs_modulus, 0.5 * (mesh.lower + mesh.upper))

    carries = np.zeros(len(mesh.nodes), bool)
    carries[mesh.cells[has_stiffness | is_overlap]] = True
    return Discretization(
        mesh=mesh,
        quality=quality,
        units=units,
        nodes=(mesh.nodes - units.origin) / length,
        region=region,
        material=material,
        materials=materials,
        is_peridynamic=peridynamic,
        has_points=has_points,
        is_overlap=is_overlap,
        body=body,
        thin=np.empty(0, np.int64) if thin is None else thin,
        has_stiffness=has_stiffness,
        point_cell_number=_number(has_points),
        node_number=_number(carries),
        cutoff=cutoff,
        mirrors=mirrors_at(scene.mesh.symmetry, *(np.array([mesh.lower, mesh.upper]) - units.origin) / length),
    )


def _cell_edge(scene: Scene, mesh: HexMesh) -> float:
    """The paper's Delta: graded cells of a plate are "approximately" as wide as its spacing (sec. 4.2)."""
    if isinstance(scene.mesh, FileMesh):
        return mesh.average_edge if scene.mesh.spacing is None else scene.mesh.spacing
    return scene.mesh.spacing if isinstance(scene.mesh, PlateWithHoleMesh) else mesh.largest_edge


def _number(chosen: np.ndarray) -> np.ndarray:
    return np.where(chosen, np.cumsum(chosen) - 1, -1)


def _assign_regions(scene: Scene, mesh: HexMesh) -> np.ndarray:
    region = np.full(len(mesh.cells), -1, np.int16)
    messages, unknown = [], False
    round_ones = np.zeros(len(mesh.cells), bool)
    for entry in scene.regions:
        if entry.radius is not None:
            round_ones |= _inside(mesh, entry)
    for index, entry in enumerate(scene.regions):
        if entry.set is None:
            inside = _inside(mesh, entry)
        else:
            where = f"regions.{entry.name}.set"
            try:
                named_sets.kind_of(mesh, entry.set, "regions", where)
            except SceneError as error:
                messages += error.messages
                unknown = True
                continue
            inside = named_sets.cells(mesh, entry.set)
        if not inside.any():
            shape = "box misses" if entry.radius is None else "ball or cylinder misses"
            keys = "lower or upper" if entry.radius is None else "centre or radius"
            messages.append(
                f"regions.{entry.name} contains no cell: its {shape} all centroids of the mesh, which lie in "
                f"{_span(mesh.centroids)}. Correct {keys}, or remove the region."
            )
        elif entry.radius is None:
            inside &= ~round_ones
            if not inside.any():
                messages.append(
                    f"regions.{entry.name} contains no cell: regions with a radius take all of its box. "
                    "Remove the region, or make them smaller."
                )
        twice = inside & (region >= 0)
        if twice.any():
            other = scene.regions[region[np.flatnonzero(twice)[0]]].name
            messages.append(
                f"regions.{entry.name} overlaps regions.{other} in {np.count_nonzero(twice)} cells, the first "
                f"{_places(mesh, twice)}. Give each cell to one region."
            )
        region[inside & (region < 0)] = index
    left = region < 0
    if left.any() and not unknown:
        messages.append(
            f"regions leave out {np.count_nonzero(left)} of {len(region)} cells, the first {_places(mesh, left)}. "
            "Extend a region, or add one."
        )
    if messages:
        raise SceneError(messages)
    return region


def _inside(mesh: HexMesh, entry: Region) -> np.ndarray:
    """Cells whose centroid lies in the region's box and, where it has a radius, in its ball or cylinder."""
    inside = mesh.cells_in_box(entry.lower, entry.upper)
    if entry.radius is not None:
        across = [d for d in range(3) if "xyz"[d] != entry.axis]
        offset = (mesh.centroids - np.array(entry.centre))[:, across]
        inside &= np.sqrt((offset**2).sum(axis=1)) <= entry.radius + mesh.tolerance
    return inside


def _describe_folded(mesh: HexMesh, folded: np.ndarray) -> str:
    return (
        f"mesh has {np.count_nonzero(folded)} cells that are folded at a corner (its Jacobian is not positive, those "
        "of the "
        f"Gauss points are), the first {_places(mesh, folded)}"
    )


def _check_folded(mesh: HexMesh, quality: Quality, has_points: np.ndarray) -> None:
    """Refuse bonds in cells that are folded at a corner; elements take them."""
    if quality.smallest_scaled_jacobian > 0.0:
        return
    folded = np.zeros(len(mesh.cells), bool)
    folded[folded_cells(mesh)] = True
    folded &= has_points
    if folded.any():
        raise SceneError(
            [
                f"{_describe_folded(mesh, folded)}, in peridynamics or the overlap, where points would have bonds. "
                "Correct "
                "the places of their nodes, or give them to finite elements."
            ]
        )


def _check_overlap_materials(scene: Scene, mesh: HexMesh, region: np.ndarray, wrong: np.ndarray) -> None:
    """Refuse cells of the overlap whose material cannot have bonds."""
    messages = []
    for index in np.unique(region[wrong]):
        entry = scene.regions[index]
        cells = wrong & (region == index)
        messages.append(
            f"regions.{entry.name}.material has another Poisson's ratio than 1/4, and {np.count_nonzero(cells)} of its "
            f"cells are in the overlap, where points share bonds, the first {_places(mesh, cells)}. Put a region of "
            f"finite elements with Poisson's ratio 0.25, at least coupling.overlap = {scene.coupling.overlap} cells "
            "deep, between it and peridynamics."
        )
    if messages:
        raise SceneError(messages)


def _check_joints(scene: Scene, materials: MaterialTable, material: np.ndarray, body: np.ndarray) -> None:
    """Refuse what bonds between fitted bodies would be needed for: there are none."""
    if not body.max() > 0:
        return
    names = " and ".join(materials.names[k] for k in np.unique(material[body >= 0]))
    why = (
        f'peridynamics.surface_correction = "fitted" joins the bodies of {names}, whose bonds differ in stiffness, by '
        "common nodes: no bond runs between them"
    )
    messages = [
        f"interfaces.{index} is of bonds between {' and '.join(interface.between)}, and {why}. Remove it, or use "
        '"virial".'
        for index, interface in enumerate(scene.interfaces)
        if len({same_bonds(materials)[materials.names.index(name)] for name in interface.between}) > 1
    ]
    if any(entry.can_fail for entry in (scene.material, *scene.materials.values(), *scene.interfaces)):
        messages.append(f'{why}, so that interfaces could not break. Use "virial" where bonds may break.')
    if messages:
        raise SceneError(messages)


def _check_cracks(scene: Scene, mesh: HexMesh, joints: np.ndarray) -> None:
    """Refuse cracks through the cells of joints: no cut of bonds parts points that follow common nodes."""
    messages = [
        f"cracks.{index}.polygon passes through {np.count_nonzero(hit)} cells by which "
        'peridynamics.surface_correction = "fitted" joins bonds to others, or to elements, of another '
        f"stiffness, the first {_places(mesh, hit)}: their points follow common nodes, which no crack parts. "
        'End it a cell before the interface, or use "virial".'
        for index, hit in _cracked(scene, mesh, joints)
    ]
    if messages:
        raise SceneError(messages)


def describe_cracked_overlap(scene: Scene, discretization: Discretization) -> list[str]:
    """Sentences about cracks through the overlap, which cut bonds and part nothing."""
    mesh = discretization.mesh
    return [
        f"warning: cracks.{index} passes through {np.count_nonzero(hit)} cells of the overlap, the first "
        f"{_places(mesh, hit)}: their points follow element nodes, so that it cuts bonds there and does not open. End "
        "it at the interface."
        for index, hit in _cracked(scene, mesh, discretization.is_overlap)
    ]


def _cracked(scene: Scene, mesh: HexMesh, following: np.ndarray) -> Iterator[tuple[int, np.ndarray]]:
    """Cracks through cells whose points follow nodes: their number, and the cells; bool, shape (n_cells,)."""
    for index, crack in enumerate(scene.cracks):
        corners = np.array(crack.polygon)
        margin = mesh.largest_edge
        near = following & mesh.cells_in_box(corners.min(axis=0) - margin, corners.max(axis=0) + margin)
        if not near.any():
            continue
        cells, faces = np.flatnonzero(near), match_faces(mesh, near)
        points = gauss_positions(mesh.nodes[mesh.cells[cells]])
        one, two = (np.repeat(k, len(cells)) for k in _POINT_EDGES.T)
        hit = np.zeros(len(following), bool)
        place = np.tile(np.arange(len(cells)), len(_POINT_EDGES))
        hit[cells[place[cross_polygon(crack.polygon, points[place, one], points[place, two])]]] = True
        ends = np.stack([cells[faces.one // 6], cells[faces.two // 6]], axis=1)
        reach = GAUSS_POINTS.max() / 2.0 * np.diff(mesh.centroids[ends], axis=1)[:, 0]
        start, stop = mesh.centroids[ends[:, 0]] + reach, mesh.centroids[ends[:, 1]] - reach
        hit[ends[cross_polygon(crack.polygon, start, stop)]] = True
        if hit.any():
            yield index, hit


def _find_overlap(scene: Scene, mesh: HexMesh, peridynamic: np.ndarray, stays: np.ndarray | bool = False) -> np.ndarray:
    """Layers of cells on the finite-element side of the interface, some of which stay elements all the same."""
    if peridynamic.all() or not peridynamic.any():
        return np.zeros(len(peridynamic), bool)
    reached = peridynamic
    for layer in range(1, scene.coupling.overlap + 1):
        wider = mesh.neighbours(reached)
        if layer == 1 and not (wider & ~reached).any():
            raise SceneError(
                ["regions: the peridynamic and the finite-element cells share no node. Let them touch."]
            )
        if not (stays | ~wider).any() or not (stays | (wider & ~reached)).any():
            deep = f"{layer} layer{'s' if layer > 1 else ''} deep"
            remedy = f"Use at most {layer - 1}, or enlarge them" if layer > 1 else "Enlarge them"
            raise SceneError(
                [
                    f"coupling.overlap = {scene.coupling.overlap} leaves no finite element outside the overlap: the "
                    f"finite-element regions are {deep}, seen from the interface. {remedy}."
                ]
            )
        if np.array_equal(wider, reached):
            break
        reached = wider
    return reached & ~peridynamic


def _span(points: np.ndarray) -> str:
    low, high = points.min(axis=0), points.max(axis=0)
    return " x ".join(f"[{a:.6g}, {b:.6g}]" for a, b in zip(low, high, strict=True))


def _places(mesh: HexMesh, chosen: np.ndarray) -> str:
    """The first few chosen cells and where they are."""
    return ", ".join(
        f"{cell} at ({', '.join(f'{c:.6g}' for c in mesh.centroids[cell])})"
        for cell in np.flatnonzero(chosen)[:3]
    )
