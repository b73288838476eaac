"""Which of two ranks has a bond between them: the one whose cell lies deeper, so that ghosts are few.

The depth of a cell is its distance from the nearest cell of the other rank. A bond belongs to the deeper of its two
cells: a rank then needs those cells of another that lie near to it, about half of those within the cutoff radius, and
the two have about as many of their bonds each. The owner of a cell works its depths out and tells them to the others,
so that both ranks compare the same numbers; which of them adds a force changes no bit of it. Where two ranks have few
bonds with each other, one of them has all (`few_bonds`).

A bond across a mirror plane has two names, by either of its ends and the image of the other. Numbers of cells decide
between them, so that broken bonds have the same names on any number of ranks.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pdfem_mpi.body.near_places import nearest_distances
from pdfem_mpi.body.share import Share
from pdfem_mpi.peridynamics.few_bonds import settled
from pdfem_mpi.peridynamics.images import MirroredHalo
from pdfem_mpi.peridynamics.points import Depths, Points, make_points
from pdfem_mpi.peridynamics.rows import boundary_rows, rows_at_cells


def with_needed_ghosts(share: Share, comm, finite: bool) -> tuple[Share, Points]:
    """The rank's points with those ghosts that bonds of the rank reach, and the share with the same. Collective.

    Parameters
    ----------
    finite : bool
        Kinematics of the bonds.
    """
    points = make_points(share, comm)
    if comm.size == 1:
        return share, points
    points = replace(points, depths=_depths(points, share.cutoff))
    subdomain, n_real = share.subdomain, points.n_owned + len(share.subdomain.ghosts)
    needed = np.zeros(len(points.cell_number), bool)
    needed[: points.n_owned] = True
    n_rows = rows_at_cells(points, boundary_rows(points, share.cutoff, finite))
    if one_sided := settled(points, comm, n_rows):
        points = one_sided
        n_rows = rows_at_cells(points, boundary_rows(points, share.cutoff, finite))
    needed[n_rows > 0] = True
    if points.images:
        needed[points.images.source[needed[n_real:]]] = True
    ghosts, images = needed[points.n_owned : n_real], needed[n_real:]
    fewer = replace(
        subdomain,
        ghosts=subdomain.ghosts[ghosts],
        ghost_owner=subdomain.ghost_owner[ghosts],
        images=subdomain.images[images],
        reflection=subdomain.reflection[images],
    )
    share = replace(share, subdomain=fewer)
    depths = Depths(points.depths.neighbour[needed], points.depths.depth[needed])
    return share, replace(make_points(share, comm), depths=depths)


def _depths(points: Points, cutoff: float) -> Depths:
    """Distances of owned cells and ghosts from the nearest cell of the other rank. Collective."""
    halo = points.halo.halo if isinstance(points.halo, MirroredHalo) else points.halo
    centres = points.x.reshape(-1, 2, 3, 4).mean(axis=(1, 3))
    n_cells, n_real = len(points.cell_number), halo.n_owned + halo.n_ghost
    neighbour, depth = np.full(n_cells, -1), np.zeros((n_cells, len(halo.neighbours)))
    told = []
    for k, (lent, ghosts) in enumerate(halo.shared()):
        if len(lent) and len(ghosts):
            depth[lent, k] = nearest_distances(centres[ghosts], centres[lent], cutoff)
        neighbour[ghosts] = k
        told.append(depth[lent, k])
    ghosts = np.arange(halo.n_owned, n_real)
    depth[ghosts, neighbour[ghosts]] = halo.swap(told)
    return Depths(neighbour, depth)
