"""Voids of a mesh file that bonds reach across: they know points, and nothing of what is between these.

What `mesh.remove` takes out of a box keeps bonds apart (`peridynamics.gaps`). A mesh file leaves a notch out without a
word, and where it is narrower than the cutoff radius, bonds hold its sides together.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pdfem_mpi.body.discretization import Discretization
from pdfem_mpi.deck.meshes import FileMesh
from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.mesh.hexmesh import FACES

#: Cosine of the angle between a face's normal and the way to the face opposite, and of that between two normals, at
#: least: the sides of a notch look at each other, the faces around a corner or a hole do not.
OPPOSITE = 0.5


def describe_narrow_gaps(scene: Scene, whole: Discretization, more: np.ndarray | None = None) -> list[str]:
    """A sentence about faces of cells with points that look at each other from less than the cutoff radius away.

    ``more`` are cells that may get points later, bool, shape (n_cells,).
    """
    if more is not None:
        whole = replace(whole, has_points=whole.has_points | more)
    if not isinstance(scene.mesh, FileMesh) or not whole.has_points.any():
        return []
    reach = whole.cutoff * whole.units.length
    centre, one, two, distance = facing_pairs(whole, reach)
    if not len(one):
        return []
    nearest = int(np.argmin(distance))
    place = 0.5 * (centre[one[nearest]] + centre[two[nearest]])
    count = len(np.unique(np.concatenate([one, two])))
    return [
        f"warning: {count} faces of the mesh look at each other across a void narrower than the cutoff radius of "
        f"{reach:.6g}, the nearest {distance[nearest]:.6g} apart around ({', '.join(f'{x:.6g}' for x in place)}): "
        "bonds reach across it and hold its sides together. Take the void out of a box by [[mesh.remove]], which "
        "keeps bonds apart, make the cells there smaller, or cut these bonds by a table of [[cracks]] through it."
    ]


def cells_at_voids(scene: Scene, whole: Discretization) -> np.ndarray:
    """Cells of a mesh file that look at others across a void which bonds could reach across; bool, shape (n_cells,)."""
    found = np.zeros(len(whole.mesh.cells), bool)
    if isinstance(scene.mesh, FileMesh):
        everywhere = replace(whole, has_points=~found)
        _, one, two, _ = facing_pairs(everywhere, whole.cutoff * whole.units.length)
        found[whole.mesh.boundary[0][np.concatenate([one, two])]] = True
    return found


def facing_pairs(whole: Discretization, reach: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Pairs of boundary faces, of cells with points, that look at each other within a distance.

    Parameters
    ----------
    reach : float, dimension length

    Returns
    -------
    centre : float64, shape (n_faces, 3), dimension length
    one, two : int64, shape (n_pairs,)
    distance : float64, shape (n_pairs,), dimension length
        Between their centres; doubled faces, at one place, are none.
    """
    from scipy.spatial import cKDTree

    mesh = whole.mesh
    cells, sides = mesh.boundary
    chosen = whole.has_points[cells]
    cells, sides = cells[chosen], sides[chosen]
    corners = mesh.nodes[mesh.cells[cells[:, None], FACES[sides]]]
    centre = corners.mean(axis=1)
    normal = np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1])  # outwards
    normal /= np.sqrt((normal**2).sum(axis=1))[:, None]
    one, two = cKDTree(centre).query_pairs(reach, output_type="ndarray").T
    way = centre[two] - centre[one]
    distance = np.sqrt((way**2).sum(axis=1))
    across = OPPOSITE * distance
    looks = ((way * normal[one]).sum(axis=1) >= across) & ((way * normal[two]).sum(axis=1) <= -across)
    looks &= ((normal[one] * normal[two]).sum(axis=1) <= -OPPOSITE) & (distance > mesh.tolerance)
    return centre, one[looks], two[looks], distance[looks]
