"""Fitted weights of the dilatation: with them a volumetric part is exact for every uniform strain. Collective.

Equilibrium of a uniform strain splits into the stress of a Poisson's ratio of 1/4, which the fit of the bond factors
balances (`equations`), and a pressure ``M tr(eps)``. That is exact if the discrete divergence is consistent and
balanced, whatever ``M``::

    sum_j A_ij r_ij n n = w_i I        six equations a point        sum_j (A_ij + A_ji) n = -N_i        three

with ``A_ij = k_ij a_i / (10 mu)`` and the area vectors ``N``. The weights ``a`` of smallest change from 1, each counted
by its ``k``, have nine multipliers a point (`kernels.dilatation_fit`): a symmetric positive semi-definite system,
solved by conjugate gradients with the inverse 9 x 9 blocks of the points and a background grid (`dilatation_grid`).
Its free motions are symmetric Killing tensors of rank 2 and the displacements that belong to them; ``N`` fulfils what
follows from that (`areas`).

Weights are stored in single precision. As with the factors, the miss is measured with what is stored, and undone by the
long bonds. All sums are exact: weights have the same bits on any number of ranks.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pdfem_mpi.kernels.dense import solve as solve_dense
from pdfem_mpi.kernels.dilatation_fit import ENTRIES, ROWS, N, add_divergence_blocks, add_divergences, write_weights
from pdfem_mpi.kernels.rounding import integer_bits, pattern_for
from pdfem_mpi.kernels.simd import W
from pdfem_mpi.parallel.comm import largest
from pdfem_mpi.peridynamics.bonds import Bonds
from pdfem_mpi.peridynamics.fit.dilatation_grid import share_of_long_bonds
from pdfem_mpi.peridynamics.fit.equations import (
    LEAST_REFINEMENT,
    LONG_BONDS,
    MOST_REFINEMENTS,
    REFINEMENT,
    Grids,
    add_grids,
)
from pdfem_mpi.peridynamics.fit.iterations import solve
from pdfem_mpi.peridynamics.points import Points
from pdfem_mpi.peridynamics.volumetric import SHEAR

#: A fit ends at this residual, relative to that of the start, or after so many iterations: in long bodies it waits for
#: motions that bend them.
TOLERANCE, MOST_ITERATIONS = 1e-9, 3000
#: Added to the diagonals of the blocks, relative: a point whose bonds lie in a plane determines less than nine numbers.
PIN = 1e-9


@dataclass(frozen=True)
class DilatationFit:
    """What the fit reached.

    Attributes
    ----------
    iterations : int
    residual : float, dimension 1
        Largest miss of a point's nine equations, relative to the largest target.
    largest_weight : float
        Magnitude.
    """

    iterations: int
    residual: float
    largest_weight: float


def fit_dilatation(
    comm, points: Points, bonds: Bonds, modulus: np.ndarray, areas: np.ndarray, grids: Grids
) -> tuple[Bonds, DilatationFit, list[np.ndarray]]:
    """The same bonds, whose volumetric part has fitted weights; what was reached; and multipliers. Collective.

    Parameters
    ----------
    bonds : Bonds
        With their fitted factors.
    modulus : float64, shape (n_materials,)
        Young's modulus of bonds, `MaterialTable.own_bond_modulus`.
    areas : float64, shape (n_owned * 8, 3), dimension length^2
        Compatible area vectors of the owned points.
    grids : list of FactorGrid, each with its clusters
        Background grids of the bodies.

    Returns
    -------
    bonds : Bonds
    fit : DilatationFit
    multipliers : list of float64, shapes (n_owned_clusters, 9, 4)
        With which `write_dilatation` gives the same bonds once more.
    """
    system = _System(comm, points, bonds, modulus, grids)
    goal = np.zeros((system.n, N, W))
    goal[:, 0:3] = 10.0 * SHEAR * points.volume.reshape(-1, 1, W)[: system.n]
    goal[:, 6:9] = -10.0 * SHEAR * areas.reshape(-1, W, 3).swapaxes(1, 2)
    iterations, multipliers = 0, []
    for turn, fraction in enumerate((0.0, *LONG_BONDS)):
        nearest = (fraction * bonds.cutoff) ** 2
        system.precondition_for(nearest)
        first = turn == 0
        reduction, most = (TOLERANCE, MOST_ITERATIONS) if first else (REFINEMENT, MOST_REFINEMENTS)
        before = system.products
        miss = goal - system.sums()
        v, reached = solve(comm, system.multiply, system.precondition, miss, reduction, most, stalled=most)
        iterations += system.products - before if first else 0
        if not first and not reached <= LEAST_REFINEMENT:
            break
        system.write(v)
        multipliers.append(v)
    miss, size = (np.abs(each).max(initial=0.0) for each in (goal - system.sums(), goal))
    peak, scale = largest(comm, np.array([miss, size])).tolist()
    return system.bonds_with_weights(), DilatationFit(iterations, peak / (scale or 1.0), system.top), multipliers


def write_dilatation(comm, points: Points, bonds: Bonds, modulus: np.ndarray, multipliers: list[np.ndarray]) -> Bonds:
    """The bonds that an earlier `fit_dilatation` gave, by its multipliers. Collective."""
    system = _System(comm, points, bonds, modulus)
    for v, fraction in zip(multipliers, (0.0, *LONG_BONDS), strict=False):
        system.nearest = (fraction * bonds.cutoff) ** 2
        system.write(v)
    return system.bonds_with_weights()


class _System:
    """Sums over the bonds for the nine equations of the owned points, vectors of shape (n_clusters, 9, 4)."""

    def __init__(self, comm, points: Points, bonds: Bonds, modulus: np.ndarray, grids: Grids | None = None):
        self.grids = grids or []
        self.comm, self.points, self.bonds, self.n = comm, points, bonds, 2 * points.n_owned
        self.modulus = np.repeat(modulus[points.material[: points.n_owned]], 2).reshape(-1, 1, 1)
        self.T = np.zeros((points.n_clusters, ROWS, W))
        self.T[:, 0:3] = points.x.reshape(-1, 3, W)
        self.TI = self.T.view(np.int64)
        self.weights = tuple(np.ones(8 * len(rows.offset), np.float32) for rows in bonds.rows)
        self.nearest, self.products, self.top = 0.0, 0, 1.0

    def sums(self) -> np.ndarray:
        """The nine sums with the weights as they are stored."""
        bound = 2.0 * self.bonds.strongest * max(1.0, self.bonds.cutoff) * max(self.top, 1.0)
        return self._sweep(bound, False)

    def multiply(self, v: np.ndarray, size: float) -> np.ndarray:
        """Their change with multipliers, whose norm at a point is at most ``size``."""
        self._load(v)
        self.products += 1
        reach = max(1.0, self.bonds.cutoff)
        return self._sweep(4.0 * (reach + 2.0) * reach * self.bonds.strongest * size, True)

    def precondition_for(self, nearest: float) -> None:
        """Make the inverse blocks of the points, of bonds longer than ``sqrt(nearest)``."""
        self.nearest, bonds, points = nearest, self.bonds, self.points
        sums = np.zeros((points.n_clusters, ENTRIES, W), np.int64)
        quantum, _ = pattern_for(2.0 * bonds.strongest * max(1.0, bonds.cutoff**2))
        for rows in bonds.rows:
            add_divergence_blocks(*rows.arrays, points.x, quantum, bonds.finite, nearest, sums.reshape(-1))
        points.halo.scatter_reverse(sums.reshape(-1, 2, ENTRIES, W))
        packed = (sums[: self.n] * quantum / self.modulus).swapaxes(1, 2).reshape(-1, ENTRIES)
        block = np.zeros((len(packed), N, N))
        above = np.triu_indices(N)
        block[:, above[0], above[1]] = packed
        block[:, above[1], above[0]] = packed
        trace = block[:, range(N), range(N)].sum(axis=1)
        block[:, range(N), range(N)] += (PIN * trace + 1e-300)[:, None]
        self.inverse = solve_dense(block, np.broadcast_to(np.eye(N), block.shape))
        self.stiffness = share_of_long_bonds(nearest, bonds.cutoff)

    def precondition(self, r: np.ndarray) -> np.ndarray:
        """``B^-1 r``, entry by entry: the same bits whatever stands beside; and what the grids add."""
        rows = r.swapaxes(1, 2).reshape(-1, N)
        z = np.zeros_like(rows)
        for a in range(N):
            z += self.inverse[:, :, a] * rows[:, a, None]
        z = np.ascontiguousarray(z.reshape(-1, W, N).swapaxes(1, 2))
        add_grids(self.comm, self.grids, self.stiffness, r, z)
        return z

    def write(self, v: np.ndarray) -> None:
        """Add what multipliers make of the bonds to their weights."""
        self._load(v)
        top = 0.0
        for rows, weights in zip(self.bonds.rows, self.weights, strict=True):
            numbers = *rows.arrays, self.T.reshape(-1), self.bonds.finite, self.nearest
            top = max(top, write_weights(*numbers, weights))
        self.top = float(largest(self.comm, np.array([top]))[0])

    def bonds_with_weights(self) -> Bonds:
        """The bonds, whose volumetric part has the weights as they are."""
        part = replace(self.bonds.volumetric, weights=self.weights, largest_weight=self.top)
        return replace(self.bonds, volumetric=part)

    def _load(self, v: np.ndarray) -> None:
        self.T[: self.n, 3:12] = v
        self.points.halo.scatter_forward(self.T.reshape(-1, 2, ROWS, W)[:, :, 3:12])

    def _sweep(self, bound: float, products: bool) -> np.ndarray:
        bonds, (quantum, pattern) = self.bonds, pattern_for(bound)
        with np.errstate(over="ignore"):
            symmetric, other = ((-terms * integer_bits(pattern)).reshape(-1, 1, W) for terms in (
                bonds.added + bonds.taken, bonds.added - bonds.taken))  # fmt: skip
        self.TI[:, 12:18], self.TI[:, 18:21] = symmetric, other
        tables = self.T.reshape(-1), self.TI.reshape(-1), pattern, bonds.finite
        for rows, weights in zip(bonds.rows, self.weights, strict=True):
            add_divergences(*rows.arrays, *tables, weights, products, self.nearest)
        self.points.halo.scatter_reverse(self.TI.reshape(-1, 2, ROWS, W)[:, :, 12:21])
        return self.TI[: self.n, 12:21] * quantum / self.modulus
