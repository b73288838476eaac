"""Initial cracks: polygons, or what stands for a shape as one, cut the bonds across them."""

from __future__ import annotations

import numpy as np

from pdfem_mpi.body.share import Share
from pdfem_mpi.deck.cracks import AnyCrack
from pdfem_mpi.deck.peridynamics import polygon_normal
from pdfem_mpi.kernels.bond_cuts import cut_rows
from pdfem_mpi.parallel.comm import sum_integers
from pdfem_mpi.peridynamics.bonds import Bonds
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
    across, up = np.sort(np.argsort(np.abs(normal), kind="stable")[:2])
    cut = sum(
        cut_rows(*rows.arrays, points.x, polygon, normal, int(across), int(up), bonds.finite) for rows in bonds.rows
    )
    return int(sum_integers(comm, np.array([cut]))[0])
