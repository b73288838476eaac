"""Nodes at one place made one: blocks that were meshed apart become one body."""

from __future__ import annotations

import numpy as np

from pdfem_mpi.deck.table import SceneError, show
from pdfem_mpi.mesh.hexmesh import HexMesh

#: A length of ``mesh.merge`` above this fraction of the shortest edge could flatten cells.
LARGEST_FRACTION = 0.1


def merge_nodes(mesh: HexMesh, node_number: np.ndarray, length: float) -> tuple[HexMesh, np.ndarray]:
    """Join nodes that are nearer to each other than a length, to the first of them in the file.

    Parameters
    ----------
    node_number : int64, shape (n_nodes,)
        Numbers of the nodes in the file.
    length : float, dimension length

    Returns
    -------
    mesh : HexMesh
    node_number : int64
        Of the nodes that are left, in the same order.

    Raises
    ------
    SceneError
        A length above a tenth of the shortest edge.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    edge = mesh.smallest_edge
    if length > LARGEST_FRACTION * edge:
        raise SceneError(
            [
                f"mesh.merge = {show(length)} is above a tenth of the shortest edge, {edge:.6g}. Use at most "
                f"{LARGEST_FRACTION * edge:.6g}."
            ]
        )
    n = len(mesh.nodes)
    first, second = cKDTree(mesh.nodes).query_pairs(length, output_type="ndarray").T
    graph = coo_array((np.ones(len(first), np.int8), (first, second)), shape=(n, n))
    group = connected_components(graph, directed=False)[1]
    kept = np.unique(group, return_index=True)[1]  # the first node of each group
    stays = np.zeros(n, bool)
    stays[kept] = True
    number = np.cumsum(stays) - 1
    leader = np.empty(len(kept), np.int64)
    leader[group[kept]] = number[kept]
    renumbered = leader[group]
    faces = {
        name: np.where(rows >= 0, renumbered[np.maximum(rows, 0)], -1).astype(np.int32)
        for name, rows in mesh.face_sets.items()
    }
    nodes = {name: np.unique(renumbered[members]) for name, members in mesh.node_sets.items()}
    note = f"mesh.merge = {show(length)} joined {n - len(kept)} nodes to others at their place"
    merged = HexMesh(
        mesh.nodes[stays],
        renumbered[mesh.cells].astype(np.int32),
        mesh.cell_sets,
        type(mesh.face_sets)(faces),
        type(mesh.node_sets)(nodes),
        (*mesh.notes, note),
    )
    return merged, node_number[stays]
