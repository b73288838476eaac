"""What can be wrong with the cells and nodes of a mesh file, each finding with its count, first places and remedy.

An element or a bond would live on most of these meshes and give a wrong answer without a word: cracks along nodes that
coincide, a load path cut at a hanging node, mass counted twice in a cell that is there twice.
"""

from __future__ import annotations

import numpy as np

from pdfem_mpi.deck.table import SceneError
from pdfem_mpi.mesh.doubled import doubled_faces
from pdfem_mpi.mesh.hexmesh import FACES, HexMesh, equal_rows
from pdfem_mpi.mesh.quality import measure

#: A node hangs on a face when it is this near to it, as a fraction of the face's half diagonal.
HANGING_TOLERANCE = 1e-3
#: Turns of Gauss and Newton that find the nearest place of a bilinear face.
PROJECTIONS = 12
#: Nodes this near to a plane of the bounding box, as a fraction of the mean edge, are meant to be on it.
PLANE_TOLERANCE = 1e-3
#: Cells, nodes or parts that a message lists.
LISTED = 3


def find_defects(mesh: HexMesh, node_number: np.ndarray, cracked: bool = False) -> list[str]:
    """All defects of a mesh, one sentence each; where it may be ``cracked``, faces at one place are none.

    Parameters
    ----------
    node_number : int64, shape (n_nodes,)
        Numbers of the nodes in the file, counted from 0, which messages speak of.

    Returns
    -------
    list of str
    """
    twice = _repeated_nodes(mesh)
    messages = _collapsed(mesh, twice)
    try:
        measure(HexMesh(mesh.nodes, mesh.cells[~twice]), np.flatnonzero(~twice))
    except SceneError as error:
        messages += error.messages
    if twice.any():
        return messages  # collapsed faces are no faces to compare
    _, first = np.unique(equal_rows(np.sort(mesh.cells, axis=1)), return_index=True)
    again = np.setdiff1d(np.arange(len(mesh.cells)), first)
    if len(again):
        messages += _repeated_cells(mesh, again)
        mesh = HexMesh(mesh.nodes, mesh.cells[np.sort(first)])
    else:
        messages += _shared_by_many(mesh)
    return messages + _joints(mesh, node_number, cracked)


def face_problems(mesh: HexMesh, face: str, where: str) -> list[str]:
    """Why ``face = "x+"`` of a deck selects nothing, or not all that it should; where is the table's path."""
    plane, off, nearly = _nearly_on(mesh, face)
    named = f"{where}.face = {face}"
    if len(nearly):
        return [
            f"{named} leaves out {len(nearly)} nodes that lie nearly on the plane {face[0]} = {plane:.9g}, the first "
            f"at {_place(mesh.nodes[nearly[0]])}, {off[nearly[0]]:.2g} off. Write coordinates with more digits, or "
            "choose by set."
        ]
    if not len(mesh.faces_on_face(face)[0]):
        return [
            f"{named} selects nothing: no face of a cell lies on the plane {face[0]} = {plane:.9g}, where the body "
            "ends. Choose by set."
        ]
    return []


def mirror_problems(mesh: HexMesh, face: str) -> list[str]:
    """Why a face of the bounding box cannot be a mirror plane: the body would not be joined to its mirror image."""
    plane, off, nearly = _nearly_on(mesh, face)
    if len(nearly):
        return [
            f"mesh.symmetry: {len(nearly)} nodes lie nearly on the mirror plane {face} at {face[0]} = {plane:.9g}, the "
            f"first at {_place(mesh.nodes[nearly[0]])}, {off[nearly[0]]:.2g} off. Write coordinates with more digits."
        ]
    if not len(mesh.faces_on_face(face)[0]):
        return [
            f"mesh.symmetry: no face of a cell lies on the mirror plane {face} at {face[0]} = {plane:.9g}. Let the "
            "mesh end there, or remove the plane."
        ]
    return []


