"""Small bodies of peridynamic points for the kernels' tests, and what numpy makes of their stored rows.

A `Part` is what one rank would hold: owned cells, then copies of all others, whether near or not. Lengths
are in units of the internal length; families reach ``CUTOFF``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from pdfem_mpi.kernels import families, hex8
from pdfem_mpi.peridynamics.bonds import RESPONSE_CONSTANT, Bonds
from pdfem_mpi.peridynamics.clusters import cluster_layout
from pdfem_mpi.peridynamics.points import Points
from pdfem_mpi.peridynamics.rows import find_bonds

CUTOFF = 2.5 * (1 + families.CUTOFF_GUARD)
W = 4
LONG = np.longdouble
NO_FACTOR = np.empty(0)


@dataclass(frozen=True)
class Body:
    """All points, eight a cell: positions (n, 3), integration weights (n,)."""

    x: np.ndarray
    volume: np.ndarray

    @property
    def n_cells(self) -> int:
        """Cells."""
        return len(self.x) // 8

    def renumbered(self, order: np.ndarray) -> Body:
        """The same points in another order: other clusters, lanes, cells and bond owners."""
        return Body(self.x[order], self.volume[order])


def body(n_cells=(4, 3, 2), kind="box", edge=1.0) -> Body:
    """Gauss points of a box of cells, nodes moved if "jittered", edges 1, 1.25, 1.56, ... if "graded"."""
    n_nodes = np.array(n_cells) + 1
    ijk = np.stack(np.unravel_index(np.arange(n_nodes.prod()), n_nodes), axis=1)
    nodes = ijk.astype(float)
    if kind == "jittered":
        nodes += np.random.default_rng(1).uniform(-0.15, 0.15, nodes.shape)
    elif kind == "graded":
        nodes = 4.0 * (1.25**nodes - 1.0)
    r = ((hex8.REFERENCE_NODES + 1) // 2).astype(int)
    first = ijk[(ijk < np.array(n_cells)).all(axis=1)]
    cells = np.ravel_multi_index(tuple(np.moveaxis(first[:, None] + r, -1, 0)), n_nodes)
    corners = edge * nodes[cells]
    return Body(hex8.gauss_positions(corners).reshape(-1, 3), hex8.gauss_volumes(corners).reshape(-1))


@dataclass(frozen=True)
class Part:
    """What one rank holds: its points and bonds, and the body's number of each local point."""

    points: Points
    bonds: Bonds
    point: np.ndarray


