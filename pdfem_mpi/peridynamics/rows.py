"""Rows: a point against a cluster of four, as half of a list of neighbours; their search."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pdfem_mpi.kernels import families
from pdfem_mpi.kernels.simd import W
from pdfem_mpi.peridynamics.points import Points

#: Rows that are found before they are put by.
ROOM = 2**18


@dataclass(frozen=True)
class Rows:
    """Half-list rows: one point against one cluster of four points (see kernels/families.py)."""

    start: np.ndarray
    offset: np.ndarray
    data: np.ndarray

    @property
    def arrays(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """What the kernels take."""
        return self.start, self.offset, self.data


def find_bonds(points: Points, cutoff: float, finite: bool) -> tuple[Rows, Rows]:
    """Search the families of the owned points and allocate their rows.

    Without ghosts and images nothing is searched among them.

    Returns
    -------
    interior, boundary : Rows
        With offsets, and stored numbers still 0.
    """
    interior, boundary = _search(points, cutoff, finite, (False, True))
    return interior, boundary


def boundary_rows(points: Points, cutoff: float, finite: bool) -> Rows:
    """The second of `find_bonds` alone."""
    return _search(points, cutoff, finite, (True,))[0]


def rows_at_cells(points: Points, rows: Rows) -> np.ndarray:
    """How many rows point at each local cell; int64, shape (n_cells,)."""
    of_points, at_clusters = np.zeros(len(rows.start) - 1, np.int64), np.zeros(points.n_clusters, np.int64)
    families.count_rows(rows.start, rows.offset, of_points, at_clusters)
    return at_clusters.reshape(-1, 2).sum(axis=1)


def _search(points: Points, cutoff: float, finite: bool, kinds: tuple[bool, ...]) -> list[Rows]:
    """Rows of the owned points against each other (False), against ghosts and images (True)."""
    n_clusters = points.n_clusters
    centre, radius = np.empty((n_clusters, 3)), np.empty(n_clusters)
    families.cluster_balls(points.x, centre, radius)
    lower = centre.min(axis=0) if n_clusters else np.zeros(3)
    extent = (centre.max(axis=0) if n_clusters else np.zeros(3)) - lower
    bin_size = max(0.5 * cutoff, float((max(np.prod(np.maximum(extent, cutoff)), 1e-300) / 2**22) ** (1 / 3)))
    bins = (extent / bin_size).astype(np.int64) + 1
    place = np.minimum(((centre - lower) / bin_size).astype(np.int64), bins - 1)
    flat = (place[:, 2] * bins[1] + place[:, 1]) * bins[0] + place[:, 0]
    bin_index = np.argsort(flat, kind="stable")
    bin_start = np.searchsorted(flat[bin_index], np.arange(int(bins.prod()) + 1))

    n_owned, n_cells = 2 * points.n_owned, len(points.cell_number)
    depths = np.full(n_cells, -1), np.zeros((n_cells, 0))
    if points.depths:
        depths = points.depths.neighbour, points.depths.depth
    found = []
    for ghosts in kinds:
        if ghosts and n_clusters == n_owned:
            start, offset = np.zeros(1, np.int64), np.zeros(1, np.uint32)
            found.append(Rows(start, offset, np.zeros(2 * W if finite else W, np.float32)))
            break
        start = np.zeros(W * n_owned + 1, np.int64)
        search = (
            points.x, n_owned, ghosts, points.cell_number, *depths, centre, radius, cutoff, lower, bin_size, bins,
            bin_start, bin_index, start,
        )  # fmt: skip
        room, candidates = np.empty(ROOM, np.uint32), np.empty(n_clusters, np.int64)
        parts, first = [], 0
        while first < n_owned:
            last = families.find_rows(first, n_owned, *search, room, candidates)
            parts.append(room[: start[W * last] - start[W * first]].copy())
            if last == first:  # not even one cluster's rows had room
                room = np.empty(2 * len(room), np.uint32)
            first = last
        padding = np.zeros(1, np.uint32)  # one row: the sweeps read one row ahead
        offset = np.concatenate([*parts, padding])
        found.append(Rows(start, offset, np.zeros(len(offset) * (2 * W if finite else W), np.float32)))
    return found


def within_bodies(points: Points, rows: Rows, finite: bool) -> Rows:
    """The rows of points against clusters of their own body."""
    n = np.diff(rows.start)
    own, other = np.repeat(np.arange(len(n)) // (2 * W), n), rows.offset[:-1] // np.uint32(2 * 9 * W)
    keep = points.body[own] == points.body[other]
    start = np.concatenate([[0], np.cumsum(keep)])[rows.start]
    offset = np.append(rows.offset[:-1][keep], np.uint32(0))
    return Rows(start, offset, np.zeros(len(offset) * (2 * W if finite else W), np.float32))
