"""Which places are near others: of cells of other ranks, of neighbours, of mirror images.

scipy has a tree for that, which takes 22 MiB and 0.2 s on every rank before it has seen a place.
"""

from __future__ import annotations

import numpy as np

from pdfem_mpi.kernels.nearest import count_near, nearest_squares

#: Bins for each place, at most: a few places far apart do not need more.
MOST_BINS = 8
#: Bins are wider than the reach by so much, relative: two places as far apart as that are then in bins side by side.
GUARD = 1e-9


class NearPlaces:
    """Places that others are compared with.

    Parameters
    ----------
    places : float64, shape (n_places, 3), dimension length
    reach : float, dimension length
        How far is near.
    """

    def __init__(self, places: np.ndarray, reach: float):
        lower = places.min(axis=0) if len(places) else np.zeros(3)
        size = (places.max(axis=0) if len(places) else lower) - lower
        least = float(np.prod(size + reach) / (MOST_BINS * max(len(places), 1))) ** (1.0 / 3.0)
        width = max(reach * (1.0 + GUARD), least)
        bins = (size / width).astype(np.int64) + 1
        index = ((places - lower) / width).astype(np.int64)
        flat = (index[:, 0] * bins[1] + index[:, 1]) * bins[2] + index[:, 2]
        order = np.argsort(flat, kind="stable")
        start = np.searchsorted(flat[order], np.arange(int(bins.prod()) + 1))
        self._bins = np.ascontiguousarray(places[order]), lower, width, bins, start, reach**2

    def distances(self, x: np.ndarray) -> np.ndarray:
        """From other places, shape (n, 3), to the nearest of these; float64, shape (n,), infinite beyond the reach."""
        found = np.empty(len(x))
        nearest_squares(np.ascontiguousarray(x), *self._bins, found)
        return np.sqrt(found)

    def counts(self, x: np.ndarray) -> np.ndarray:
        """How many of these are within the reach of other places; int64, shape (n,)."""
        found = np.empty(len(x), np.int64)
        count_near(np.ascontiguousarray(x), *self._bins, found)
        return found


def nearest_distances(places: np.ndarray, x: np.ndarray, about: float) -> np.ndarray:
    """From other places to the nearest of some, wherever it is; float64, shape (n,), dimension length.

    Parameters
    ----------
    places, x : float64, shapes (n_places, 3), (n, 3), dimension length
        At least one place.
    about : float, dimension length
        How far it may be: no more than where to begin.
    """
    found, reach = np.full(len(x), np.inf), about
    while (far := np.flatnonzero(np.isinf(found))).size:
        found[far] = NearPlaces(places, reach).distances(x[far])
        reach *= 2.0
    return found
