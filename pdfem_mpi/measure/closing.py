"""Crack faces that close: whether what bonds parted from comes nearer to itself than it was at rest.

Broken bonds give no force in compression either, so faces that close pass through each other. Bonds across a face
between two neighbouring cells, and between neighbouring points of one, lie along its normal: where such a broken bond
is shorter than at rest, the faces are in each other.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pdfem_mpi.body.share import Share
from pdfem_mpi.model.forces import Forces
from pdfem_mpi.parallel.comm import agree, largest
from pdfem_mpi.peridynamics.clusters import point_rows
from pdfem_mpi.peridynamics.failure import Failure, local_points

#: Bonds up to this many edges of a cell long face each other: the neighbouring points of a cube are 0.42 and 0.58 of
#: its edge apart, the next 0.72.
FACING = 0.6
#: Told are faces that come nearer by more than this fraction of the stretch at which their bonds broke.
TOLD = 0.1


@dataclass(frozen=True)
class Closing:
    """The faces that are deepest in each other; the same on all ranks.

    Attributes
    ----------
    depth : float, dimension 1
        By how much they are nearer than at rest, of their distance; 0 where none are by more than `TOLD`.
    place : str
        Between them at rest, in the deck's units.
    """

    depth: float
    place: str

    @property
    def warning(self) -> str:
        """A sentence for the user; empty where nothing closes."""
        if not self.depth:
            return ""
        return (
            f"warning: crack faces overlap: points that bonds broke between are nearer than at rest, by up to "
            f"{100.0 * self.depth:.3g} % of their distance about {self.place}. Faces that close are not in contact: "
            "the body is too soft where it closes cracks."
        )


def measure_closing(share: Share, forces: Forces, failure: Failure) -> Closing:
    """How deep the faces of broken bonds are in each other at the forces' last evaluation. Collective."""
    points, of_bonds = forces.model.points, forces.of_bonds
    listed = failure.broken_pairs()
    pairs, place = local_points(points, listed[:, :2])
    x = point_rows(points.x)
    u = point_rows(np.ascontiguousarray(of_bonds.S[:, 0:3]).reshape(-1))
    xi, eta = (rows[pairs[:, 1]] - rows[pairs[:, 0]] for rows in (x, u))
    square, work = (xi**2).sum(axis=1), (eta * xi).sum(axis=1)
    stretch = work / np.maximum(square, 1e-300)
    if forces.model.finite:
        stretch = np.sqrt(((xi + eta) ** 2).sum(axis=1) / np.maximum(square, 1e-300)) - 1.0
    one, other = (failure.class_of[pairs[:, end] // 4] for end in (0, 1))
    told = (square <= (FACING * share.typical_edge) ** 2) & (stretch < -TOLD * failure.stretch[one, other])
    if softened := getattr(failure, "softened", None):  # those that still hold are booked with the broken ones
        told &= listed[place, 2] >= softened.laws.teeth[softened.law_of[one, other]]
    depth = float(largest(share.comm, np.array([(-stretch[told]).max(initial=0.0)]))[0])
    texts = []
    if depth:
        deepest = pairs[told & (-stretch == depth)]
        middles = 0.5 * (x[deepest[:, 0]] + x[deepest[:, 1]]) * share.units.length + share.units.origin
        texts = [f"({', '.join(f'{c:.6g}' for c in middle)})" for middle in middles]
    return Closing(depth, min(agree(share.comm, sorted(texts)[:1]), default=""))
