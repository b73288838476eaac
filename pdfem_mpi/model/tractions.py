"""Tractions on faces of the mesh, as forces on nodes and on the points of free cells."""

from __future__ import annotations

import math

import numpy as np

from pdfem_mpi.body.areas import face_shares
from pdfem_mpi.body.selection import ChosenFaces
from pdfem_mpi.body.share import Share
from pdfem_mpi.deck.loads import Pressure, Traction
from pdfem_mpi.deck.table import SceneError

_FACE_POINTS = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) / math.sqrt(3.0)
_FACE_NODES = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])


def traction_forces(share: Share, load: Traction | Pressure, chosen: ChosenFaces, where: str):
    """Forces of a load on nodes (n_nodes, 3), and on the points of free cells (n_cells, 8, 3). Collective.

    In model units, and whole at the nodes and cells that the rank owns: terms come in the order of the mesh, those of
    other ranks' faces at the node among them. Points take ``int L_i dA`` of their cell's face, as in the equilibrium
    that fitted bond factors are made for. A pressure acts along the mean normal of each face.

    Raises
    ------
    SceneError
        On all ranks: faces that cannot take a traction.
    """
    _refuse(load, chosen, where)
    cells, faces = chosen.cells, chosen.nodes
    of_points = share.has_points[cells] & ~share.is_overlap[cells]
    corners = share.nodes[faces]
    areas = np.zeros(len(faces))
    nodal = np.zeros((len(share.nodes), 3))
    shares = np.zeros((len(faces), 4))
    normals = np.zeros((len(faces), 3))
    for r, s in _FACE_POINTS:
        shape = (1 + _FACE_NODES[:, 0] * r) * (1 + _FACE_NODES[:, 1] * s) / 4
        along_r, along_s = np.zeros((len(faces), 3)), np.zeros((len(faces), 3))
        for a in range(4):
            along_r += _FACE_NODES[a, 0] * (1 + _FACE_NODES[a, 1] * s) / 4 * corners[:, a]
            along_s += _FACE_NODES[a, 1] * (1 + _FACE_NODES[a, 0] * r) / 4 * corners[:, a]
        normal = np.cross(along_r, along_s)
        area = np.sqrt(normal[:, 0] ** 2 + normal[:, 1] ** 2 + normal[:, 2] ** 2)
        areas += area
        normals += normal
        shares += shape * area[:, None]
    units = share.units
    (whole,) = share.exact_sums([areas[share.is_owned[cells]]]).tolist()
    if isinstance(load, Pressure):
        size = np.sqrt(normals[:, 0] ** 2 + normals[:, 1] ** 2 + normals[:, 2] ** 2)
        traction = normals * (-units.numbers(load.pressure / units.stress) / size)[:, None]
    elif load.traction is not None:
        traction = units.numbers(np.array(load.traction) / units.stress)
    else:
        traction = units.numbers(np.array(load.total) / units.force / whole)
    on_points = np.zeros((len(share.mesh.cells), 8, 3))
    if isinstance(load, Traction) and load.nodal == "equal":
        chosen_nodes = np.zeros(len(share.nodes), bool)
        chosen_nodes[faces] = True
        # a node on a mirror plane is shared with the other side
        part = np.where(chosen_nodes, np.ldexp(1.0, -np.count_nonzero(share.plane_components, axis=1)), 0.0)
        (parts,) = share.exact_sums([part[share.subdomain.owned_nodes]]).tolist()
        nodal[chosen_nodes] = part[chosen_nodes, None] * (traction * whole / parts)
    else:
        of_faces = np.broadcast_to(traction, (len(faces), 3))
        for a in range(4):
            np.add.at(nodal, faces[~of_points, a], shares[~of_points, a, None] * of_faces[~of_points])
        shares_of_points = face_shares(share.mesh, share.nodes, cells[of_points], faces[of_points])
        np.add.at(on_points, cells[of_points], shares_of_points[:, :, None] * of_faces[of_points, None])
    return nodal, on_points


def _refuse(load: Traction | Pressure, chosen: ChosenFaces, where: str) -> None:
    """Refuse faces that cannot take a load: without nodes to share it equally, or on a mirror plane.

    Raises
    ------
    SceneError
    """
    shown = f"{where}.{load.shown}"
    if isinstance(load, Traction) and load.nodal == "equal" and chosen.on_free_points:
        raise SceneError(
            [
                f"{shown} has {chosen.on_free_points} of {chosen.total} faces on peridynamic cells, where there are no "
                'nodes to share it equally. Use nodal = "consistent".'
            ]
        )
    if chosen.on_mirrors:
        raise SceneError(
            [
                f"{shown} has {chosen.on_mirrors} of {chosen.total} faces on a mirror plane "
                "(mesh.symmetry), which lies inside of the whole body. Pull elsewhere, or remove the mirror."
            ]
        )
