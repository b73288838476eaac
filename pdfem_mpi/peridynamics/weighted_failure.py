"""Failure of bonds whose stretches count by weights, for studies of criteria: what sets the load, and what breaks.

The sweeps over bonds know one critical stretch for all bonds of two classes. Here a bond has two weights of its own:
its stretch over the critical one, times the first, scales the load to the next break; times the second, it breaks the
bond. All bonds are listed and looked through at every state: for small bodies, on one rank, in linear kinematics.
"""

from __future__ import annotations

import math
from dataclasses import fields

import numpy as np

from pdfem_mpi.kernels.bond_failure import broken_energies
from pdfem_mpi.kernels.exact_sums import add_products
from pdfem_mpi.peridynamics.bonds import Bonds
from pdfem_mpi.peridynamics.clusters import point_rows
from pdfem_mpi.peridynamics.critical_stretches import UNBREAKABLE
from pdfem_mpi.peridynamics.failure import Failure, break_again
from pdfem_mpi.peridynamics.points import Points


class WeightedFailure(Failure):
    """The books of a `Failure`, with weights of single bonds."""

    @classmethod
    def of(
        cls, failure: Failure, points: Points, ids: np.ndarray, setting: np.ndarray, breaking: np.ndarray
    ) -> WeightedFailure:
        """The same books, with weights.

        Parameters
        ----------
        ids : int64, shape (n, 2)
            Points of the bonds as of `BondList.points`.
        setting, breaking : float64, shape (n,), dimension 1
            Weights of their stretches: for the load, and for the break.
        """
        self = cls(**{item.name: getattr(failure, item.name) for item in fields(failure) if item.init})
        order = np.argsort(points.cell_key, kind="stable")
        cells = order[np.searchsorted(points.cell_key, ids // 8, sorter=order)]
        self.ids, self.ends = ids, 8 * cells + ids % 8
        x = point_rows(points.x)[self.ends]
        self.vector = x[:, 1] - x[:, 0]
        self.square = (self.vector**2).sum(axis=1)
        self.setting, self.breaking, self.intact = setting, breaking, np.ones(len(ids), bool)
        limit = self.stretch[tuple(self.class_of[self.ends // 4].T)]
        self.inverse = np.where(limit < UNBREAKABLE, 1.0 / limit, 0.0)  # others do not break
        return self

    def _ratios(self, S: np.ndarray, weights: np.ndarray) -> np.ndarray:
        u = point_rows(np.ascontiguousarray(S[:, 0:3]).reshape(-1))
        stretch = ((u[self.ends[:, 1]] - u[self.ends[:, 0]]) * self.vector).sum(axis=1) / self.square
        return stretch * self.inverse * weights * self.intact

    def largest_ratio(self, comm, bonds: Bonds, S: np.ndarray, most: float = math.inf) -> float:
        """Largest stretch relative to its critical one, times its weight."""
        ratios = self._ratios(S, self.setting)
        return float(ratios[ratios <= most].max(initial=0.0))

    def break_at(self, comm, points: Points, bonds: Bonds, S: np.ndarray, margin: float) -> None:
        """Break at the table what breaks by its weight, if a bond that sets the load is critical there."""
        if self.largest_ratio(comm, bonds, S) < 1.0 - margin:
            return
        gone = np.flatnonzero(self._ratios(S, self.breaking) >= 1.0 - margin)
        self.intact[gone] = False
        for pairs, strengths, _ in break_again(points, bonds, self.ids[gone]):
            energies = np.empty(len(pairs))
            broken_energies(pairs, strengths, len(pairs), S.reshape(-1), False, energies)
            add_products(energies, np.ones(len(pairs)), self._digits)
            self._enter(points, pairs, strengths)
