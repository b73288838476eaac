"""Tractions on faces of the mesh, as forces on nodes and on the points of free cells."""

from __future__ import annotations

import math

import numpy as np

from pdfem_mpi.body.areas import face_shares
from pdfem_mpi.body.selection import ChosenFaces
from pdfem_mpi.body.share import Share
from pdfem_mpi.deck.loads import Traction
from pdfem_mpi.deck.table import SceneError

_FACE_POINTS = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) / math.sqrt(3.0)
_FACE_NODES = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])


def traction_forces(share: Share, load: Traction, chosen: ChosenFaces, where: str, fitted: bool):
    """Forces of a traction on nodes (n_nodes, 3), and on the points of free cells (n_cells, 8, 3). Collective.

    In model units, and whole at the nodes and cells that the rank owns: terms come in the order of the mesh, those of
    other ranks' faces at the node among them. Points take ``int L_i dA`` of their cell's face, as in the equilibrium
    that fitted bond factors are made for.

    Raises
    ------
    SceneError
        On all ranks: faces that cannot take a traction.
    """
    _refuse(load, chosen, where, fitted)
    cells, faces = chosen.cells, chosen.nodes
    of_points = share.has_points[cells] & ~share.is_overlap[cells]
    corners = share.nodes[faces]
    areas = np.zeros(len(faces))
    nodal = np.zeros((len(share.nodes), 3))
    shares = np.zeros((len(faces), 4))
    for r, s in _FACE_POINTS:
        shape = (1 + _FACE_NODES[:, 0] * r) * (1 + _FACE_NODES[:, 1] * s) / 4
        along_r, along_s = np.zeros((len(faces), 3)), np.zeros((len(faces), 3))
        for a in range(4):
            along_r += _FACE_NODES[a, 0] * (1 + _FACE_NODES[a, 1] * s) / 4 * corners[:, a]
            along_s += _FACE_NODES[a, 1] * (1 + _FACE_NODES[a, 0] * r) / 4 * corners[:, a]
        normal = np.cross(along_r, along_s)
        area = np.sqrt(normal[:, 0] ** 2 + normal[:, 1] ** 2 + normal[:, 2] ** 2)
        areas += area
        shares += shape * area[:, None]
    units = share.units
    (whole,) = share.exact_sums([areas[share.is_owned[cells]]]).tolist()
    if load.traction is not None:
        traction = units.numbers(np.array(load.traction) / units.stress)
    else:
        traction = units.numbers(np.array(load.total) / units.force / whole)
    on_points = np.zeros((len(share.mesh.cells), 8, 3))
    if load.nodal == "equal":
        chosen_nodes = np.zeros(len(share.nodes), bool)
        chosen_nodes[faces] = True
        # a node on a mirror plane is shared with the other side
        part = np.where(chosen_nodes, 0.5 ** np.count_nonzero(share.plane_components, axis=1), 0.0)
        (parts,) = share.exact_sums([part[share.subdomain.owned_nodes]]).tolist()
        nodal[chosen_nodes] = part[chosen_nodes, None] * (traction * whole / parts)
    else:
        for a in range(4):
            np.add.at(nodal, faces[~of_points, a], shares[~of_points, a, None] * traction)
        shares_of_points = face_shares(share.mesh, share.nodes, cells[of_points], faces[of_points])
        on_points[cells[of_points]] = shares_of_points[:, :, None] * traction
    return nodal, on_points


def _refuse(load: Traction, chosen: ChosenFaces, where: str, fitted: bool) -> None:
    """Refuse faces that cannot take a traction: of peridynamic cells, or on a mirror plane.

    Raises
    ------
    SceneError
    """
    key, name = ("face", load.face) if load.set is None else ("set", load.set)
    shown = f"{where}.{key} = {name}"
    if chosen.on_points and (not fitted or (load.nodal == "equal" and chosen.on_free_points)):
        reason, remedy = "a traction gives no force (sec. 2.2)", f'Use kind = "body_force" with {key} = "{name}".'
        if fitted:
            reason, remedy = "there are no nodes to share it equally", 'Use nodal = "consistent".'
        raise SceneError(
            [f"{shown} has {chosen.on_points} of {chosen.total} faces on peridynamic cells, where {reason}. {remedy}"]
        )
    if chosen.on_mirrors:
        raise SceneError(
            [
                f"{shown} has {chosen.on_mirrors} of {chosen.total} faces on a mirror plane "
                "(mesh.symmetry), which lies inside of the whole body. Pull elsewhere, or remove the mirror."
            ]
        )
