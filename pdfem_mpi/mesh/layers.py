"""Layers of cells beneath faces of a mesh."""

from __future__ import annotations

import numpy as np

from pdfem_mpi.mesh.hexmesh import HexMesh


def cells_near_face(mesh: HexMesh, face: str, layers: int) -> np.ndarray:
    """Cells of the first ``layers`` layers beneath a plane of the bounding box.

    The first layer are the cells with a face on the plane, each next one the cells that share a node with it.

    Returns
    -------
    bool, shape (n_cells,)
    """
    return cells_beneath(mesh, mesh.faces_on_face(face)[0], layers)


def cells_beneath(mesh: HexMesh, first: np.ndarray, layers: int) -> np.ndarray:
    """Some cells, and further layers of cells that share a node with the one before.

    Parameters
    ----------
    first : int64, shape (n,)
        Numbers of the cells of the first layer.

    Returns
    -------
    bool, shape (n_cells,)
    """
    chosen = np.zeros(len(mesh.cells), bool)
    chosen[first] = True
    for _ in range(layers - 1):
        wider = mesh.neighbours(chosen)
        if np.array_equal(wider, chosen):  # all that hang together: a deck may ask for far more layers
            break
        chosen = wider
    return chosen
