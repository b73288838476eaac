"""Sums of terms of all bonds at their points, of any number of components, the same bits on any ranks."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from pdfem_mpi.kernels.simd import W
from pdfem_mpi.parallel.comm import largest
from pdfem_mpi.peridynamics.bonds import Bonds
from pdfem_mpi.peridynamics.images import Parity, halo_for
from pdfem_mpi.peridynamics.points import Points

#: Bits of a term: a point may have ``2**(62 - TERM_BITS)`` bonds, and a sum is exact to 1e-13 of its largest term.
TERM_BITS = 46


def sum_terms(
    comm, points: Points, bonds: Bonds, add: Callable, width: int, parity: Parity
) -> tuple[np.ndarray, np.ndarray]:
    """Sum the terms of all bonds at the owned points, the same bits on any ranks. Collective.

    Parameters
    ----------
    add : callable
        ``add(rows, quanta, sums, top)``: adds terms in quanta or, where these are 0, raises ``top`` to the largest.
    width : int
        Sums at a point.

    Returns
    -------
    sums : int64, shape (n_owned, 8, width)
    quanta : float64, shape (2,)
    """
    top, none = np.zeros(2), np.zeros(0, np.int64)
    for rows in bonds.rows:
        add(rows, np.zeros(2), none, top)
    top = largest(comm, top)
    quanta = np.array([2.0 ** (math.frexp(size)[1] - TERM_BITS) if size > 0.0 else 1.0 for size in top.tolist()])
    sums = np.zeros(points.n_clusters * width * W, np.int64)
    for rows in bonds.rows:
        add(rows, quanta, sums, top)
    cells = sums.reshape(-1, 2, width, W)
    halo_for(points.halo, parity).scatter_reverse(cells)
    return cells[: points.n_owned].swapaxes(2, 3).reshape(-1, 8, width), quanta
