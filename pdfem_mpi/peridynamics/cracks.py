"""Initial cracks: polygons, or what stands for a shape as one, cut the bonds across them."""

from __future__ import annotations

import numpy as np

from pdfem_mpi.body.share import Share
from pdfem_mpi.deck.cracks import AnyCrack
from pdfem_mpi.deck.peridynamics import polygon_normal
from pdfem_mpi.kernels.bond_cuts import cut_rows
from pdfem_mpi.kernels.dense import lengths
from pdfem_mpi.parallel.comm import sum_integers
from pdfem_mpi.peridynamics.bonds import Bonds
from pdfem_mpi.peridynamics.clusters import by_component
from pdfem_mpi.peridynamics.points import Points


def cut_crack(share: Share, comm, points: Points, bonds: Bonds, crack: AnyCrack) -> int:
    """Cut the bonds that cross a crack of the deck or one of its mirror images; their number. Collective."""
    units = share.units
    polygon = crack.corners(*((corner * units.length + units.origin).tolist() for corner in (share.lower, share.upper)))
    corners = units.places(np.array(polygon))
    normal = np.array(polygon_normal(polygon)[0])
    reach = np.array([[-1.0], [1.0]]) * share.cutoff
    body = np.array([share.lower, share.upper]) + reach
    box = np.array([corners.min(axis=0), corners.max(axis=0)])
    cut = cut_bonds(comm, points, bonds, corners, normal)
    for sign, shift in zip(*share.mirrors.reflections(box, body), strict=True):
        cut += cut_bonds(comm, points, bonds, sign * corners + shift, sign * normal)
    return cut


def cut_faces(share: Share, points: Points, bonds: Bonds) -> None:
    """Cut the bonds of this rank that cross a face of the mesh's own crack, or its image, each as two triangles."""
    if not len(share.doubled) or not points.n_clusters:
        return
    x = by_component(points.x)
    low, high = x.min(axis=(0, 2)), x.max(axis=(0, 2))
    for face in share.doubled:
        box = np.array([face.min(axis=0), face.max(axis=0)])
        body = np.array([low, high])
        images = [(np.ones(3), np.zeros(3)), *zip(*share.mirrors.reflections(box, body), strict=True)]
        for sign, shift in images:
            corners = sign * face + shift
            if (corners.max(axis=0) < low).any() or (corners.min(axis=0) > high).any():
                continue
            for triangle in (corners[[0, 1, 2]], corners[[0, 2, 3]]):
                normal = np.cross(triangle[1] - triangle[0], triangle[2] - triangle[0])
                _cut(points, bonds, np.ascontiguousarray(triangle), normal / lengths(normal))


def cut_bonds(comm, points: Points, bonds: Bonds, polygon: np.ndarray, normal: np.ndarray) -> int:
    """Cut the bonds that cross a plane polygon. Collective.

    Parameters
    ----------
    polygon : float64, shape (n_corners, 3), dimension length
    normal : float64, shape (3,)

    Returns
    -------
    int
        Bonds cut on all ranks.
    """
    return int(sum_integers(comm, np.array([_cut(points, bonds, polygon, normal)]))[0])


def _cut(points: Points, bonds: Bonds, polygon: np.ndarray, normal: np.ndarray) -> int:
    """Cut this rank's bonds; how many."""
    across, up = np.sort(np.argsort(np.abs(normal), kind="stable")[:2])
    return sum(
        cut_rows(*rows.arrays, points.x, polygon, normal, int(across), int(up), bonds.finite) for rows in bonds.rows
    )
