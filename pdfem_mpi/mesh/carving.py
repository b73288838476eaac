"""Parts taken out of a box of cells, and every reason why what is left is no body."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from pdfem_mpi.deck.directions import unit
from pdfem_mpi.deck.removals import RemovedBox, RemovedCylinder, RemovedHalfSpace
from pdfem_mpi.deck.table import SceneError
from pdfem_mpi.mesh.faces import connected
from pdfem_mpi.mesh.hexmesh import FACES, LISTED, HexMesh, equal_rows, list_cells, with_own_nodes


def carve(mesh: HexMesh, removals: Sequence[Any], symmetry: Sequence[str]) -> HexMesh:
    """The mesh without the cells that the deck removes, and without the nodes that only these had.

    Cells and nodes keep their order.

    Parameters
    ----------
    removals : tables of `deck.removals`
    symmetry : faces
        Mirror planes of the box.

    Raises
    ------
    SceneError
        All that is wrong: a table that removes nothing, a body removed whole, in parts, or away from a mirror plane.
    """
    messages, gone = [], np.zeros(len(mesh.cells), bool)
    for index, removal in enumerate(removals):
        inside = is_removed((removal,), mesh.centroids, mesh.tolerance)
        if not inside.any():
            messages.append(
                f"mesh.remove.{index} removes no cell: its {removal.kind.replace('_', ' ')} holds no centroid of the "
                f"{len(inside)} cells, which are {mesh.largest_edge:.6g} wide. Correct its place, or make it wider."
            )
        gone |= inside
    if gone.all():
        messages.append("mesh.remove takes all cells: nothing of the body is left. Remove less.")
        raise SceneError(messages)
    used, cells = with_own_nodes(mesh.cells[~gone], len(mesh.nodes))
    left = HexMesh(mesh.nodes[used], cells)
    for face in symmetry:
        if not mesh.nodes_on_face(face)[used].any():
            messages.append(
                f"mesh.remove takes all cells at the mirror plane {face} (mesh.symmetry): the body does not reach it. "
                "Remove less, or remove the plane."
            )
    messages += _parts(left)
    if messages:
        raise SceneError(messages)
    return left


def is_removed(removals: Sequence[Any], centroids: np.ndarray, tolerance: float) -> np.ndarray:
    """Whether cells with these centroids, (n, 3), are removed; what lies on a surface is. Bool, shape (n,)."""
    gone = np.zeros(len(centroids), bool)
    for removal in removals:
        gone |= _inside(removal, centroids, tolerance)
    return gone


def _inside(removal: Any, x: np.ndarray, tolerance: float) -> np.ndarray:
    if isinstance(removal, RemovedBox):
        above = (x >= np.array(removal.lower) - tolerance).all(axis=1)
        return above & (x <= np.array(removal.upper) + tolerance).all(axis=1)
    if isinstance(removal, RemovedHalfSpace):
        normal = unit(removal.normal)
        height = sum(normal[d] * (x[:, d] - removal.point[d]) for d in range(3))  # in one order: the same bits anywhere
        return height >= -tolerance
    along = "xyz".index(removal.axis)
    across = [d for d in range(3) if d != along]
    if isinstance(removal, RemovedCylinder):
        offset = x[:, across] - np.array(removal.centre)[across]
        inside = np.sqrt(offset[:, 0] ** 2 + offset[:, 1] ** 2) <= removal.radius + tolerance
    else:
        inside = _in_polygon(np.array(removal.polygon), x[:, across], tolerance)
    if removal.span is not None:
        inside &= (x[:, along] >= removal.span[0] - tolerance) & (x[:, along] <= removal.span[1] + tolerance)
    return inside


def _in_polygon(corners: np.ndarray, x: np.ndarray, tolerance: float) -> np.ndarray:
    """Whether points of a plane, (n, 2), lie in a simple polygon or on its edges; bool, shape (n,)."""
    p, q = x.T
    inside, near = np.zeros(len(x), bool), np.zeros(len(x), bool)
    for (a, b), (c, d) in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        between = (b > q) != (d > q)
        inside ^= between & (p < a + (c - a) / (d - b if d != b else 1.0) * (q - b))
        square = (c - a) ** 2 + (d - b) ** 2
        share = np.clip(((p - a) * (c - a) + (q - b) * (d - b)) / square, 0.0, 1.0) if square else 0.0
        near |= np.hypot(p - a - share * (c - a), q - b - share * (d - b)) <= tolerance
    return inside | near


def _parts(mesh: HexMesh) -> list[str]:
    """A sentence about cells that do not hang together by faces."""
    faces = equal_rows(np.sort(mesh.cells[:, FACES].reshape(-1, 4), axis=1))
    cell = np.repeat(np.arange(len(mesh.cells)), len(FACES))
    n_parts, part = connected(len(mesh.cells) + int(faces.max()) + 1, cell, len(mesh.cells) + faces)
    if n_parts == 1:
        return []
    part = part[: len(mesh.cells)]
    sizes = np.bincount(part)
    first = np.array([np.flatnonzero(part == k)[0] for k in range(min(n_parts, LISTED))])
    return [
        f"mesh.remove leaves {n_parts} parts that share no face, of {', '.join(map(str, sizes[:LISTED]))}"
        f"{' and more' if n_parts > LISTED else ''} cells, which begin with cell {list_cells(mesh, first)}. Remove "
        "less, or remove all parts but one."
    ]
