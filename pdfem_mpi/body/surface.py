"""The body's surface near a rank's cells, which bonds must not cross."""

from __future__ import annotations

import numpy as np

from pdfem_mpi.body.discretization import Discretization
from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.mesh.hexmesh import FACES


def surface_near(scene: Scene, whole: Discretization, mine: np.ndarray, turnable: bool) -> np.ndarray:
    """Faces of the surface within the cutoff radius of the box around some cells; none of a body without hollows.

    Faces on mirror planes are inside of the body.

    Parameters
    ----------
    mine : bool, shape (n_cells,)
    turnable : bool
        Whether elements may be turned into bonds: they are compared with the surface, too.

    Returns
    -------
    float64, shape (n, 4, 3), dimension length
        Corners in model units, counter-clockwise as seen from outside.
    """
    mesh = whole.mesh
    with_bonds = mine if turnable else mine & whole.has_points
    if not scene.mesh.may_have_hollows or not with_bonds.any():
        return np.empty((0, 4, 3))
    cells, sides = mesh.boundary
    nodes = mesh.cells[cells[:, None], FACES[sides]]
    for face in scene.mesh.symmetry:
        nodes = nodes[~mesh.nodes_on_face(face)[nodes].all(axis=1)]
    own = whole.nodes[mesh.cells[mine]]
    low, high = own.min(axis=(0, 1)) - whole.cutoff, own.max(axis=(0, 1)) + whole.cutoff
    corners = whole.nodes[nodes]
    return corners[((corners.max(axis=1) >= low) & (corners.min(axis=1) <= high)).all(axis=1)]
