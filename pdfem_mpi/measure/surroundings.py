"""What surrounds the cells of a rank within the cutoff radius: by bins as wide as that, found once for a body."""

from __future__ import annotations

import numpy as np

from pdfem_mpi.body.share import Share
from pdfem_mpi.kernels.near_cells import largest_near, mark_around, near_larger, raise_bins
from pdfem_mpi.parallel.comm import largest
from pdfem_mpi.peridynamics.clusters import point_rows
from pdfem_mpi.peridynamics.points import Points

#: Cells of a lattice stand whole edges apart: this much farther, relative, none is just as far as the reach.
GUARD = 1e-9
#: Rises of a ratio that need not be told closely.
SMALL_RISE = 1.0 / 32.0
#: Bins for each cell, at most: a few cells far apart do not need more.
MOST_BINS = 8


class Surroundings:
    """The cells with a point within the cutoff radius of a point of each cell, or nearly so; itself included.

    Parameters
    ----------
    share : Share
    points : Points
        Of the cells: owned ones, ghosts, images.
    """

    def __init__(self, share: Share, points: Points):
        x = point_rows(points.x).reshape(-1, 8, 3)
        self._centre = 0.5 * (x.min(axis=1) + x.max(axis=1))
        square = ((x - self._centre[:, None]) ** 2).sum(axis=2).max(axis=1)
        radius = np.sqrt(largest(share.comm, np.array([square.max(initial=0.0)])))[0]
        self._reach = (share.cutoff + 2.0 * float(radius)) * (1.0 + GUARD)
        lower = self._centre.min(axis=0, initial=np.inf) if len(x) else np.zeros(3)
        size = self._centre.max(axis=0, initial=-np.inf) - lower if len(x) else np.zeros(3)
        width = max(self._reach, float(np.prod(size + self._reach) / (MOST_BINS * max(len(x), 1))) ** (1.0 / 3.0))
        self._place = (1 + np.floor((self._centre - lower) / width)).astype(np.int32)
        shape = tuple((3 + np.floor(size / width)).astype(np.int64).tolist())
        number = np.ravel_multi_index(tuple(self._place.T.astype(np.int64)), shape)
        self._members = np.argsort(number, kind="stable")
        ends = np.searchsorted(number[self._members], np.arange(np.prod(shape) + 1))
        self._bins = np.stack([ends[:-1], ends[1:]], axis=1).reshape(*shape, 2)
        self._inside, self._more_inside, self._around, self._more_around = (np.empty(shape) for _ in range(4))

    @property
    def rows(self) -> tuple:
        """What the kernels take."""
        return self._bins, self._members, self._place, self._centre, self._reach**2

    @property
    def _tops(self) -> tuple[np.ndarray, ...]:
        """Largest numbers of both kinds in each bin, and in it and those around it."""
        return self._inside, self._more_inside, self._around, self._more_around

    def near_larger(self, number: np.ndarray, more: np.ndarray, limit: np.ndarray) -> np.ndarray:
        """Which of the first cells surround some whose largest numbers of both kinds add up to more than their limit.

        Parameters
        ----------
        number, more : float64, shape (n_cells,)
        limit : float64, shape (n,)

        Returns
        -------
        int64, shape (n_chosen,)
            A cell surrounds itself.
        """
        chosen = np.empty(len(limit), bool)
        raise_bins(self._bins, self._members, number, self._inside, self._around)
        raise_bins(self._bins, self._members, more, self._more_inside, self._more_around)
        near_larger(*self.rows, number, more, *self._tops, limit, chosen)
        return np.flatnonzero(chosen)

    def largest_rise(self, number: np.ndarray, more: np.ndarray, steepest: np.ndarray) -> np.ndarray:
        """Bounds of the sums of the largest numbers of both kinds around the first cells, times what is steepest there.

        Parameters
        ----------
        number, more : float64, shape (n_cells,)
            Those that `near_larger` was asked about last.
        steepest : float64, shape (n,)

        Returns
        -------
        float64, shape (n,)
            0 where the steepest is 0.
        """
        largest, counts = np.empty(len(steepest)), steepest > 0.0
        enough = np.full(len(steepest), np.inf)
        enough[counts] = SMALL_RISE / steepest[counts]
        largest_near(*self.rows, number, more, *self._tops, enough, largest)
        return steepest * np.where(counts, largest, 0.0)

    def marked(self, cells: np.ndarray) -> np.ndarray:
        """Which cells surround some, these included; bool, shape (n_cells,)."""
        marked = np.zeros(len(self._centre), bool)
        mark_around(*self.rows, cells, marked)
        return marked
