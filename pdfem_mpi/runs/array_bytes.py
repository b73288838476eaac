"""Bytes of the arrays that objects hold, found by walking them: arrays that no list names are counted too.

A buffer counts once, whoever else refers to it, and whole, however small the view of it that is held. Pages that were
asked for and never written are counted here and are not in memory: the sum is what the program asked for.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Mapping
from functools import partial
from types import FunctionType, MethodType
from typing import Any

import numpy as np

#: Objects of these packages are walked by their attributes.
WALKED = ("pdfem_mpi.", "scipy.sparse.")


class Count:
    """Counts arrays, each buffer once over all calls: parts that are asked for first take what they share.

    It knows buffers by their addresses: what it counted must live as long as it does.

    Attributes
    ----------
    total : int
        Bytes counted so far.
    """

    def __init__(self):
        self.total = 0
        self._buffers: dict[int, int] = {}  # bytes by address
        self._visited: dict[int, Any] = {}  # kept alive, so that no number is given again

    def bytes_of(self, *things: Any) -> int:
        """Bytes of all arrays that the objects hold, and that were not counted before."""
        before = self.total
        left = deque(things)
        while left:
            thing = left.popleft()
            if isinstance(thing, np.ndarray):
                self._add(thing)
            elif id(thing) not in self._visited:
                inside = _inside(thing)
                if inside is not None:
                    self._visited[id(thing)] = thing
                    left.extend(inside)
        return self.total - before

    def copy(self) -> Count:
        """One that goes on from here, for things that do not live long."""
        other = Count()
        other.total, other._buffers, other._visited = self.total, dict(self._buffers), dict(self._visited)
        return other

    def _add(self, array: np.ndarray) -> None:
        while isinstance(array.base, np.ndarray):
            array = array.base
        if not array.nbytes:
            return
        address = array.__array_interface__["data"][0]
        more = array.nbytes - self._buffers.get(address, 0)
        if more > 0:
            self._buffers[address] = array.nbytes
            self.total += more


def _inside(thing: Any) -> Iterable[Any] | None:
    """What an object refers to, as far as it may hold arrays; None for one that holds none."""
    if isinstance(thing, Mapping):
        return thing.values()
    if isinstance(thing, list | tuple | set | frozenset | deque):
        return thing
    if isinstance(thing, partial):
        return (thing.func, thing.args, thing.keywords)
    if isinstance(thing, MethodType):
        return (thing.__self__,)
    if isinstance(thing, FunctionType):
        cells = (_content(cell) for cell in thing.__closure__ or ())
        return (thing.__defaults__ or (), thing.__kwdefaults__ or {}, *cells)
    if f"{type(thing).__module__}.".startswith(WALKED) and not isinstance(thing, type):
        return (vars(thing),) if hasattr(thing, "__dict__") else ()
    return None


def _content(cell: Any) -> Any:
    """Content of a closure's cell; None while it is empty."""
    try:
        return cell.cell_contents
    except ValueError:
        return None
