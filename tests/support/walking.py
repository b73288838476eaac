"""All arrays that objects hold, by the way that leads to them."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping

import numpy as np

from pdfem_mpi.runs.array_bytes import _inside


def entries_by_path(**things) -> dict[str, int]:
    """Entries of the largest array at each path of attribute names and keys; elements of sequences are one path."""
    found: dict[str, int] = {}
    visited: dict[int, object] = {}  # kept alive, so that no number is given again
    left = deque(things.items())
    while left:
        path, thing = left.popleft()
        if isinstance(thing, np.ndarray):
            while isinstance(thing.base, np.ndarray):
                thing = thing.base
            found[path] = max(found.get(path, 0), thing.size)
        elif id(thing) not in visited:
            visited[id(thing)] = thing
            left.extend(_named(path, thing))
    return found


def _named(path, thing):
    if isinstance(thing, Mapping):
        return [(f"{path}[{key}]" if isinstance(key, str) else f"{path}[]", value) for key, value in thing.items()]
    inside = _inside(thing)
    if inside is None:
        return []
    if hasattr(thing, "__dict__") and len(inside) == 1 and next(iter(inside)) is vars(thing):
        return [(f"{path}.{name}", value) for name, value in vars(thing).items()]
    return [(f"{path}[]", value) for value in inside]
