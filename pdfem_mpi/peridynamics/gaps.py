"""Bonds stay inside of the body: none reaches across a notch, a hole or an inner corner."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pdfem_mpi.body.share import Share
from pdfem_mpi.kernels.families import cluster_balls
from pdfem_mpi.kernels.gap_cuts import cut_gaps, mark_faced
from pdfem_mpi.peridynamics.clusters import by_component
from pdfem_mpi.peridynamics.points import Points
from pdfem_mpi.peridynamics.rows import Rows

#: How far the surface is moved, dimension length in model units: along no direction of a lattice, far above round-off
#: and far below `gap_cuts.OUTSIDE`.
MOVED = 1e-8 * np.array([0.8191725134, 0.6710436067, 0.5497004779])
#: A face is flat, and two triangles, where its corners lie in one plane within this part of its edges.
FLAT = 1e-9
#: Bins of triangles, about.
MOST_BINS = 2**20


@dataclass(frozen=True)
class Gaps:
    """The surface of the body where bonds might cross it: triangles that have points in front of them.

    Attributes
    ----------
    corners : float64, shape (n, 9), dimension length
        Counter-clockwise as seen from outside; moved by ``MOVED``.
    planes, balls : float64, shape (n, 4)
        Outward unit normal and its product with a corner; centre and radius.
    lower, bin_size, bins, bin_start, bin_index
        Bins of their centres, as `kernels.gap_cuts.find_near` takes them.
    cutoff : float, dimension length
    """

    corners: np.ndarray
    planes: np.ndarray
    balls: np.ndarray
    lower: np.ndarray
    bin_size: float
    bins: np.ndarray
    bin_start: np.ndarray
    bin_index: np.ndarray
    cutoff: float

    @classmethod
    def of(cls, corners: np.ndarray, cutoff: float) -> Gaps:
        """Those of some triangles, (n, 3, 3)."""
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        size = np.sqrt((normal**2).sum(axis=1))
        corners, normal = corners[size > 0.0], normal[size > 0.0] / size[size > 0.0, None]
        centre = corners.mean(axis=1)
        radius = np.sqrt(((corners - centre[:, None]) ** 2).sum(axis=2).max(axis=1, initial=0.0))
        lower = centre.min(axis=0, initial=np.inf)
        extent = centre.max(axis=0, initial=-np.inf) - lower
        bin_size = max(cutoff, float((np.prod(np.maximum(extent, cutoff)) / MOST_BINS) ** (1 / 3)))
        bins = (extent / bin_size).astype(np.int64) + 1
        place = np.minimum(((centre - lower) / bin_size).astype(np.int64), bins - 1)
        flat = (place[:, 2] * bins[1] + place[:, 1]) * bins[0] + place[:, 0]
        order = np.argsort(flat, kind="stable")
        return cls(
            corners=np.ascontiguousarray(corners).reshape(-1, 9),
            planes=np.column_stack([normal, (normal * corners[:, 0]).sum(axis=1)]),
            balls=np.column_stack([centre, radius]),
            lower=lower,
            bin_size=bin_size,
            bins=bins,
            bin_start=np.searchsorted(flat[order], np.arange(int(bins.prod()) + 1)),
            bin_index=order,
            cutoff=cutoff,
        )

    @property
    def near(self) -> tuple:
        """What the kernels take to find triangles near a place, with a list that they overwrite."""
        found = np.zeros(len(self.balls) + 1, np.int64)
        found[-1] = self.balls[:, 3].argmax()
        return self.balls, self.lower, self.bin_size, self.bins, self.bin_start, self.bin_index, found

    def faced(self, points: Points) -> np.ndarray:
        """Triangles with a point in front of them, within the cutoff radius; bool, shape (n,)."""
        marked = np.zeros(len(self.balls), bool)
        mark_faced(points.x, *_balls_of(points), self.cutoff, self.planes, *self.near, marked)
        return marked

    def keep_apart(self, points: Points, rows: Rows, finite: bool, counts: np.ndarray) -> None:
        """Take out bonds that leave the body; ``counts`` of bonds by materials lose them."""
        cut_gaps(
            *rows.arrays, points.x, *_balls_of(points), self.cutoff, self.corners, self.planes, *self.near,
            points.material, finite, counts,
        )  # fmt: skip


def with_gaps(share: Share, points: Points) -> Points:
    """The points with the gaps between them, where the body's surface has points in front of it."""
    if not len(share.surface) or not points.n_clusters:
        return points
    x = by_component(points.x)
    low, high = x.min(axis=(0, 2)), x.max(axis=(0, 2))
    triangles = _triangles(_with_images(share, low, high)) - MOVED
    if not len(triangles):
        return points
    surface = Gaps.of(triangles, share.cutoff)
    faced = surface.faced(points)
    if not faced.any():
        return points
    return replace(points, gaps=Gaps.of(surface.corners[faced].reshape(-1, 3, 3), share.cutoff))


def _with_images(share: Share, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """The surface and its mirror images in a box; float64, shape (n, 4, 3), dimension length."""
    found = [share.surface]
    for sign, shift in zip(*share.reflections, strict=True):
        image = sign * share.surface + shift
        found.append(image if sign.prod() > 0.0 else image[:, ::-1])  # a mirror turns a face around
    faces = np.concatenate(found)
    return faces[((faces.max(axis=1) >= low) & (faces.min(axis=1) <= high)).all(axis=1)]


def _triangles(faces: np.ndarray) -> np.ndarray:
    """Flat faces as two triangles, others as four around their middle; float64, shape (n, 3, 3).

    Neighbours share straight edges, and the middle is where the face of a hexahedron has it, so that the triangles do
    not depend on the numbering.
    """
    a, b, c, d = faces.swapaxes(0, 1)
    across, up = c - a, d - b
    height = np.abs((np.cross(across, up) * (b - a)).sum(axis=1))
    size = np.sqrt((across**2).sum(axis=1) * (up**2).sum(axis=1))
    flat = height <= FLAT * size * np.sqrt(size)
    a, b, c, d = (corner[flat] for corner in (a, b, c, d))
    found = [np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)]
    bent = faces[~flat]
    middle = bent.mean(axis=1)
    found += [np.stack([bent[:, k], bent[:, (k + 1) % 4], middle], axis=1) for k in range(4)]
    return np.concatenate(found)


def _balls_of(points: Points) -> tuple[np.ndarray, np.ndarray]:
    """Centres and radii of the clusters, as `kernels.families` has them."""
    centre, radius = np.empty((points.n_clusters, 3)), np.empty(points.n_clusters)
    cluster_balls(points.x, centre, radius)
    return centre, radius
