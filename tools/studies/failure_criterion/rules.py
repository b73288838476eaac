"""Rules by which bonds of this study break, in place of the program's own; they are refused elsewhere.

The one place of tools/studies that reaches into the program: a rule of failure is no public thing.
"""

from __future__ import annotations

from dataclasses import fields

import numpy as np

from pdfem_mpi import Simulation
from pdfem_mpi.kernels.bond_failure import break_listed, broken_energies
from pdfem_mpi.kernels.exact_sums import add_products
from pdfem_mpi.peridynamics.failure import Failure
from pdfem_mpi.stepping import ledger
from pdfem_mpi.stepping.steps import break_bonds as break_by_stretch


class Ruled(Failure):
    """Failure whose bonds break by a rule of `bodies.weights`; on one rank, in linear kinematics."""

    def follow(self, simulation: Simulation, setting: np.ndarray, breaking: np.ndarray) -> Ruled:
        """Take a rule for the listed bonds of a simulation; returns itself."""
        bonds, points = simulation.bonds(), simulation.model.points
        order = np.argsort(points.cell_key)
        cells = order[np.searchsorted(points.cell_key, bonds.points // 8, sorter=order)]
        self.ends = 8 * cells + bonds.points % 8
        self.vector = bonds.vector / simulation.share.units.length
        self.square = (self.vector**2).sum(axis=1)
        self.setting, self.breaking, self.left = setting, breaking, np.ones(len(self.ends), bool)
        limit = self.stretch[tuple(self.class_of[self.ends // 4].T)]
        self.inverse = np.where(limit < 1.0, 1.0 / limit, 0.0)  # others do not break
        return self

    def _ratios(self, S, weights):
        u = np.ascontiguousarray(S[:, 0:3].swapaxes(1, 2)).reshape(-1, 3)
        stretch = ((u[self.ends[:, 1]] - u[self.ends[:, 0]]) * self.vector).sum(axis=1) / self.square
        return stretch * self.inverse * weights * self.left

    def largest_ratio(self, comm, bonds, S, most=np.inf):
        """By the rule."""
        ratios = self._ratios(S, self.setting)
        return float(ratios[ratios <= most].max(initial=0.0))

    def break_at(self, model, S, margin: float) -> None:
        """Break what the rule breaks at the table, if a bond that sets the load is critical."""
        if self.largest_ratio(model.comm, model.bonds, S) < 1.0 - margin:
            return
        gone = np.flatnonzero(self._ratios(S, self.breaking) >= 1.0 - margin)
        self.left[gone] = False
        wanted = np.ascontiguousarray(self.ends[gone])
        for rows in model.bonds.rows:
            pairs, strengths = np.empty_like(wanted), np.empty(wanted.shape, np.float32)
            n = break_listed(wanted, *rows.arrays, False, pairs, strengths)
            if n:
                pairs, strengths, energies = pairs[:n].copy(), strengths[:n].copy(), np.empty(n)
                broken_energies(pairs, strengths, n, S.reshape(-1), False, energies)
                add_products(energies, np.ones(n), self._digits)
                self._enter(model.points, pairs, strengths)


def ruled(failure: Failure) -> Ruled:
    """The books of a simulation with no rule yet."""
    return Ruled(**{item.name: getattr(failure, item.name) for item in fields(failure) if item.init})


def break_by_rule(solve, failure, state, external, margin=0.0, residual=None) -> int:
    """In place of `stepping.steps.break_bonds`: by the rule of `Ruled` books."""
    if not isinstance(failure, Ruled):
        return break_by_stretch(solve, failure, state, external, margin, residual)
    forces = solve.forces
    forces.evaluate_surely(state.u, external, residual)
    failure.break_at(forces.model, forces.of_bonds.S, margin)
    count = failure.close(forces.model.comm)
    if count:
        solve.update_after_breaks(failure.take())
        forces.evaluate_surely(state.u, external, residual)
    return count


def install() -> None:
    """Let bonds break by the rules of this study."""
    ledger.break_bonds = break_by_rule
