"""Corners of a polygon in order: whether its edges cross each other, as those of a bow tie do."""

from __future__ import annotations

import math
from collections.abc import Sequence

from pdfem_mpi.deck.directions import cross
from pdfem_mpi.deck.table import Pair, Problem, Vector, show

#: Corners nearer to an edge than this part of the polygon's size lie on it: a seam that is gone along twice is none.
ON_EDGE = 1e-9


def crossing_problems(corners: Sequence[Pair] | Sequence[Vector]) -> list[Problem]:
    """A sentence about two edges that cross, of a polygon in a plane or in space."""
    flat = [tuple(corner) for corner in corners] if len(corners[0]) == 2 else _in_plane(corners)
    found = crossing_edges(flat) if flat else None
    if found is None:
        return []
    one, two = (f"from {show(corners[k])} to {show(corners[(k + 1) % len(corners)])}" for k in found)
    text = f"has edges that cross: the one {one}, and the one {two}. Give the corners in the order of its outline."
    return [Problem("polygon", text)]


def crossing_edges(corners: Sequence[Pair]) -> tuple[int, int] | None:
    """Numbers of the first corners of two edges that pass through each other; None where none do.

    Edges that touch, at corners or along each other, do not.
    """
    size = max(abs(c - o) for corner in corners for c, o in zip(corner, corners[0], strict=True))
    ends = list(zip(corners, (*corners[1:], corners[0]), strict=True))
    order = sorted(range(len(ends)), key=lambda k: min(ends[k][0][0], ends[k][1][0]))
    crossing = []
    for place, first in enumerate(order):
        a, b = ends[first]
        last, low, high = max(a[0], b[0]), min(a[1], b[1]), max(a[1], b[1])
        for second in order[place + 1 :]:
            c, d = ends[second]
            if min(c[0], d[0]) > last:
                break
            if max(c[1], d[1]) < low or min(c[1], d[1]) > high:
                continue
            if _passes(a, b, c, d, ON_EDGE * size) and _passes(c, d, a, b, ON_EDGE * size):
                crossing.append((min(first, second), max(first, second)))
    return min(crossing, default=None)


def _passes(a: Pair, b: Pair, c: Pair, d: Pair, least: float) -> bool:
    """Whether c and d lie on both sides of the line through a and b, farther from it than ``least``."""
    along, across = b[0] - a[0], b[1] - a[1]
    length = math.hypot(along, across)
    one, other = (along * (p[1] - a[1]) - across * (p[0] - a[0]) for p in (c, d))
    return min(one, other) < -least * length and max(one, other) > least * length


def _in_plane(corners: Sequence[Vector]) -> list[Pair]:
    """Two coordinates of the corners, with which the polygon does not vanish; empty for those on a line."""
    offsets = [tuple(c - o for c, o in zip(corner, corners[0], strict=True)) for corner in corners]
    far = max(offsets, key=lambda offset: math.hypot(*offset))
    normal = max((cross(far, offset) for offset in offsets), key=lambda vector: math.hypot(*vector))
    if not any(normal):
        return []
    dropped = max(range(3), key=lambda d: abs(normal[d]))
    kept = [d for d in range(3) if d != dropped]
    return [(offset[kept[0]], offset[kept[1]]) for offset in offsets]
