"""Recursive bisection: which rank owns which cell, as a pure function of positions and weights."""

from __future__ import annotations

import numpy as np

# in mean cell edges
REACH = 1.25  # takes the two layers beside a plane between layers, all three where it steps inside a layer
SLACK = 0.25  # beyond the two nearest layers, where these lie farther apart than that


def bisect(positions: np.ndarray, weights: np.ndarray, n_parts: int) -> np.ndarray:
    """Divide cells into parts of equal weight by planes that separate few cells.

    Each step divides a set of cells in two, in the proportion of the numbers of parts that the two sides will be
    divided into, by a plane normal to x, y or z. Of the three planes the one with the smallest dividing surface is
    taken; its measure is the number of cells whose centre lies nearer to the plane than 1.25 mean cell edges (or in
    one of the two nearest layers), that is the cells which the plane separates. Equal surfaces: the longer direction,
    then x before y before z. Cells of equal coordinate are taken in the order of their index.

    Parameters
    ----------
    positions : float64, shape (n_cells, 3), dimension length
        Centres of the cells.
    weights : int64, shape (n_cells,), >= 0, dimension 1
        Cost of each cell. A part differs from its share by no more than the largest weight, unless a part would be
        left without a cell.
    n_parts : int, >= 1

    Returns
    -------
    int32, shape (n_cells,)
        Part of each cell, ``0 .. n_parts - 1``. No part is empty while ``n_parts <= n_cells``; with more
        parts none has two cells. No floating-point sum over cells enters: every rank obtains the same.

    Raises
    ------
    ValueError
        Wrong shapes, positions that are not finite, negative weights, ``n_parts < 1``.

    References
    ----------
    Berger & Bokhari, A partitioning strategy for nonuniform problems on multiprocessors, IEEE Trans. Computers
    C-36 (1987).
    """
    positions = np.asarray(positions, dtype=np.float64)
    weights = np.asarray(weights, dtype=np.int64)
    if n_parts < 1 or positions.shape != (len(weights), 3):
        raise ValueError(f"bisect: {n_parts} parts, positions {positions.shape}, weights {weights.shape}.")
    if not np.isfinite(positions).all() or (weights < 0).any():
        raise ValueError("bisect: positions must be finite and weights not negative.")

    if n_parts == 1:
        return np.zeros(len(weights), np.int32)
    return _divided(positions, weights, n_parts)


def _divided(positions: np.ndarray, weights: np.ndarray, n_parts: int) -> np.ndarray:
    """`bisect`, of sound arrays. No function that calls itself: one stays, with all it sees, until garbage is found."""
    owner, on_left = np.zeros(len(weights), np.int32), np.zeros(len(weights), bool)
    edge = mean_edge(len(positions), np.ptp(positions, axis=0) if len(positions) else np.zeros(3))
    undivided = [([np.argsort(positions[:, axis], kind="stable") for axis in range(3)], 0, n_parts)]
    while undivided:
        orders, first_part, n_parts = undivided.pop()  # the same cells, sorted along x, y and z
        if n_parts == 1 or len(orders[0]) == 0:
            owner[orders[0]] = first_part
            continue
        n_left = n_parts // 2
        counts = [_balanced_cut(weights[order], n_left, n_parts) for order in orders]
        axis = _smallest_surface([positions[order, d] for d, order in enumerate(orders)], counts, edge)
        k = counts[axis]
        on_left[orders[axis]] = np.arange(len(orders[axis])) < k
        left, right = ([order[on_left[order] == side] for order in orders] for side in (True, False))
        undivided += [(left, first_part, n_left), (right, first_part + n_left, n_parts - n_left)]
    return owner


def mean_edge(n: int, sides: np.ndarray) -> float:
    """Return the edge h of n cubes whose centres span a box: ``prod (L_d + h) = n h^3``.

    Parameters
    ----------
    n : int
    sides : float64, shape (3,), dimension length
        Of the box.

    Returns
    -------
    float, dimension length
        0 when all positions are equal.
    """
    x, y, z = (float(side) for side in sides)
    low, high = 0.0, 4.0 * max(x, y, z)  # h = 3.85 L for two cells on the diagonal of a cube
    while n > 1 and high > low * (1.0 + 1e-6):
        h = 0.5 * (low + high)
        low, high = (h, high) if (x + h) * (y + h) * (z + h) > n * h * h * h else (low, h)
    return high


def _smallest_surface(coordinates: list[np.ndarray], counts: list[int], edge: float) -> int:
    """The axis along which the plane after so many cells separates fewest; ``coordinates`` are sorted."""
    cuts = []
    for axis, (coordinate, k) in enumerate(zip(coordinates, counts, strict=True)):
        below, above = coordinate[max(k - 1, 0)], coordinate[min(k, len(coordinate) - 1)]
        reach = max(REACH * edge, 0.5 * (above - below) + SLACK * edge)
        plane = 0.5 * (below + above)
        first, last = np.searchsorted(coordinate, (plane - reach, plane + reach))
        cuts.append((last - first, coordinate[0] - coordinate[-1], axis))
    return min(cuts)[2]


def _balanced_cut(weights: np.ndarray, n_left: int, n_parts: int) -> int:
    """Return how many sorted cells go left: nearest to ``n_left / n_parts`` of the weight, no part empty."""
    n = len(weights)
    if not weights.any():
        weights = np.ones_like(weights)
    low, high = sorted((n_left, n - (n_parts - n_left)))
    left = np.concatenate([[0], np.cumsum(weights)])
    share = int(left[-1]) * n_left // n_parts
    return max(low, 0) + int(np.argmin(np.abs(left[max(low, 0) : high + 1] - share)))
