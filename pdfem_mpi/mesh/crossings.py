"""Which straight lines pass through a plane polygon."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pdfem_mpi.deck.peridynamics import polygon_normal
from pdfem_mpi.deck.table import Vector
from pdfem_mpi.kernels.dense import product


def cross_polygon(polygon: Sequence[Vector], start: np.ndarray, stop: np.ndarray) -> np.ndarray:
    """Whether straight lines pass through a polygon or end on it; bool, shape (n,).

    Parameters
    ----------
    polygon : points, dimension length
        Corners in order of a simple polygon, convex or not.
    start, stop : float64, shape (n, 3), dimension length
    """
    normal, corners = np.array(polygon_normal(polygon)[0]), np.array(polygon)
    before, after = product(start - corners[0], normal), product(stop - corners[0], normal)
    whole = np.abs(before) + np.abs(after)
    crosses = (before * after <= 0.0) & (whole > 0.0)
    share = np.abs(before) / np.where(whole > 0.0, whole, 1.0)
    seen = np.sort(np.argsort(np.abs(normal), kind="stable")[:2])
    p, q = (start + share[:, None] * (stop - start))[:, seen].T
    inside = np.zeros(len(start), bool)
    for (a, b), (c, d) in zip(corners[:, seen], np.roll(corners[:, seen], 1, axis=0), strict=True):
        between = (b > q) != (d > q)
        inside ^= between & (p < a + (c - a) / (d - b if d != b else 1.0) * (q - b))
    return crosses & inside
