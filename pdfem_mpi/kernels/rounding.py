"""Sums of float64 that no order changes: terms are rounded to multiples of a quantum, and added as integers."""

from __future__ import annotations

import math

import numpy as np

from pdfem_mpi.kernels.simd import PATTERN, W


def pattern_for(bound: float) -> tuple[float, float]:
    """Quantum that holds terms up to ``bound``, and the constant that rounds to it.

    Returns
    -------
    quantum, pattern : float
        The smallest power of two with ``bound <= 2**50 quantum``, and ``M = 1.5 * 2**52 quantum``.
    """
    quantum = 2.0 ** (math.frexp(bound)[1] - 50) if bound > 0 else 2.0**-1000
    return quantum, PATTERN * quantum


def integer_bits(x: float) -> int:
    """Bit pattern of a float64 as a signed integer."""
    return int(np.float64(x).view(np.int64))


def start_sums(T: np.ndarray, terms: np.ndarray, bound: float) -> tuple[float, float]:
    """Write integer start values that take back the patterns the kernel will add.

    Parameters
    ----------
    T : float64, shape (n_clusters, 9, 4)
        Rows 6-8 are overwritten.
    terms : int64, shape (n_clusters * 4,)
        How often each point's sum receives a term.
    bound : float
        Of a term.

    Returns
    -------
    quantum, pattern : float
    """
    quantum, pattern = pattern_for(bound)
    with np.errstate(over="ignore"):
        T.view(np.int64)[:, 6:9] = (-terms * integer_bits(pattern)).reshape(-1, 1, W)
    return quantum, pattern
