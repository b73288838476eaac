"""What no ratio of a cell is above, kept from one state to the next.

Ratios are the largest of terms that are linear in the displacements. From one state to another that of a cell rises by
no more than the largest term of the difference, which strains bound: a cell whose bonds were looked at need not be
looked at again before what is around it was strained by what it had left.
"""

from __future__ import annotations

import numpy as np

#: Bonds of so many cells are looked at, as a part of all cells, until bounds are told anew, which costs as much.
RENEWED = 1.0 / 16.0


class Ceilings:
    """Bounds of the ratios of a rank's cells at some displacements: 0 at none.

    Parameters
    ----------
    n_owned : int
    """

    def __init__(self, n_owned: int):
        self._known, self._u, self._searched = np.zeros(n_owned), None, 0

    def change(self, u: np.ndarray) -> np.ndarray:
        """Displacements less those at which ratios are bounded; float64, shape (n_unknowns,)."""
        return u if self._u is None else u - self._u

    def room(self, least: np.ndarray, steepest: np.ndarray) -> np.ndarray:
        """By how much cells may be strained until a ratio of theirs may be above the least.

        Parameters
        ----------
        least, steepest : float64, shape (n_owned,)
            Ratios, and what they rise by with the strain; 0 where it does not matter how far a cell is strained.

        Returns
        -------
        float64, shape (n_owned,), dimension 1
        """
        matters = (steepest > 0.0) & np.isfinite(least)
        room = np.full(len(least), np.inf)
        room[matters] = (least[matters] - self._known[matters]) / steepest[matters]
        return room

    def are_due(self, searched: int, n_cells: int) -> bool:
        """Whether bounds are to be told anew after so many cells of all ranks were looked at, of all of the body."""
        self._searched += searched
        return self._searched > RENEWED * n_cells

    def renew(self, u: np.ndarray, rise: np.ndarray, searched: np.ndarray, ratio: np.ndarray) -> None:
        """Bound ratios at other displacements.

        Parameters
        ----------
        u : float64, shape (n_unknowns,)
        rise : float64, shape (n_owned,)
            What ratios rose by, at most.
        searched : int64, shape (n,)
            Cells whose bonds were looked at.
        ratio : float64
            Of them, by cell.
        """
        self._known += rise
        self._known[searched] = ratio[searched]
        self._u, self._searched = u.copy(), 0
