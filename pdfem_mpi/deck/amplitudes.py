"""Load factors over a pseudo-time: load, unload, reload, cycle."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

from pdfem_mpi.deck.table import Problem, show


def amplitude_problems(times: Sequence[float], load_factors: Sequence[float]) -> list[Problem]:
    """Times that strictly rise from 0, with a load factor at each."""
    if len(times) != len(load_factors):
        counts = f"has {len(times)} numbers, and load_factors has {len(load_factors)}"
        return [Problem("times", f"= {show(tuple(times))} {counts}. Give a load factor at each time.")]
    for before, after in itertools.pairwise((0.0, *times)):
        if not after > before:
            order = f"has {show(after)} after {show(before)}, but must strictly rise from 0"
            return [Problem("times", f"= {show(tuple(times))} {order}. Use a number above {show(before)}.")]
    return []


def between(times: Sequence[float], load_factors: Sequence[float], increments: int) -> list[tuple[float, float]]:
    """Times and load factors on the straight lines from (0, 0) through the table, ``increments`` to each part."""
    rows = [(0.0, 0.0), *zip(times, load_factors, strict=True)]
    found = []
    for (t, a), (later, b) in itertools.pairwise(rows):
        found += [(t + (later - t) * k / increments, a + (b - a) * k / increments) for k in range(1, increments)]
        found.append((later, b))
    return found


def through_nothing(times: Sequence[float], load_factors: Sequence[float]) -> list[tuple[float, float, bool]]:
    """Times and load factors of the table, and of where the straight lines between them pass 0 (False)."""
    found: list[tuple[float, float, bool]] = []
    before = (0.0, 0.0)
    for time, factor in zip(times, load_factors, strict=True):
        if before[1] * factor < 0.0:
            share = before[1] / (before[1] - factor)
            found.append((before[0] + share * (time - before[0]), 0.0, False))
        found.append((time, factor, True))
        before = time, factor
    return found