def part(whole: Body, owned=None, finite=True, factor=None, cutoff=CUTOFF, number=None) -> Part:
    """The share of one rank.

    Parameters
    ----------
    owned : int64 or None
        Cells in the order of their storage; None: all.
    factor : float64, shape (n_points, 3) or None
        Correction vectors of the points.
    number : int64, shape (n_cells,) or None
        Numbers of the cells, which decide who owns a bond between ranks; None: their index.
    """
    owned = np.arange(whole.n_cells) if owned is None else np.asarray(owned)
    cells = np.concatenate([owned, np.setdiff1d(np.arange(whole.n_cells), owned)[::-1]])
    point = (8 * cells[:, None] + np.arange(8)).reshape(-1)
    number = np.arange(whole.n_cells) if number is None else number
    points = Points(
        n_free=len(owned),
        n_owned=len(owned),
        cell_number=number[cells],
        material=np.zeros(len(cells), np.int16),
        x=layout(whole.x[point]),
        volume=whole.volume[point],
        halo=None,
    )
    interior, boundary = find_bonds(points, cutoff, finite)
    added = np.zeros(len(point), np.int64)
    at_cluster = np.zeros(len(point) // W, np.int64)
    counts, strongest = np.zeros((1, 1), np.int64), np.zeros(2)
    for rows in (interior, boundary):
        families.count_rows(rows.start, rows.offset, added, at_cluster)
        families.fill_rows(
            *rows.arrays,
            points.x,
            points.volume,
            NO_FACTOR if factor is None else layout(factor[point]),
            np.array([[RESPONSE_CONSTANT]]),
            points.material,
            cutoff,
            finite,
            strongest,
            counts,
        )
    bonds = Bonds(interior, boundary, finite, cutoff, added, at_cluster, counts, *strongest.tolist())
    return Part(points, bonds, point)


def parts(whole: Body, n_parts: int, **options) -> list[Part]:
    """The body dealt cell by cell to ranks of unequal size, which store their cells in some order."""
    rng = np.random.default_rng(n_parts)
    owner = np.minimum(rng.integers(0, n_parts + 1, whole.n_cells), n_parts - 1)
    owner[:n_parts] = np.arange(n_parts)
    return [part(whole, rng.permutation(np.flatnonzero(owner == rank)), **options) for rank in range(n_parts)]


def layout(rows: np.ndarray) -> np.ndarray:
    """Rows of the points, (n, 3), in cluster layout."""
    return cluster_layout(np.ascontiguousarray(rows).reshape(-1, 8, 3))


def table_rows(table: np.ndarray, first: int) -> np.ndarray:
    """Three rows of the point table, from ``first`` on, as (n_points, 3)."""
    return table.reshape(-1, 9, W)[:, first : first + 3].swapaxes(1, 2).reshape(-1, 3)


def slots(share: Part, rows) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Slots with a bond: local points i and j, and the stored numbers, (n, 2) or (n, 1), as float64."""
    n_rows = len(rows.offset) - 1
    i = np.repeat(np.repeat(np.arange(len(rows.start) - 1), np.diff(rows.start)), W)
    j = (W * (rows.offset[:-1].astype(np.int64) // (9 * W))[:, None] + np.arange(W)).reshape(-1)
    width = 2 if share.bonds.finite else 1
    stored = rows.data[: n_rows * width * W].reshape(n_rows, width, W)
    stored = stored.swapaxes(1, 2).reshape(n_rows * W, width)
    held = stored[:, 0] != 0.0
    return i[held], j[held], stored[held].astype(float)


def stored_bonds(shares) -> tuple[np.ndarray, np.ndarray]:
    """Bonds of all parts: pairs (n, 2) of the body's points, lower first, and stored numbers; sorted."""
    pairs, numbers = [], []
    for share in shares:
        for rows in share.bonds.rows:
            i, j, stored = slots(share, rows)
            pairs.append(np.sort(share.point[np.stack([i, j], axis=1)], axis=1))
            numbers.append(stored)
    pairs, numbers = np.concatenate(pairs), np.concatenate(numbers)
    order = np.lexsort((pairs[:, 1], pairs[:, 0]))
    return pairs[order], numbers[order]


def near_pairs(x: np.ndarray, cutoff=CUTOFF) -> np.ndarray:
    """Pairs of points within the cutoff, lower first, sorted."""
    return np.array(sorted(cKDTree(x).query_pairs(cutoff)))


def strengths(whole: Body, pairs: np.ndarray, factor=None) -> np.ndarray:
    """``c exp(-r^2) g_ij w_i w_j`` in extended precision, eqs (2), (A8)-(A10)."""
    i, j = pairs.T
    xi = (whole.x[j] - whole.x[i]).astype(LONG)
    r = np.sqrt((xi**2).sum(axis=1))
    result = LONG(RESPONSE_CONSTANT) * np.exp(-(r**2)) * whole.volume[i] * whole.volume[j]
    if factor is not None:
        normal = xi / r[:, None]
        result /= np.sqrt(((normal / (0.5 * (factor[i] + factor[j]))) ** 2).sum(axis=1))
    return result


def add_at(n: int, pairs: np.ndarray, first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Sum over the bonds of what the lower and the upper point receive."""
    total = np.zeros((n, 3), LONG)
    np.add.at(total, pairs[:, 0], first)
    np.add.at(total, pairs[:, 1], second)
    return total
