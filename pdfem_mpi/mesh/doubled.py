"""Cracks made of doubled nodes: faces of the boundary that lie at one place and share no node."""

from __future__ import annotations

import numpy as np

from pdfem_mpi.mesh.hexmesh import FACES, HexMesh


def doubled_faces(mesh: HexMesh) -> tuple[np.ndarray, np.ndarray]:
    """Faces of the boundary with another one at their place.

    Returns
    -------
    corners : float64, shape (n, 4, 3), dimension length
        Of one face of each pair.
    stray : int64
        Nodes with another at their place that no such face has, rising.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    pairs = cKDTree(mesh.nodes).query_pairs(mesh.tolerance, output_type="ndarray")
    if not len(pairs):
        return np.empty((0, 4, 3)), np.empty(0, np.int64)
    n = len(mesh.nodes)
    graph = coo_array((np.ones(len(pairs), np.int8), tuple(pairs.T)), shape=(n, n))
    place = connected_components(graph, directed=False)[1]
    cells, sides = mesh.boundary
    faces = mesh.cells[cells[:, None], FACES[sides]]
    _, number, count = np.unique(np.sort(place[faces], axis=1), axis=0, return_inverse=True, return_counts=True)
    number = number.reshape(-1)
    twice = count[number] > 1
    on_faces = np.zeros(n, bool)
    on_faces[faces[twice]] = True
    first = np.unique(number[twice], return_index=True)[1]
    stray = np.unique(pairs)
    return mesh.nodes[faces[np.flatnonzero(twice)[first]]], stray[~on_faces[stray]]
