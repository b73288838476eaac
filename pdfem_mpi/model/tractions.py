"""Tractions on faces of the mesh, as forces on nodes and on the points of free cells."""

from __future__ import annotations

import math

import numpy as np

from pdfem_mpi.body.discretization import Discretization
from pdfem_mpi.deck.loads import Traction
from pdfem_mpi.deck.table import SceneError
from pdfem_mpi.mesh import named_sets
from pdfem_mpi.peridynamics.fit.areas import face_shares

_FACE_POINTS = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) / math.sqrt(3.0)
_FACE_NODES = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])


def traction_forces(
    discretization: Discretization, load: Traction, where: str, fitted: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Forces of a traction: on nodes (n_mesh_nodes, 3), and on the points of free cells (n_cells, 8, 3); model units.

    Points take ``int L_i dA`` of their cell's face, as in the equilibrium that fitted bond factors are made for.
    """
    if load.set is None:
        (cells, faces), key, name = discretization.mesh.faces_on_face(load.face), "face", load.face
    else:
        (cells, faces), key, name = named_sets.faces_of(discretization.mesh, load, where), "set", load.set
    of_points = _loadable(discretization, load, f"{where}.{key} = {name}", (cells, faces), fitted)
    corners = discretization.nodes[faces]
    areas = np.zeros(len(faces))
    nodal = np.zeros((len(discretization.nodes), 3))
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
    units = discretization.units
    whole = math.fsum(areas)
    if load.traction is not None:
        traction = units.numbers(np.array(load.traction) / units.stress)
    else:
        traction = units.numbers(np.array(load.total) / units.force / whole)
    on_points = np.zeros((len(discretization.mesh.cells), 8, 3))
    if load.nodal == "equal":
        nodes = np.unique(faces)
        # a node on a mirror plane is shared with the other side
        share = 0.5 ** np.count_nonzero(discretization.plane_components[nodes], axis=1)
        nodal[nodes] = share[:, None] * (traction * whole / share.sum())
    else:
        for a in range(4):
            np.add.at(nodal, faces[~of_points, a], shares[~of_points, a, None] * traction)
        mesh = discretization.mesh
        shares_of_points = face_shares(mesh, discretization.nodes, cells[of_points], faces[of_points])
        on_points[cells[of_points]] = shares_of_points[:, :, None] * traction
    return nodal, on_points


def _loadable(
    discretization: Discretization, load: Traction, shown: str, chosen: tuple[np.ndarray, np.ndarray], fitted: bool
) -> np.ndarray:
    """Which of the chosen faces belong to cells with free points; bool, shape (n_faces,).

    Parameters
    ----------
    shown : str
        The load's selection, for messages.
    chosen : tuple
        Cells of the faces, (n_faces,), and their nodes, (n_faces, 4).

    Raises
    ------
    SceneError
        Faces that cannot take a traction: of peridynamic cells, or on a mirror plane.
    """
    cells, faces = chosen
    key, name = ("face", load.face) if load.set is None else ("set", load.set)
    of_points = discretization.has_points[cells] & ~discretization.is_overlap[cells]
    if discretization.has_points[cells].any() and (not fitted or (load.nodal == "equal" and of_points.any())):
        count = np.count_nonzero(discretization.has_points[cells])
        reason, remedy = "a traction gives no force (sec. 2.2)", f'Use kind = "body_force" with {key} = "{name}".'
        if fitted:
            reason, remedy = "there are no nodes to share it equally", 'Use nodal = "consistent".'
        raise SceneError([f"{shown} has {count} of {len(cells)} faces on peridynamic cells, where {reason}. {remedy}"])
    corners = discretization.nodes[faces]
    flat = np.ptp(corners, axis=1) <= discretization.mesh.tolerance / discretization.units.length
    mirrored = (flat & discretization.plane_components[faces].all(axis=1)).any(axis=1)
    if mirrored.any():
        raise SceneError(
            [
                f"{shown} has {np.count_nonzero(mirrored)} of {len(faces)} faces on a mirror plane "
                "(mesh.symmetry), which lies inside of the whole body. Pull elsewhere, or remove the mirror."
            ]
        )
    return of_points
