"""How the faces of hexahedra meet: pairs, the bodies they join, and the faces that remain outside."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pdfem_mpi.deck.table import SceneError
from pdfem_mpi.mesh.hexmesh import FACES, LISTED, HexMesh, list_cells


@dataclass(frozen=True)
class Faces:
    """How the faces of some cells meet; a face is counted as ``6 k + side``, k counting the chosen cells.

    Attributes
    ----------
    cells : int64, shape (n_chosen,)
        The chosen cells of the mesh.
    one, two : int64, shape (n_pairs,)
        Faces that are the same face.
    alone : int64, shape (n_alone,)
        Faces that no other chosen cell shares.
    """

    cells: np.ndarray
    one: np.ndarray
    two: np.ndarray
    alone: np.ndarray


def match_faces(mesh: HexMesh, chosen: np.ndarray) -> Faces:
    """Find which faces of the chosen cells are the same.

    Parameters
    ----------
    chosen : bool, shape (n_cells,)

    Raises
    ------
    SceneError
        Faces with more than two cells, cells whose common face both see from the same side.
    """
    cells = np.flatnonzero(chosen)
    corners = mesh.cells[cells][:, FACES].reshape(-1, 4).astype(np.int64)
    key = np.sort(corners, axis=1)
    order = np.lexsort(key.T[::-1])
    fresh = np.ones(len(order), bool)
    fresh[1:] = (key[order[1:]] != key[order[:-1]]).any(axis=1)
    group = np.empty(len(order), np.int64)
    group[order] = np.cumsum(fresh) - 1
    count = np.bincount(group)
    messages = []
    if (count > 2).any():
        bad = np.flatnonzero(count[group] > 2)
        messages.append(
            f"mesh: {np.count_nonzero(count > 2)} faces belong to more than two cells, the first of "
            f"cell {list_cells(mesh, cells[bad // 6])}: the boundary is not closed there. Merge or remove cells that "
            "overlap."
        )
    first = order[np.flatnonzero(fresh)]
    pairs = np.flatnonzero(count == 2)
    one, two = first[pairs], order[np.flatnonzero(fresh)[pairs] + 1]
    turned = _same_turn(corners[one], corners[two])
    if turned.any():
        messages.append(
            f"mesh: {np.count_nonzero(turned)} faces are seen from the same side by both of their cells, the first by "
            f"cell {list_cells(mesh, cells[one[turned] // 6])}: one of each is inside out. Give its nodes in VTK order."
        )
    if messages:
        raise SceneError(messages)
    return Faces(cells, one, two, np.flatnonzero(count[group] == 1))


def refuse_pieces(mesh: HexMesh, faces: Faces) -> None:
    """Check that the cells hang together by their faces.

    Raises
    ------
    SceneError
        They form several pieces.
    """
    n_pieces, piece = connected(len(faces.cells), faces.one // 6, faces.two // 6)
    if n_pieces == 1:
        return
    small = np.argsort(np.bincount(piece), kind="stable")[:-1]
    starts = faces.cells[[np.flatnonzero(piece == p)[0] for p in small[:LISTED]]]
    raise SceneError(
        [
            f'peridynamics.surface_correction = "fitted" fits bodies that hang together, and the cells with bonds '
            f"form {n_pieces} pieces that share no face; the smaller ones begin with cell {list_cells(mesh, starts)}. "
            'Let them touch, simulate them one by one, or use "virial".'
        ]
    )


def find_bodies(faces: Faces, kind: np.ndarray) -> np.ndarray:
    """Number the bodies: cells of one kind that hang together by their faces.

    Parameters
    ----------
    faces : Faces
    kind : int, shape (n_cells,)
        -1 for cells of no body.

    Returns
    -------
    int32, shape (n_cells,)
        Bodies in the order of their first cells; -1 for cells of none.
    """
    of_cell = kind[faces.cells]
    one, two = faces.one // 6, faces.two // 6
    same = of_cell[one] == of_cell[two]
    _, label = connected(len(of_cell), one[same], two[same])
    chosen = of_cell >= 0
    values, first, label = np.unique(label[chosen], return_index=True, return_inverse=True)
    rank = np.empty(len(values), np.int32)
    rank[np.argsort(first, kind="stable")] = np.arange(len(values))
    body = np.full(len(kind), -1, np.int32)
    body[faces.cells[chosen]] = rank[label]
    return body


def connected(n: int, one: np.ndarray, two: np.ndarray) -> tuple[int, np.ndarray]:
    """How many parts n things make that are joined in pairs, int (n_pairs,) each, and the part of each.

    Parts are numbered in the order of their first things.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    return connected_components(coo_array((np.ones(len(one)), (one, two)), shape=(n, n)), directed=False)


def outer_faces(faces: Faces, body: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Cells and sides, both int64 (n_faces,), of the faces of bodies that no other cell of the same body shares."""
    number = body[faces.cells]
    between = number[faces.one // 6] != number[faces.two // 6]
    outer = np.sort(np.concatenate([faces.alone, faces.one[between], faces.two[between]]))
    outer = outer[number[outer // 6] >= 0]
    return faces.cells[outer // 6], outer % 6


def _same_turn(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Whether two quadrilaterals of the same nodes run around in the same sense; shape (n,)."""
    start = np.argmax(b == a[:, :1], axis=1)
    after = b[np.arange(len(b)), (start + 1) % 4]
    return after == a[:, 1]