def _nearly_on(mesh: HexMesh, face: str) -> tuple[float, np.ndarray, np.ndarray]:
    """Coordinate of a plane of the bounding box, distances of all nodes, and the nodes that miss it by a little."""
    axis = "xyz".index(face[0])
    plane = float((mesh.lower if face[1] == "-" else mesh.upper)[axis])
    off = np.abs(mesh.nodes[:, axis] - plane)
    return plane, off, np.flatnonzero((off > mesh.tolerance) & (off < PLANE_TOLERANCE * mesh.average_edge))


def _repeated_nodes(mesh: HexMesh) -> np.ndarray:
    ascending = np.sort(mesh.cells, axis=1)
    return (ascending[:, 1:] == ascending[:, :-1]).any(axis=1)


def _collapsed(mesh: HexMesh, twice: np.ndarray) -> list[str]:
    if not twice.any():
        return []
    return [
        f"mesh has {np.count_nonzero(twice)} of {len(twice)} cells that name a node twice (wedges or pyramids written "
        f"as hexahedra), the first {_cells(mesh, np.flatnonzero(twice))}. Mesh their volume with hexahedra."
    ]


def _repeated_cells(mesh: HexMesh, again: np.ndarray) -> list[str]:
    return [
        f"mesh has {len(again)} cells with the same eight nodes as a cell before them, the first "
        f"{_cells(mesh, again)}. Remove them; in Gmsh, give each volume one physical group."
    ]


def _shared_by_many(mesh: HexMesh) -> list[str]:
    number = equal_rows(np.sort(mesh.cells[:, FACES].reshape(-1, 4), axis=1))
    count = np.bincount(number)
    if not (count > 2).any():
        return []
    cells = np.flatnonzero((count[number] > 2).reshape(-1, 6).any(axis=1))
    return [
        f"mesh has {np.count_nonzero(count > 2)} faces that more than two cells share: cells overlap, the first "
        f"{_cells(mesh, cells)}. Remove the cells that are too many."
    ]


def _joints(mesh: HexMesh, node_number: np.ndarray, cracked: bool) -> list[str]:
    """Coincident nodes, hanging nodes, and parts that are not joined."""
    from scipy.spatial import cKDTree

    messages = []
    pairs = cKDTree(mesh.nodes).query_pairs(mesh.tolerance, output_type="ndarray")
    if cracked:
        messages += _stray_nodes(mesh, node_number)
    elif len(pairs):
        first = np.unique(pairs.min(axis=1))
        messages.append(
            f"mesh has {len(first)} nodes with another node at the same place (within {mesh.tolerance:.2g}), the first "
            f"{_nodes(mesh, node_number, first)}. Merge them by mesh.merge = LENGTH in the deck, or in Gmsh by "
            "geometry.removeAllDuplicates() or Coherence Mesh; cracks are cut by [[cracks]], or kept by "
            'mesh.doubled_nodes = "crack".'
        )
    hanging = _hanging_nodes(mesh)
    if len(hanging):
        messages.append(
            f"mesh has {len(hanging)} hanging nodes, which lie inside a face or an edge of a cell that does not have "
            f"them, the first {_nodes(mesh, node_number, hanging)}. Let the cells on both sides share all nodes."
        )
    n_parts, part = _parts(mesh)
    if n_parts > 1 and not messages:  # else the reason is named already
        first = [int(np.flatnonzero(part == k)[0]) for k in range(n_parts)]
        sizes = np.bincount(part)[:LISTED]
        places = _cells(mesh, np.array(first))
        messages.append(
            f"mesh falls into {n_parts} parts that share no node, of {', '.join(map(str, sizes))}"
            f"{' and more' if n_parts > LISTED else ''} cells, which begin with {places}. Join them, or keep one."
        )
    return messages


def _stray_nodes(mesh: HexMesh, node_number: np.ndarray) -> list[str]:
    """A sentence about nodes at one place that belong to no crack."""
    faces, stray = doubled_faces(mesh)
    if not len(faces) and not len(stray):
        why = 'mesh.doubled_nodes = "crack" finds none: no two nodes are at one place.'
        return [f"{why} Remove it, or cut by [[cracks]]."]
    if not len(stray):
        return []
    return [
        f'mesh.doubled_nodes = "crack": {len(stray)} nodes have another node at their place and no face with another '
        f"face at its place, the first {_nodes(mesh, node_number, stray)}: that is no crack. Merge them in the mesh."
    ]


