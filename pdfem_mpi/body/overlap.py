"""The overlap of peridynamics and finite elements: its cells, and what they cannot be crossed or filled by."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from pdfem_mpi.body.fitted_bodies import same_bonds
from pdfem_mpi.body.materials import MaterialTable
from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.deck.table import SceneError
from pdfem_mpi.kernels.hex8 import GAUSS_POINTS, gauss_positions
from pdfem_mpi.mesh.crossings import cross_polygon
from pdfem_mpi.mesh.faces import match_faces
from pdfem_mpi.mesh.hexmesh import HexMesh, list_cells

if TYPE_CHECKING:
    from pdfem_mpi.body.discretization import Discretization

#: Pairs of the eight points of a cell that differ in one coordinate.
_POINT_EDGES = np.array([(a, b) for a in range(8) for b in range(a) if (GAUSS_POINTS[a] != GAUSS_POINTS[b]).sum() == 1])


def check_overlap_materials(
    scene: Scene, mesh: HexMesh, region: np.ndarray, nu: np.ndarray, is_overlap: np.ndarray, has_points: np.ndarray
) -> None:
    """Refuse cells of the overlap beside cells with bonds of another Poisson's ratio, ``nu`` of every cell."""
    wrong = np.zeros(len(nu), bool)
    for ratio in np.unique(nu[has_points]):
        wrong |= is_overlap & (nu != ratio) & mesh.neighbours(has_points & (nu == ratio))
    messages = []
    for index in np.unique(region[wrong]) if mesh.everywhere.wrong(wrong) else ():
        entry = scene.regions[index]
        cells = wrong & (region == index)
        ratio = nu[cells][0]
        beside = np.unique(nu[has_points & mesh.neighbours(cells)])
        others = ", ".join(f"{other:g}" for other in beside if other != ratio)
        messages.append(
            f"regions.{entry.name}.material has a Poisson's ratio of {ratio:g}, and {np.count_nonzero(cells)} of its "
            f"cells are in the overlap beside cells with bonds of {others}, the first {list_cells(mesh, cells)}: an "
            "overlap needs the same on both sides. Put a region of finite elements with the ratio of the bonds, at "
            f"least coupling.overlap = {scene.coupling.overlap} cells deep, between them."
        )
    if messages:
        raise SceneError(messages)


def check_joints(scene: Scene, materials: MaterialTable, material: np.ndarray, body: np.ndarray) -> None:
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


def check_cracks(scene: Scene, mesh: HexMesh, joints: np.ndarray) -> None:
    """Refuse cracks through the cells of joints: no cut of bonds parts points that follow common nodes."""
    messages = [
        f"cracks.{index} passes through {np.count_nonzero(hit)} cells by which "
        'peridynamics.surface_correction = "fitted" joins bonds to others, or to elements, of another '
        f"stiffness, the first {list_cells(mesh, hit)}: their points follow common nodes, which no crack parts. "
        'End it a cell before the interface, or use "virial".'
        for index, hit in _cracked(scene, mesh, joints)
        if hit.any()
    ]
    if messages:
        raise SceneError(messages)


def describe_cracked_overlap(scene: Scene, discretization: Discretization) -> list[str]:
    """Sentences about cracks through the overlap, which cut bonds and part nothing."""
    mesh = discretization.mesh
    notes = []
    for index, hit in _cracked(scene, mesh, discretization.is_overlap):
        if count := mesh.everywhere.count(hit)[0]:
            notes.append(
                f"warning: cracks.{index} passes through {count} cells of the overlap, the first "
                f"{list_cells(mesh, hit)}: their points follow element nodes, so that it cuts bonds there and does not "
                "open. End it at the interface."
            )
    return notes


def describe_cracked_elements(scene: Scene, discretization: Discretization, may_have_bonds: np.ndarray) -> list[str]:
    """Sentences about cracks through what must stay elements though a run finds its region.

    Parameters
    ----------
    may_have_bonds : bool, shape (n_cells,)
        Cells that could be described by bonds.
    """
    mesh = discretization.mesh
    notes = []
    for index, hit in _cracked(scene, mesh, ~may_have_bonds & ~discretization.is_overlap):
        if count := mesh.everywhere.count(hit)[0]:
            notes.append(
                f"warning: cracks.{index} passes through {count} cells that must stay elements, the first "
                f"{list_cells(mesh, hit)}: it parts nothing there. Supports, loads, regions of elements, "
                "always_elements and may_fail = false make cells stay: move them away, or end the crack before."
            )
    return notes


def _cracked(scene: Scene, mesh: HexMesh, following: np.ndarray) -> Iterator[tuple[int, np.ndarray]]:
    """Cracks by number, and the cells that they pass through, whose points follow nodes; bool, shape (n_cells,)."""
    for index, crack in enumerate(scene.cracks):
        polygon = crack.corners(mesh.lower.tolist(), mesh.upper.tolist())
        corners = np.array(polygon)
        margin = mesh.largest_edge
        near = following & mesh.cells_in_box(corners.min(axis=0) - margin, corners.max(axis=0) + margin)
        hit = np.zeros(len(following), bool)
        if not near.any():
            yield index, hit
            continue
        cells, faces = np.flatnonzero(near), match_faces(mesh, near)
        points = gauss_positions(mesh.nodes[mesh.cells[cells]])
        one, two = (np.repeat(k, len(cells)) for k in _POINT_EDGES.T)
        place = np.tile(np.arange(len(cells)), len(_POINT_EDGES))
        hit[cells[place[cross_polygon(polygon, points[place, one], points[place, two])]]] = True
        ends = np.stack([cells[faces.one // 6], cells[faces.two // 6]], axis=1)
        reach = GAUSS_POINTS.max() / 2.0 * np.diff(mesh.centroids[ends], axis=1)[:, 0]
        start, stop = mesh.centroids[ends[:, 0]] + reach, mesh.centroids[ends[:, 1]] - reach
        hit[ends[cross_polygon(polygon, start, stop)]] = True
        yield index, hit


def find_overlap(scene: Scene, mesh: HexMesh, peridynamic: np.ndarray, stays: np.ndarray | bool = False) -> np.ndarray:
    """Layers of cells on the finite-element side of the interface, some of which stay elements all the same."""
    everywhere = mesh.everywhere
    if 0 in everywhere.count(peridynamic, ~peridynamic):
        return np.zeros(len(peridynamic), bool)
    reached = peridynamic
    for layer in range(1, scene.coupling.overlap + 1):
        wider = mesh.neighbours(reached)
        if layer == 1 and everywhere.lacks(wider & ~reached):
            raise SceneError(["regions: the peridynamic and the finite-element cells share no node. Let them touch."])
        if everywhere.lacks(stays | ~wider) or everywhere.lacks(stays | (wider & ~reached)):
            deep = f"{layer} layer{'s' if layer > 1 else ''} deep"
            remedy = f"Use at most {layer - 1}, or enlarge them" if layer > 1 else "Enlarge them"
            raise SceneError(
                [
                    f"coupling.overlap = {scene.coupling.overlap} leaves no finite element outside the overlap: the "
                    f"finite-element regions are {deep}, seen from the interface. {remedy}."
                ]
            )
        if not everywhere.count(wider != reached)[0]:
            break
        reached = wider
    return reached & ~peridynamic
