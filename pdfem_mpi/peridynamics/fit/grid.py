"""Coarse level of the fit of bond factors: the operator's local limit on a background grid of triquadratic elements.

For multipliers that vary slowly, ``(v_i - v_j) . t`` is a derivative along the bond, and the sum over a point's bonds
tends to an integral over directions: the energy ``1/2 w_i grad v : M : grad v`` with ``M_(da)(eb) = S <n_d n_e t_a(n)
t_b(n)>``, the mean over the unit sphere, ``S = 2 pi c int_0^rc exp(-r^2) r^3 dr``. Moments and functions are those of
`background_grid`, factors those of `dissection`.

The energy's free motions are polynomials of up to the third degree. Functions of the second follow them where a thin
body bends; trilinear ones lock, and take the more iterations the wider it is.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from pdfem_mpi.kernels.dense import product, without_components
from pdfem_mpi.kernels.moment_grid import interpolate_moments, restrict_moments
from pdfem_mpi.kernels.monomials import MONOMIALS, MULTIPLICITY, N
from pdfem_mpi.kernels.simd import W
from pdfem_mpi.mesh.background_grid import add_moments, cell_nodes, moment_table
from pdfem_mpi.parallel.comm import sum_integers
from pdfem_mpi.peridynamics.bonds import RESPONSE_CONSTANT
from pdfem_mpi.peridynamics.fit.dissection import BlockMatrix, Factor, count_entries, dissect, factorise
from pdfem_mpi.peridynamics.fit.killing import free_motions

#: Length of an element in cell edges.
COARSENING = 4.0
#: Most entries of the factors, 4 bytes each on every rank; and by how much the elements grow at a time where they would
#: be more.
MOST_ENTRIES, STEP = 3e7, 1.1
#: Moments are rounded to this fraction of a cell of unit volume.
MOMENT_QUANTUM = 2.0**-40
#: Added to the diagonal, relative: the operator has fifty free motions.
PIN = 1e-6


@dataclass(frozen=True)
class LocalLimit:
    """What an operator on the multipliers of the points is for those that vary slowly, for a Young's modulus of 1.

    Attributes
    ----------
    size : int
        Multipliers of a point.
    tables : dict of float64, shape (size, size)
        The energy is ``1/2 w_i`` times the sum of ``D_d m : table : D_e m``, by the axes (d, e) along which the
        multipliers are differentiated; None for their values.
    free_motions : callable
        Multipliers without energy at some positions, (n, 3): orthonormal rows, (k, n * size).
    """

    size: int
    tables: dict[tuple[int | None, int | None], np.ndarray]
    free_motions: Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class FactorGrid:
    """The level as seen from the points of one rank; the same factors on every rank.

    Attributes
    ----------
    n_points : int
    x : float64
        Positions in cluster layout.
    lower, inverse_h : float64, shape (3,)
    counts : int64, shape (3,)
        Elements along the axes.
    number : int64, shape (n_grid_nodes,)
        Numbers of the nodes that touch the body, -1 for others.
    factor : Factor
    size : int
        Unknowns of a node.
    free : float64, shape (n_free, n_unknowns)
        Orthonormal free motions. They are kept out of the solve: round-off along them would be amplified by the
        inverse of ``PIN``.
    """

    n_points: int
    x: np.ndarray
    lower: np.ndarray
    inverse_h: np.ndarray
    counts: np.ndarray
    number: np.ndarray
    factor: Factor
    size: int
    free: np.ndarray

    @property
    def arrays(self):
        """What the kernels take."""
        return self.n_points, self.x, self.lower, self.inverse_h, self.counts, self.number

    def add_correction(self, comm, r: np.ndarray, quantum: float, stiffness: float, z: np.ndarray) -> None:
        """``z += T (stiffness C)^-1 T^t r`` for the owned points, vectors (n_clusters, size, 4). Collective."""
        sums = np.zeros((self.free.shape[1] // self.size, self.size), np.int64)
        restrict_moments(*self.arrays, r.reshape(-1), quantum, sums)
        right = without_components(self.free, (sum_integers(comm, sums) * quantum).reshape(-1))
        correction = without_components(self.free, self.factor.solve(right)) / stiffness
        interpolate_moments(*self.arrays, correction.reshape(-1, self.size), z.reshape(-1))


def tensor(cutoff: float) -> np.ndarray:
    """``M_(da)(eb)`` as an array (3, 3, 10, 10): d, e, a, b."""
    strength = math.pi * RESPONSE_CONSTANT * _third_moment(0.0, cutoff**2)
    axes = np.eye(3, dtype=np.int64)
    pairs = MONOMIALS[:, None] + MONOMIALS[None]
    powers = axes[:, None, None, None] + axes[None, :, None, None] + pairs[None, None]
    odd_factorial = np.array([1.0, 0.0, 1.0, 0.0, 3.0, 0.0, 15.0, 0.0, 105.0])  # (k - 1)!!, the mean of an even power
    mean = np.prod(odd_factorial[powers], axis=-1) / 945.0
    return strength * np.sqrt(np.outer(MULTIPLICITY, MULTIPLICITY)) * mean


def limit_of_factors(cutoff: float) -> LocalLimit:
    """That of the fit of bond factors."""
    of_bonds = tensor(cutoff)
    return LocalLimit(N, {(d, e): of_bonds[d, e] for d in range(3) for e in range(3)}, free_motions)


def share_of_long_bonds(nearest: float, cutoff: float) -> float:
    """What the bonds longer than ``sqrt(nearest)`` have of the tensor's size."""
    return _third_moment(nearest, cutoff**2) / _third_moment(0.0, cutoff**2)


