"""Vectors of a deck that say a direction, whatever their length."""

from __future__ import annotations

import math
from collections.abc import Sequence

from pdfem_mpi.deck.table import Problem, Vector, show


def no_direction(name: str, vector: Vector) -> list[Problem]:
    """What is wrong with a vector that should point somewhere."""
    if any(vector):
        return []
    return [Problem(name, f"= {show(vector)} has no direction. Give a vector of any length but 0.")]


def unit(vector: Sequence[float]) -> Vector:
    """The vector over its length."""
    largest = max(map(abs, vector))
    scaled = [c / largest for c in vector]  # else squares of small numbers vanish
    length = math.hypot(*scaled)
    return scaled[0] / length, scaled[1] / length, scaled[2] / length


def frame(normal: Vector) -> tuple[Vector, Vector]:
    """Two unit vectors normal to a vector and to each other."""
    n = unit(normal)
    least = min(range(3), key=lambda d: abs(n[d]))
    one = unit(cross(n, tuple(float(d == least) for d in range(3))))
    return one, cross(n, one)


def cross(a: Sequence[float], b: Sequence[float]) -> Vector:
    """The vector product."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]