def _parts(mesh: HexMesh) -> tuple[int, np.ndarray]:
    """Number of parts that share no node, and the part of each cell."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    n_cells, n_nodes = len(mesh.cells), len(mesh.nodes)
    cell = np.repeat(np.arange(n_cells), 8)
    size = n_cells + n_nodes
    graph = coo_array((np.ones(8 * n_cells, np.int8), (cell, n_cells + mesh.cells.reshape(-1))), shape=(size, size))
    n_parts, part = connected_components(graph, directed=False)
    return n_parts, part[:n_cells]


def _hanging_nodes(mesh: HexMesh) -> np.ndarray:
    """Nodes inside faces or edges of cells that do not have them, in ascending order.

    At a hanging node faces of its own cells have no partner, and neither has the face it hangs on: only nodes and
    faces of the boundary have to be looked at.
    """
    from scipy.spatial import cKDTree

    cell, side = mesh.boundary
    corners = mesh.cells[cell[:, None], FACES[side]]
    outer = np.unique(corners)
    centre = mesh.nodes[corners].mean(axis=1)
    radius = np.sqrt(((mesh.nodes[corners] - centre[:, None]) ** 2).sum(axis=2).max(axis=1))
    near = cKDTree(mesh.nodes[outer]).query_ball_point(centre, radius)
    face = np.repeat(np.arange(len(corners)), [len(found) for found in near])
    node = outer[np.concatenate([np.asarray(found, np.int64) for found in near])]
    other = ~(mesh.cells[cell[face]] == node[:, None]).any(axis=1)
    face, node = face[other], node[other]
    x, quad = mesh.nodes[node], mesh.nodes[corners[face]]
    distance = _distance_to_face(x, quad)
    apart = np.sqrt(((quad - x[:, None]) ** 2).sum(axis=2)).min(axis=1) > mesh.tolerance  # else the nodes coincide
    return np.unique(node[apart & (distance <= np.maximum(HANGING_TOLERANCE * radius[face], mesh.tolerance))])


def _distance_to_face(x: np.ndarray, quad: np.ndarray) -> np.ndarray:
    """Distance of points (n, 3) from the bilinear faces through four corners, (n, 4, 3); shape (n,)."""
    middle, along_r, along_s, twist = (
        0.25 * (quad * np.array(signs)[:, None]).sum(axis=1)
        for signs in ((1, 1, 1, 1), (-1, 1, 1, -1), (-1, -1, 1, 1), (1, -1, 1, -1))
    )
    r, s = np.zeros((2, len(x), 1))
    for _ in range(PROJECTIONS):
        miss = x - (middle + r * along_r + s * along_s + r * s * twist)
        a, b = along_r + s * twist, along_s + r * twist
        aa, ab, bb = ((p * q).sum(axis=1, keepdims=True) for p, q in ((a, a), (a, b), (b, b)))
        pa, pb = ((p * miss).sum(axis=1, keepdims=True) for p in (a, b))
        det = np.maximum(aa * bb - ab * ab, 1e-300)
        r = np.clip(r + (bb * pa - ab * pb) / det, -1.0, 1.0)
        s = np.clip(s + (aa * pb - ab * pa) / det, -1.0, 1.0)
    miss = x - (middle + r * along_r + s * along_s + r * s * twist)
    return np.sqrt((miss**2).sum(axis=1))


def _cells(mesh: HexMesh, numbers: np.ndarray) -> str:
    """The first few of some cells and where they are."""
    return ", ".join(f"cell {cell} at {_place(mesh.centroids[cell])}" for cell in numbers[:LISTED])


def _nodes(mesh: HexMesh, node_number: np.ndarray, numbers: np.ndarray) -> str:
    """The first few of some nodes and where they are."""
    return ", ".join(f"node {node_number[node]} at {_place(mesh.nodes[node])}" for node in numbers[:LISTED])


def _place(x: np.ndarray) -> str:
    return f"({', '.join(f'{c:.6g}' for c in x)})"