def _third_moment(a: float, b: float) -> float:
    """``2 int r^3 exp(-r^2) dr`` from ``sqrt(a)`` to ``sqrt(b)``."""
    return (1.0 + a) * math.exp(-a) - (1.0 + b) * math.exp(-b)


def make_factor_grid(
    comm,
    x: np.ndarray,
    volume: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    edge: float,
    limit: LocalLimit,
    slack: np.ndarray,
    omega: float,
    most_entries: float = MOST_ENTRIES,
) -> FactorGrid:
    """Set up the grid over the owned points of a body on all ranks. Collective.

    Parameters
    ----------
    x : float64, shape (n * 3,)
        Positions in cluster layout.
    volume : float64, shape (n,)
        Integration weights.
    lower, upper : float64, shape (3,)
        Corners of a box around all points.
    edge : float
        Typical edge of a cell.
    limit : LocalLimit
    slack : bool, shape (n,)
        Points whose diagonal is raised by ``omega``.
    most_entries : float
        Of the factors.
    """
    n = len(volume)
    counts = grid_counts(upper - lower, edge, most_entries)
    inverse_h = counts / (upper - lower)
    if not sum_integers(comm, np.array([np.count_nonzero(slack)]))[0]:
        omega = 0.0

    moments = _moments(comm, x, volume, (lower, inverse_h, counts), slack, bool(omega))
    used, number, matrix = _assemble(moments, counts, inverse_h, limit, omega)
    index = np.stack(np.unravel_index(used, 2 * counts + 1), axis=1)
    return FactorGrid(
        n_points=n,
        x=x,
        lower=lower,
        inverse_h=inverse_h,
        counts=counts,
        number=number,
        factor=factorise(matrix, dissect(counts, number)),
        size=limit.size,
        # a slack holds them all
        free=np.zeros((0, limit.size * len(used))) if omega else limit.free_motions(index * (0.5 / inverse_h)),
    )


def _moments(comm, x: np.ndarray, volume: np.ndarray, place, slack: np.ndarray, with_slack: bool) -> np.ndarray:
    """Moments of the points' volumes in each element and, where asked for, of the number of points with slack.

    ``place`` are the grid's lower corner, inverse lengths and counts. Collective.

    Returns
    -------
    float64, shape (n_elements, 2, 125)
    """
    lower, inverse_h, counts = place
    scaled = (x.reshape(-1, 3, W).swapaxes(1, 2).reshape(-1, 3) - lower) * inverse_h
    index = np.clip(np.floor(scaled).astype(np.int64), 0, counts - 1)
    where = (index[:, 0] * counts[1] + index[:, 1]) * counts[2] + index[:, 2]
    moments = np.zeros((int(np.prod(counts)), 2, 125), np.int64)
    quantum = np.full(len(moments), MOMENT_QUANTUM)
    add_moments(moments[:, 0], where, scaled - index, volume, quantum)
    if with_slack:
        add_moments(moments[:, 1], where[slack], (scaled - index)[slack], np.ones(np.count_nonzero(slack)), quantum)
    return sum_integers(comm, moments) * MOMENT_QUANTUM


def _assemble(
    moments: np.ndarray, counts: np.ndarray, inverse_h: np.ndarray, limit: LocalLimit, omega: float
) -> tuple[np.ndarray, np.ndarray, BlockMatrix]:
    """The operator on the grid's functions.

    Returns
    -------
    used : int64, shape (n_nodes,)
        Grid nodes that touch the body.
    number : int64, shape (n_grid_nodes,)
        Their numbers, -1 for others.
    matrix : BlockMatrix
    """
    active = moments[:, 0, 0] > 0.0
    cells = cell_nodes(counts, 2)[active]
    number = np.full(int(np.prod(2 * counts + 1)), -1)
    used = np.unique(cells)
    number[used] = np.arange(len(used))
    n_nodes = len(used)
    keys = (n_nodes * number[cells][:, :, None] + number[cells][:, None, :]).reshape(-1)
    keys, entry = np.unique(keys, return_inverse=True)

    def assembled(derivatives, weights):
        products = product(weights[active], moment_table(derivatives, 2).reshape(125, 27**2))
        return np.bincount(entry, products.reshape(-1), len(keys))

    per_length = {None: 1.0} | dict(enumerate(inverse_h))
    values = [per_length[d] * per_length[e] * assembled((d, e), moments[:, 0]) for d, e in limit.tables]
    tables = np.stack(list(limit.tables.values()))
    if omega:
        values.append(omega * assembled((None, None), moments[:, 1]))
        tables = np.concatenate([tables, np.eye(limit.size)[None]])
    values = np.stack(values, axis=1)
    of_diagonal = np.flatnonzero(keys // n_nodes == keys % n_nodes)
    diagonal = product(values[of_diagonal], tables.diagonal(axis1=1, axis2=2)).reshape(-1)
    matrix = BlockMatrix(
        start=np.searchsorted(keys, n_nodes * np.arange(n_nodes + 1)),
        column=keys % n_nodes,
        values=values,
        tables=tables,
        raised=PIN * np.maximum(diagonal, diagonal.mean()),
    )
    return used, number, matrix


def grid_counts(extent: np.ndarray, edge: float, most_entries: float = MOST_ENTRIES) -> np.ndarray:
    """Elements along the axes: about `COARSENING` edges long, or longer where the factors have too many entries."""
    length = COARSENING * edge
    while True:
        counts = np.maximum(1, np.rint(extent / length)).astype(np.int64)
        if count_entries(counts, N) <= most_entries or (counts == 1).all():
            return counts
        length *= STEP
