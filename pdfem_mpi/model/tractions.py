"""Tractions on faces of the mesh, as forces on nodes and on the points of free cells."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from pdfem_mpi.body.areas import face_shares, face_vectors
from pdfem_mpi.body.selection import ChosenFaces
from pdfem_mpi.body.share import Share
from pdfem_mpi.deck.loads import Pressure, Traction
from pdfem_mpi.deck.table import SceneError
from pdfem_mpi.kernels.dense import lengths

#: Faces are flat whose normals turn by less than this; they keep one normal.
FLAT = 1e-10
_FACE_POINTS = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) / math.sqrt(3.0)
_FACE_NODES = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])


@dataclass(frozen=True)
class _Faces:
    """Integrals over faces, by 2 x 2 Gauss points; model units.

    Attributes
    ----------
    areas : float64, shape (n_faces,), dimension length^2
    shares : float64, shape (n_faces, 4), dimension length^2
        ``int N_a dA`` of its nodes.
    normals, vectors : float64, shapes (n_faces, 3), (n_faces, 4, 3), dimension length^2
        ``int n dA`` and ``int N_a n dA``.
    flat : bool, shape (n_faces,)
    """

    areas: np.ndarray
    shares: np.ndarray
    normals: np.ndarray
    vectors: np.ndarray
    flat: np.ndarray


def _integrate(corners: np.ndarray) -> _Faces:
    """The integrals over faces with some corners, float64, shape (n_faces, 4, 3)."""
    n = len(corners)
    areas, shares, normals, vectors = np.zeros(n), np.zeros((n, 4)), np.zeros((n, 3)), np.zeros((n, 4, 3))
    at_points = []
    for r, s in _FACE_POINTS:
        shape = (1 + _FACE_NODES[:, 0] * r) * (1 + _FACE_NODES[:, 1] * s) / 4
        along_r, along_s = np.zeros((n, 3)), np.zeros((n, 3))
        for a in range(4):
            along_r += _FACE_NODES[a, 0] * (1 + _FACE_NODES[a, 1] * s) / 4 * corners[:, a]
            along_s += _FACE_NODES[a, 1] * (1 + _FACE_NODES[a, 0] * r) / 4 * corners[:, a]
        normal = np.cross(along_r, along_s)
        area = lengths(normal)
        areas += area
        normals += normal
        shares += shape * area[:, None]
        vectors += shape[:, None] * normal[:, None, :]
        at_points.append(normal)
    flat = np.ones(n, bool)
    for normal in at_points:
        turned = np.cross(normal, normals)
        flat &= (turned**2).sum(axis=1) <= (FLAT * (normals**2).sum(axis=1)) ** 2
    return _Faces(areas, shares, normals, vectors, flat)


def traction_forces(share: Share, load: Traction | Pressure, chosen: ChosenFaces, where: str):
    """Forces of a load on nodes (n_nodes, 3), and on the points of free cells (n_cells, 8, 3). Collective.

    In model units, and whole at the nodes and cells that the rank owns: terms come in the order of the mesh, those of
    other ranks' faces at the node among them. Points take ``int L_i dA`` of their cell's face, as in the equilibrium
    that fitted bond factors are made for; of a face that is not flat, in proportion, so much that it has its area. A
    pressure acts along the normal at each place of a face, so that it closes on closed surfaces.

    Raises
    ------
    SceneError
        On all ranks: faces that cannot take a traction.
    """
    _refuse(load, chosen, where)
    cells, faces = chosen.cells, chosen.nodes
    of_points = share.has_points[cells] & ~share.is_overlap[cells]
    found = _integrate(share.nodes[faces])
    size = lengths(found.normals)
    units, pressure = share.units, None
    (whole,) = share.exact_sums([found.areas[share.is_owned[cells]]]).tolist()
    if isinstance(load, Pressure):
        pressure = -units.numbers(load.pressure / units.stress)
        traction = found.normals * (pressure / size)[:, None]
    elif load.traction is not None:
        traction = units.numbers(np.array(load.traction) / units.stress)
    else:
        traction = units.numbers(np.array(load.total) / units.force / whole)
    nodal, on_points = np.zeros((len(share.nodes), 3)), np.zeros((len(share.mesh.cells), 8, 3))
    if isinstance(load, Traction) and load.nodal == "equal":
        chosen_nodes = np.zeros(len(share.nodes), bool)
        chosen_nodes[faces] = True
        # a node on a mirror plane is shared with the other side
        part = np.where(chosen_nodes, np.ldexp(1.0, -np.count_nonzero(share.plane_components, axis=1)), 0.0)
        (parts,) = share.exact_sums([part[share.subdomain.owned_nodes]]).tolist()
        nodal[chosen_nodes] = part[chosen_nodes, None] * (traction * whole / parts)
        return nodal, on_points
    of_faces = np.broadcast_to(traction, (len(faces), 3))
    on_corners = found.shares[:, :, None] * of_faces[:, None]
    if pressure is not None:
        on_corners[~found.flat] = pressure * found.vectors[~found.flat]
    for a in range(4):
        np.add.at(nodal, faces[~of_points, a], on_corners[~of_points, a])
    shares = face_shares(share.mesh, share.nodes, cells[of_points], faces[of_points])
    on_eight, bent = shares[:, :, None] * of_faces[of_points, None], of_points & ~found.flat
    if pressure is None:
        on_eight[bent[of_points]] *= (found.areas[bent] / size[bent])[:, None, None]
    else:
        on_eight[bent[of_points]] = pressure * face_vectors(share.mesh, share.nodes, cells[bent], faces[bent])
    np.add.at(on_points, cells[of_points], on_eight)
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
