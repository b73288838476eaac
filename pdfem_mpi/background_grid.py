"""Trilinear functions on a background grid: nodes of its cells, and integrals over any body through moments."""

from itertools import product

import numpy as np

CORNERS = np.array(list(product((0, 1), repeat=3)))  # of a grid cell, z fastest
_VALUE = {0: np.array([1.0, -1.0]), 1: np.array([0.0, 1.0])}
_SLOPE = {0: np.array([-1.0, 0.0]), 1: np.array([1.0, 0.0])}


def moment_table(derivatives) -> np.ndarray:
    """Coefficients in 27 monomials of the products of corner functions, differentiated as asked, (27, 8, 8)."""
    table = np.zeros((27, 8, 8))
    for i, j in product(range(8), range(8)):
        factors = [
            np.convolve(
                (_SLOPE if derivatives[0] == d else _VALUE)[CORNERS[i, d]],
                (_SLOPE if derivatives[1] == d else _VALUE)[CORNERS[j, d]],
            )
            for d in range(3)
        ]
        table[:, i, j] = (factors[0][:, None, None] * factors[1][:, None] * factors[2]).reshape(-1)
    return table


def cell_nodes(counts) -> np.ndarray:
    """Grid nodes of all grid cells, shape (n, 8)."""
    i, j, k = np.unravel_index(np.arange(int(np.prod(counts))), counts)
    return np.stack(
        [((i + a) * (counts[1] + 1) + (j + b)) * (counts[2] + 1) + (k + c) for a, b, c in CORNERS], axis=1
    )


def add_moments(moments: np.ndarray, where: np.ndarray, xi: np.ndarray, weight: np.ndarray, quantum) -> None:
    """Add the moments of weighted positions to their grid cells, shape (n_cells, 27), in quanta of each cell."""
    powers = xi[:, :, None] ** np.arange(3)
    for m, (i, j, k) in enumerate(product(range(3), repeat=3)):
        terms = weight * powers[:, 0, i] * powers[:, 1, j] * powers[:, 2, k]
        np.add.at(moments[:, m], where, np.rint(terms / quantum[where]).astype(np.int64))
