"""Sums over all ranks whose bits do not depend on how the terms are dealt out."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from pdfem_mpi.kernels.exact_sums import SIZE, add_products, value
from pdfem_mpi.parallel.comm import sum_integers


def exact_dots(comm, pairs: Iterable[tuple[np.ndarray, np.ndarray]]) -> np.ndarray:
    """Dot products of pairs of vectors that are dealt out over all ranks, each rounded once. Collective.

    Parameters
    ----------
    pairs : pairs of float64 arrays of one size

    Returns
    -------
    float64, shape (n_pairs,)
    """
    rows = []
    for x, y in pairs:
        rows.append(np.zeros(SIZE, np.int64))
        add_products(np.ascontiguousarray(x).reshape(-1), np.ascontiguousarray(y).reshape(-1), rows[-1])
    return np.array([value(row) for row in sum_integers(comm, np.array(rows))])
