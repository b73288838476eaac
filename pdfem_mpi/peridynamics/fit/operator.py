"""Sums over the bonds for the ten moments of every point: the operator of the fit, its blocks, and writing factors.

Vectors over the owned points have the shape (n_clusters, 10, 4); the ten components count every entry of the
symmetric tensor once, so that their Euclidean norm is the tensor's. See `kernels/bond_moments.py` for the table and
`equations` for the fit.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from pdfem_mpi.kernels import bond_moments, moment_blocks
from pdfem_mpi.kernels.bond_moments import ROWS
from pdfem_mpi.kernels.monomials import MULTIPLICITY, N
from pdfem_mpi.kernels.rounding import integer_bits, pattern_for
from pdfem_mpi.kernels.simd import W
from pdfem_mpi.parallel.comm import largest, sum_integers
from pdfem_mpi.peridynamics.bonds import Bonds
from pdfem_mpi.peridynamics.points import Points

#: Square roots of the multiplicities, for the components of a vector.
ROOTS = np.sqrt(MULTIPLICITY)[:, None]


class Operator:
    """The bonds of the owned points as sums over ten multipliers a point; methods are collective.

    Parameters
    ----------
    comm, points, bonds
    modulus : float64, shape (n_materials,)
        Young's moduli of the materials, model units.

    Attributes
    ----------
    bonds : Bonds
        Their stored numbers are read, marked, and (by `write`) multiplied.
    modulus : float64, shape (n_clusters, 1, 1)
        Young's modulus of the bonds of the owned points: sums are for bonds of modulus 1.
    sweeps : int
        Made so far.
    """

    def __init__(self, comm, points: Points, bonds: Bonds, modulus: np.ndarray):
        self.comm, self.points, self.bonds = comm, points, bonds
        self.n = 2 * points.n_owned
        self.modulus = np.repeat(modulus[points.material[: points.n_owned]], 2).reshape(-1, 1, 1)
        self.T = np.zeros((points.n_clusters, ROWS, W))
        self.T[:, 0:3] = points.x.reshape(-1, 3, W)
        self.TI = self.T.view(np.int64)
        self.sweeps = 0

    def multiply(self, v: np.ndarray, size: float, held: float, nearest: float = 0.0) -> np.ndarray:
        """Change of the moments with the multipliers; see `add_normal_products`.

        Parameters
        ----------
        v : float64, shape (n_clusters, 10, 4)
        size : float
            Bounds the norm of each point's multipliers.
        held : float
            Weight of the marked bonds.
        nearest : float, dimension length^2
            Shorter bonds take no part.
        """
        bonds = self.bonds
        self._load(v)
        quantum, pattern = self._start(bonds.added - bonds.taken, 4.0 * bonds.stiffest * size)
        for rows in bonds.rows:
            bond_moments.add_normal_products(*rows.arrays, *self._tables, pattern, bonds.finite, held, nearest)
        return self._sums(quantum) * ROOTS

    def moments(self, v: np.ndarray, bounded: bool) -> np.ndarray:
        """The ten moments with the factors of some multipliers; bounded: marks the bonds whose factor is held at 0."""
        bonds, bound = self.bonds, 8.0 * self.bonds.strongest
        self._load(v)
        while True:
            quantum, pattern = self._start(bonds.added - bonds.taken, bound)
            peak = np.zeros(1)
            for rows in bonds.rows:
                bond_moments.add_moments(*rows.arrays, *self._tables, pattern, bonds.finite, bounded, peak)
            top = float(largest(self.comm, peak)[0])
            if top <= bound:
                return self._sums(quantum) * ROOTS
            bound = 2.0 * top

    def blocks(self, held: float, nearest: float = 0.0) -> np.ndarray:
        """Sums for the diagonal blocks of `multiply`, shape (n_points, 30)."""
        bonds = self.bonds
        sums = np.empty((self.n * W, 3 * N))
        for part in range(3):
            quantum, pattern = self._start(bonds.added + bonds.taken, 2.0 * bonds.stiffest)
            for rows in bonds.rows:
                bond_moments.add_blocks(*rows.arrays, *self._tables, pattern, bonds.finite, held, nearest, part)
            sums[:, N * part : N * part + N] = self._sums(quantum).swapaxes(1, 2).reshape(-1, N)
        return sums

    def write(self, v: np.ndarray, bounded: bool, nearest: float = 0.0) -> tuple[int, float, float]:
        """Multiply the bonds longer than ``sqrt(nearest)`` by the factors of some multipliers.

        Returns
        -------
        held : int
            Bonds whose factor is 0, on all ranks.
        smallest, largest : float
            Factors.
        """
        self._load(v)
        extremes, held = np.array([0.0, 0.0, -math.inf, -math.inf]), 0
        for rows in self.bonds.rows:
            numbers = *rows.arrays, self._tables[0]
            held += bond_moments.write_factors(*numbers, self.bonds.finite, bounded, nearest, extremes)
        strongest, stiffest, top, low = largest(self.comm, extremes).tolist()
        self.bonds = replace(self.bonds, strongest=strongest, stiffest=stiffest)
        return int(sum_integers(self.comm, np.array([held]))[0]), -low, top

    @property
    def _tables(self) -> tuple[np.ndarray, np.ndarray]:
        return self.T.reshape(-1), self.TI.reshape(-1)

    def _load(self, v: np.ndarray) -> None:
        """Take multipliers into the table, ghosts included."""
        self.T[: self.n, 3:13] = v
        self.T[: self.n, 3:13] *= ROOTS
        self.points.halo.scatter_forward(self.T.reshape(-1, 2, ROWS, W)[:, :, 3:13])

    def _start(self, excess: np.ndarray, bound: float) -> tuple[float, float]:
        """Start the sums so that the patterns of a sweep are taken back; quantum, pattern for terms up to a bound."""
        self.sweeps += 1
        quantum, pattern = pattern_for(bound)
        with np.errstate(over="ignore"):
            self.TI[:, 13:23] = (-excess * integer_bits(pattern)).reshape(-1, 1, W)
        return quantum, pattern

    def _sums(self, quantum: float) -> np.ndarray:
        self.points.halo.scatter_reverse(self.TI.reshape(-1, 2, ROWS, W)[:, :, 13:23])
        return self.TI[: self.n, 13:23] * quantum / self.modulus


def inverse_blocks(sums: np.ndarray, pinned: np.ndarray) -> np.ndarray:
    """Packed inverse blocks from the sums of `Operator.blocks`, float32, shape (n_points, 55).

    Parameters
    ----------
    pinned : float64, shape (n_points,)
        Added to the diagonals.
    """
    inverse = np.empty((len(sums), N * (N + 1) // 2), np.float32)
    moment_blocks.invert_blocks(sums, pinned, inverse)
    return inverse


def size_of(comm, v: np.ndarray) -> float:
    """A bound of the norms of all points' vectors. Collective."""
    return math.sqrt(N) * float(largest(comm, np.array([np.abs(v).max(initial=0.0)]))[0])
