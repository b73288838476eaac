"""Coarse level of the fit of bond factors: the operator's local limit on a background grid of two cells' spacing.

For multipliers that vary slowly, ``(v_i - v_j) . t`` is a derivative along the bond, and the sum over a point's bonds
tends to an integral over directions: the energy ``1/2 w_i grad v : M : grad v`` with ``M_(da)(eb) = S <n_d n_e t_a(n)
t_b(n)>``, the mean over the unit sphere, ``S = 2 pi c int_0^rc exp(-r^2) r^3 dr``. Moments, nodes and factors are
those of `background_grid`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import SuperLU, splu

from pdfem_mpi.background_grid import add_moments, cell_nodes, moment_table
from pdfem_mpi.bonds import RESPONSE_CONSTANT, Points
from pdfem_mpi.kernels.bond_factors import (
    MONOMIALS,
    MULTIPLICITY,
    N,
    interpolate_moments,
    restrict_moments,
)
from pdfem_mpi.kernels.simd import W
from pdfem_mpi.parallel.comm import sum_integers

#: Spacing of the grid in cell edges.
COARSENING = 2.0
#: Most entries of the factors, estimated as unknowns times half a band, about 16 bytes each on every rank; and by how
#: much the spacing grows at a time where they would be more.
MOST_FILL, STEP = 1.5e7, 1.1
#: Moments are rounded to this fraction of a cell of unit volume.
MOMENT_QUANTUM = 2.0**-40
#: Added to the diagonal, relative: the operator has fifty free motions, along which round-off must not grow.
PIN = 1e-3


@dataclass(frozen=True)
class FactorGrid:
    """The level as seen from the points of one rank; the same factors on every rank."""

    n_points: int
    x: np.ndarray
    lower: np.ndarray
    inverse_h: np.ndarray
    counts: np.ndarray
    number: np.ndarray
    factor: SuperLU

    @property
    def arrays(self):
        """What the kernels take."""
        return self.n_points, self.x, self.lower, self.inverse_h, self.counts, self.number

    def add_correction(self, comm, r: np.ndarray, quantum: float, z: np.ndarray) -> None:
        """``z += T C^-1 T^t r`` for the owned points, vectors of shape (n_clusters, 10, 4). Collective."""
        sums = np.zeros((int(self.number.max()) + 1, N), np.int64)
        restrict_moments(*self.arrays, r.reshape(-1), quantum, sums)
        right = (sum_integers(comm, sums) * quantum).reshape(-1)
        interpolate_moments(*self.arrays, self.factor.solve(right).reshape(-1, N), z.reshape(-1))


def tensor(cutoff: float) -> np.ndarray:
    """``M_(da)(eb)`` as an array (3, 3, 10, 10): d, e, a, b."""
    strength = math.pi * RESPONSE_CONSTANT * (1.0 - (1.0 + cutoff**2) * math.exp(-(cutoff**2)))
    axes = np.eye(3, dtype=np.int64)
    pairs = MONOMIALS[:, None] + MONOMIALS[None]
    powers = axes[:, None, None, None] + axes[None, :, None, None] + pairs[None, None]
    odd_factorial = np.array([1.0, 0.0, 1.0, 0.0, 3.0, 0.0, 15.0, 0.0, 105.0])  # (k - 1)!!, the mean of an even power
    mean = np.prod(odd_factorial[powers], axis=-1) / 945.0
    return strength * np.sqrt(np.outer(MULTIPLICITY, MULTIPLICITY)) * mean


def make_factor_grid(
    comm,
    points: Points,
    lower: np.ndarray,
    upper: np.ndarray,
    edge: float,
    cutoff: float,
    slack: np.ndarray,
    omega: float,
    modulus: float = 1.0,
) -> FactorGrid:
    """Set up the grid over the owned points of all ranks. Collective.

    Parameters
    ----------
    lower, upper : float64, shape (3,)
        Corners of a box around all points.
    edge : float
        Typical edge of a cell.
    cutoff : float
    slack : bool, shape (n_owned * 8,)
        Points whose diagonal is raised by ``omega``.
    modulus : float
        Young's modulus of the bonds in model units.
    """
    n = 8 * points.n_owned
    counts = grid_counts(upper - lower, edge)
    inverse_h = counts / (upper - lower)

    x = points.x[: 3 * n].reshape(-1, 3, W).swapaxes(1, 2).reshape(-1, 3)
    scaled = (x - lower) * inverse_h
    index = np.clip(np.floor(scaled).astype(np.int64), 0, counts - 1)
    where = (index[:, 0] * counts[1] + index[:, 1]) * counts[2] + index[:, 2]
    moments = np.zeros((int(np.prod(counts)), 2, 27), np.int64)
    quantum = np.full(len(moments), MOMENT_QUANTUM)
    add_moments(moments[:, 0], where, scaled - index, points.volume[:n], quantum)
    if omega:
        add_moments(moments[:, 1], where[slack], (scaled - index)[slack], np.ones(np.count_nonzero(slack)), quantum)
    moments = sum_integers(comm, moments) * MOMENT_QUANTUM

    active = moments[:, 0, 0] > 0.0
    cells = cell_nodes(counts)[active]
    number = np.full(int(np.prod(counts + 1)), -1)
    used = np.unique(cells)
    number[used] = np.arange(len(used))
    rows = np.repeat(number[cells], 8, axis=1).reshape(-1)
    columns = np.tile(number[cells], (1, 8)).reshape(-1)

    def assembled(table, weights):
        products = (weights[active] @ table.reshape(27, 64)).reshape(-1)
        return sparse.coo_array((products, (rows, columns)), shape=(len(used),) * 2).tocsr()

    M = modulus * tensor(cutoff)
    matrix = sum(
        sparse.kron(assembled(moment_table((d, e)) * (inverse_h[d] * inverse_h[e]), moments[:, 0]), M[d, e], "csr")
        for d in range(3)
        for e in range(3)
    )
    if omega:
        matrix = matrix + sparse.kron(omega * assembled(moment_table((None, None)), moments[:, 1]), np.eye(N), "csr")
    diagonal = matrix.diagonal()
    matrix = 0.5 * (matrix + matrix.T) + sparse.diags_array(PIN * np.maximum(diagonal, diagonal.mean()))

    return FactorGrid(n, points.x, lower, inverse_h, counts, number, _factorise(matrix))


def grid_counts(extent: np.ndarray, edge: float) -> np.ndarray:
    """Grid cells along the axes: about `COARSENING` edges wide, or wider where the factors would outgrow `MOST_FILL`.

    Two cells stay across a thin direction: coarser ones cost more iterations there than along the others.
    """
    finest = np.maximum(1, np.rint(extent / (COARSENING * edge))).astype(np.int64)
    counts, spacing = finest, COARSENING * edge
    while _fill(counts) > MOST_FILL and (counts > 2).any():
        spacing *= STEP
        counts = np.maximum(np.minimum(finest, 2), np.rint(extent / spacing).astype(np.int64))
    return counts


def _factorise(matrix) -> SuperLU:
    """Factors of a symmetric positive matrix."""
    options = {"SymmetricMode": True}
    return splu(sparse.csc_matrix(matrix), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options)


def _fill(counts: np.ndarray) -> float:
    """Estimated entries of both factors: unknowns times the band of the two shorter axes."""
    nodes = np.sort(counts + 1).astype(float)
    return 2.0 * N**2 * float(np.prod(nodes)) * nodes[0] * nodes[1] / 2.0
