"""Questions about all cells of a body, of which a rank may see a part only."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from pdfem_mpi.parallel.comm import largest, sum_integers
from pdfem_mpi.parallel.dealing import median

if TYPE_CHECKING:
    from mpi4py.MPI import Intracomm


class SeenInPart(Exception):
    """Something is wrong with a body of which each rank sees a part: a sentence about it needs all of the cells.

    Raised on all ranks.
    """


@dataclass(frozen=True)
class Everywhere:
    """What a mesh knows of cells beyond its own: nothing, if it is whole. All methods are collective, if it is not.

    Attributes
    ----------
    comm : Intracomm, or None
    own : bool, shape (n_cells,), or None
        Cells that this rank answers for: each cell of the body belongs to one rank. None: the mesh is whole.
    """

    comm: Intracomm | None = None
    own: np.ndarray | None = None

    def of_own(self, cells: np.ndarray) -> np.ndarray:
        """Which of some cells, int64 (n,), are answered for here; bool, shape (n,). Not collective."""
        return np.ones(len(cells), bool) if self.own is None else self.own[cells]

    def mine(self, mask: np.ndarray) -> np.ndarray:
        """Those of some cells that are answered for here; bool, shape (n_cells,). Not collective."""
        return mask if self.own is None else mask & self.own

    def rows(self, values: np.ndarray) -> np.ndarray:
        """Values, shape (n_cells, ...), of the cells that are answered for here. Not collective."""
        return values if self.own is None else values[self.own]

    def total(self, *numbers: int) -> list[int]:
        """Sums of numbers that each rank counted of its own cells."""
        if self.own is None:
            return [int(number) for number in numbers]
        return sum_integers(self.comm, np.array(numbers, np.int64)).tolist()

    def count(self, *masks: np.ndarray) -> list[int]:
        """How many cells of the body are of each kind; bool, shape (n_cells,) each."""
        return self.total(*(np.count_nonzero(self.mine(mask)) for mask in masks))

    def largest(self, values: np.ndarray) -> np.ndarray:
        """Element by element, the largest of the values, float64, that each rank found among its own cells."""
        return values if self.own is None else largest(self.comm, values)

    def median(self, values: np.ndarray) -> float:
        """Median of the values, float64 (n,), of all ranks' own cells."""
        return float(np.median(values)) if self.own is None else median(self.comm, values)

    def gathered(self, rows: list[Any]) -> list[Any]:
        """A few rows of each rank, on all of them."""
        return rows if self.own is None else [row for some in self.comm.allgather(rows) for row in some]

    def joined(self, rows: np.ndarray) -> np.ndarray:
        """Few rows of each rank one after the other, on all of them."""
        return rows if self.own is None else np.concatenate(self.comm.allgather(rows))

    def wrong(self, cells: np.ndarray) -> bool:
        """Whether there is one of these cells, bool (n_cells,), anywhere, of which there should be none.

        Raises
        ------
        SeenInPart
        """
        return self.refused(self.count(cells)[0] > 0)

    def lacks(self, cells: np.ndarray) -> bool:
        """Whether there is none of these cells, bool (n_cells,), anywhere, of which there should be some.

        Raises
        ------
        SeenInPart
        """
        return self.refused(self.count(cells)[0] == 0)

    def refused(self, is_wrong: bool) -> bool:
        """The answer, alike on all ranks, where the mesh is whole. Not collective.

        Raises
        ------
        SeenInPart
            Something is wrong, and the mesh is a part.
        """
        if is_wrong and self.own is not None:
            raise SeenInPart
        return is_wrong
