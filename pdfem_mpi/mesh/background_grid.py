"""Background grids: Lagrange functions on a box grid, integrated at any set of weighted positions through moments."""

from itertools import product

import numpy as np

CORNERS = np.array(list(product((0, 1), repeat=3)))  # of a grid cell, z fastest
#: Coefficients of the functions of one coordinate that are 1 at one of 2 or 3 equidistant nodes of [0, 1].
FUNCTIONS = {1: ((1.0, -1.0), (0.0, 1.0)), 2: ((1.0, -3.0, 2.0), (0.0, 4.0, -4.0), (0.0, -1.0, 2.0))}


def moment_table(derivatives, degree: int = 1) -> np.ndarray:
    """Coefficients in monomials of the products of a grid cell's functions, differentiated as asked.

    Parameters
    ----------
    derivatives : pair of int or None
        Axes along which the two functions are differentiated.
    degree : 1 or 2
        Of the functions: trilinear or triquadratic.

    Returns
    -------
    float64, shape ((2 degree + 1)**3, (degree + 1)**3, (degree + 1)**3)
    """
    nodes = list(product(range(degree + 1), repeat=3))
    table = np.zeros(((2 * degree + 1) ** 3, len(nodes), len(nodes)))
    values = [np.array(coefficients) for coefficients in FUNCTIONS[degree]]
    slopes = [np.append(coefficients[1:] * np.arange(1, degree + 1), 0.0) for coefficients in values]
    for (i, a), (j, b) in product(enumerate(nodes), repeat=2):
        factors = [
            _convolved(
                (slopes if derivatives[0] == d else values)[a[d]],
                (slopes if derivatives[1] == d else values)[b[d]],
            )
            for d in range(3)
        ]
        table[:, i, j] = (factors[0][:, None, None] * factors[1][:, None] * factors[2]).reshape(-1)
    return table


def _convolved(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Coefficients of the product of two polynomials."""
    result = np.zeros(len(a) + len(b) - 1)
    for k, coefficient in enumerate(a):
        result[k : k + len(b)] += coefficient * b
    return result


def cell_nodes(counts, degree: int = 1, cells: np.ndarray | None = None) -> np.ndarray:
    """Grid nodes of the given grid cells, or of all, shape (n, (degree + 1)**3)."""
    cells = np.arange(int(np.prod(counts))) if cells is None else cells
    i, j, k = (degree * index for index in np.unravel_index(cells, counts))
    planes = degree * np.asarray(counts) + 1
    return np.stack(
        [((i + a) * planes[1] + (j + b)) * planes[2] + (k + c) for a, b, c in product(range(degree + 1), repeat=3)],
        axis=1,
    )


def add_moments(moments: np.ndarray, where: np.ndarray, xi: np.ndarray, weight: np.ndarray, quantum) -> None:
    """Add the moments of weighted positions to their grid cells, in quanta of each cell.

    ``moments`` has the shape (n_cells, 27) for trilinear functions, (n_cells, 125) for triquadratic ones.
    """
    n = round(moments.shape[1] ** (1 / 3))
    powers = np.ones((*xi.shape, n))  # by products: the library's powers depend on the processor
    for k in range(1, n):
        powers[:, :, k] = powers[:, :, k - 1] * xi
    for m, (i, j, k) in enumerate(product(range(n), repeat=3)):
        terms = weight * powers[:, 0, i] * powers[:, 1, j] * powers[:, 2, k]
        np.add.at(moments[:, m], where, np.rint(terms / quantum[where]).astype(np.int64))
