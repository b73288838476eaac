"""A field at the nodes of a mesh, from the point data of a VTK XML file (.vtu) with the same nodes in any order."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from pdfem_mpi.deck.table import SceneError, did_you_mean, show
from pdfem_mpi.mesh.raw import Refusal
from pdfem_mpi.mesh.vtk_xml import read_point_field


def read_nodal_field(nodes: np.ndarray, tolerance: float, where: str, path: str, name: str, scale: float) -> np.ndarray:
    """The field's value at each node of the mesh, float64, shape (n_nodes,).

    Parameters
    ----------
    nodes : float64, shape (n_nodes, 3), dimension length
    tolerance : float, dimension length
        Two nodes within it are one.
    where : str
        The key of the deck that names the file.
    scale : float
        Multiplies the file's coordinates.

    Raises
    ------
    SceneError
        A file that cannot be read, without the field, or with other nodes.
    """
    from scipy.spatial import cKDTree

    shown = f"{where} = {show(path)}"
    try:
        points, fields = read_point_field(Path(path).read_bytes(), name)
    except OSError as error:
        raise SceneError([f"{shown} cannot be read: {error.strerror}. Give the path of a .vtu file."]) from None
    except Refusal as refusal:
        raise SceneError([f"{shown}: {message}" for message in refusal.messages]) from None
    if name not in fields:
        known = ", ".join(fields) or "none"
        raise SceneError([f"{shown} has no point data {show(name)}; it has {known}.{did_you_mean(name, fields)}"])
    distance, nearest = cKDTree(points * scale).query(nodes)
    far = np.flatnonzero(~(distance <= tolerance))
    if len(far):
        place = ", ".join(f"{c:.6g}" for c in nodes[far[0]])
        raise SceneError(
            [
                f"{shown} is on another mesh: {len(far)} of {len(nodes)} nodes have no point of the file, the "
                f"first at ({place}), whose nearest is {distance[far[0]]:.3g} away. Write it on the nodes of this mesh."
            ]
        )
    values = fields[name][nearest]
    if not np.isfinite(values).all():
        count = np.count_nonzero(~np.isfinite(values))
        raise SceneError([f"{shown}: {show(name)} is not finite at {count} nodes. Write the file again."])
    return values
