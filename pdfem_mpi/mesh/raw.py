"""What a mesh file holds before it is a mesh of hexahedra, and the sentence that says why it holds none."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

#: Dimension of each kind of cell, its number of nodes left out ("quad8"). A kind that is not here is a solid.
DIMENSIONS = {"vertex": 0, "line": 1, "spring": 1, "triangle": 2, "quad": 2, "polygon": 2, "surface": 2}
#: An integer array with more values than this numbers its items and makes no sets.
MOST_VALUES = 256
#: Letters of a file's own text that a message repeats.
SHOWN = 60


class Refusal(Exception):
    """Why a file is not read: sentences that follow its name, each with what was found and what to do.

    Attributes
    ----------
    messages : list of str
    """

    def __init__(self, *messages: str) -> None:
        super().__init__(" ".join(messages))
        self.messages = list(messages)


@dataclass
class Block:
    """Cells of one kind that stand together in a file.

    Attributes
    ----------
    kind : str
        ``hexahedron``, ``quad``, ``line``, ``vertex``, or another shape with its number of nodes, as ``tetra10``.
    nodes : int64, shape (n_cells, n)
        Places of the nodes in the file's order; empty rows where the reader has no use for them.
    called : str
        What the format calls the kind, and where the block is: ``C3D8R, line 12``.
    """

    kind: str
    nodes: np.ndarray
    called: str

    @property
    def dimension(self) -> int:
        """0 for points to 3 for solids."""
        return DIMENSIONS.get(re.sub(r"\d+$", "", self.kind), 3)


@dataclass
class RawMesh:
    """The content of a mesh file.

    Attributes
    ----------
    points : float64, shape (n_nodes, 3)
        In the file's order.
    blocks : list of Block
        In the file's order.
    cells : dict from name to int64 arrays
        Sets of cells: the members in each block.
    faces : dict from name to int64, shape (n, 4)
        Sets of faces by their nodes.
    nodes : dict from name to int64, shape (n,)
    folded : bool
        Names that differ by upper and lower case only are one.
    notes : list of str
        What was left out by intention, with its number.
    """

    points: np.ndarray
    blocks: list[Block] = field(default_factory=list)
    cells: dict[str, list[np.ndarray]] = field(default_factory=dict)
    faces: dict[str, np.ndarray] = field(default_factory=dict)
    nodes: dict[str, np.ndarray] = field(default_factory=dict)
    folded: bool = False
    notes: list[str] = field(default_factory=list)

    def set_of_cells(self, name: str, chosen: np.ndarray) -> None:
        """Make a set of some of all cells, numbered through the blocks; an existing set keeps what it has.

        Parameters
        ----------
        chosen : bool, shape (n_cells,)
        """
        if name not in self.cells:
            ends = np.cumsum([len(block.nodes) for block in self.blocks])[:-1]
            self.cells[name] = [np.flatnonzero(part) for part in np.split(chosen, ends)]


def values_of(array: str, values: np.ndarray) -> list[tuple[str, int]]:
    """Names of the sets that an integer array makes, and the value of each.

    Sets a and b that were written to a format without sets as an array ``a-b`` with the values 0 and 1 are the sets a
    and b as well.
    """
    if values.ndim != 1 or values.dtype.kind not in "iu" or not len(values):
        return []
    distinct = np.unique(values)
    if len(distinct) > MOST_VALUES:
        return []
    sets = [(f"{array}={value}", int(value)) for value in distinct]
    for mark in "-_#+/":
        parts = array.split(mark)
        if np.array_equal(distinct[distinct >= 0], np.arange(len(parts))):
            sets += [(name, value) for value, name in enumerate(parts)]
            break
    return sets


def places_of(numbers: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """Where each wanted number stands among the numbers of a file; -1 where it is not. Same shape as wanted.

    Parameters
    ----------
    numbers : int64, shape (n,)
        All different.
    wanted : int64
    """
    if not len(numbers):
        return np.full(wanted.shape, -1)
    order = np.argsort(numbers, kind="stable")
    place = np.minimum(np.searchsorted(numbers, wanted, sorter=order), len(numbers) - 1)
    found = order[place]
    return np.where(numbers[found] == wanted, found, -1)


def repeated(numbers: np.ndarray) -> np.ndarray:
    """Places of numbers that stood before, in ascending order; int64."""
    return np.setdiff1d(np.arange(len(numbers)), np.unique(numbers, return_index=True)[1])


def excerpt(text: bytes | str) -> str:
    """The beginning of a line of a file, fit to be printed."""
    text = text.decode("utf-8", "replace") if isinstance(text, bytes) else text
    clean = "".join(letter if letter.isprintable() else "?" for letter in text.strip())
    return f'"{clean[:SHOWN]}{"..." if len(clean) > SHOWN else ""}"'


def counted(items: Iterable[str]) -> str:
    """Distinct words with how often each came, in the order of their first: ``2 S4, 1 T3D2``."""
    count: dict[str, int] = {}
    for item in items:
        count[item] = count.get(item, 0) + 1
    return ", ".join(f"{number} {item}" for item, number in count.items())
