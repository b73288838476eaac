"""Bonds with a volumetric part coupled to elements, from the equations alone: dense arrays, and none of the program.

Inputs are nodes, hexahedra, which of them have bonds, which are the overlap, and moduli. Points are the eight Gauss
points of a cell; bonds have ``k = c exp(-(r / l)^2) w_i w_j g`` with ``c = 15 mu / (pi l^4)``; the energy is

    U = sum_bonds k e^2 / 2 r + 1/2 (lambda - mu) sum_i w_i theta_i^2 + U_elements,    w_i theta_i = sum_j k e / (10 mu)

and forces are its derivatives. Points of the overlap move with the nodes of their cell, whose elements have no energy.
"""

from __future__ import annotations

import itertools
import math

import numpy as np

_SIGNS = np.array([(-1, -1, -1), (1, -1, -1), (1, 1, -1), (-1, 1, -1), (-1, -1, 1), (1, -1, 1), (1, 1, 1), (-1, 1, 1)])
_PLACES = np.array([(r, s, t) for t, s, r in itertools.product((-1.0, 1.0), repeat=3)]) / math.sqrt(3.0)
_SHAPE = np.prod(1.0 + _PLACES[:, None] * _SIGNS, axis=2) / 8.0
_SLOPE = np.stack(
    [_SIGNS[:, d] * np.prod(np.delete(1.0 + _PLACES[:, None] * _SIGNS, d, axis=2), axis=2) / 8.0 for d in range(3)],
    axis=2,
)


class VolumetricBody:
    """A body whose unknowns are its free points, cell by cell, then the nodes of elements and overlap.

    Parameters
    ----------
    nodes, cells : float64, shape (n_nodes, 3), int, shape (n_cells, 8)
    kind : str of shape (n_cells,)
        "b" for bonds, "o" for the overlap, "e" for elements.
    """

    def __init__(self, nodes, cells, kind, modulus, nu, length, *, virial, finite):
        kind = np.array(list(kind))
        self.finite, self.cells = finite, cells
        self.mu, self.lam = modulus / (2.0 * (1.0 + nu)), modulus * nu / ((1.0 + nu) * (1.0 - 2.0 * nu))
        with_points = np.concatenate([np.flatnonzero(kind == "b"), np.flatnonzero(kind == "o")])
        self.free, self.tied = np.flatnonzero(kind == "b"), np.flatnonzero(kind == "o")
        self.elements = np.flatnonzero(kind == "e")
        jacobian = np.einsum("gak,cad->cgdk", _SLOPE, nodes[cells])
        self.volume = np.linalg.det(jacobian)
        self.gradient = np.einsum("cgkd,gak->cgad", np.linalg.inv(jacobian), _SLOPE)
        used = np.unique(cells[kind != "b"])
        self.node = np.full(len(nodes), -1)
        self.node[used] = np.arange(len(used))
        self.x = np.einsum("ga,cad->cgd", _SHAPE, nodes[cells[with_points]]).reshape(-1, 3)
        self.w = self.volume[with_points].reshape(-1)
        self.n_free = 8 * len(self.free)
        self.places = np.concatenate([self.x[: self.n_free], nodes[used]])
        self.xi = self.x[None] - self.x[:, None]
        self.r = np.sqrt((self.xi**2).sum(axis=2))
        bonded = (self.r > 0.0) & (self.r <= 2.5 * length * (1.0 + 1e-6))
        np.fill_diagonal(self.r, 1.0)
        c = 15.0 * self.mu / (math.pi * length**4)
        self.k = np.where(bonded, c * np.exp(-((self.r / length) ** 2)), 0.0) * np.outer(self.w, self.w)
        if virial:
            self.k = self.k * self._virial()

    def _virial(self):
        """Factors that make ``sum_j k r n_d^2 (5/4 n_d^2 - 1/4) / 2`` of each point ``5/2 mu w``: twenty sweeps."""
        n = self.xi / self.r[:, :, None]
        vector = np.ones_like(self.x)

        def factor():
            return 1.0 / np.sqrt(((n / (0.5 * (vector[:, None] + vector[None]))) ** 2).sum(axis=2))

        with np.errstate(divide="ignore"):
            for _ in range(20):
                g = np.where(self.k > 0.0, factor(), 0.0)
                stress = np.einsum("ij,ijd->id", self.k * g * self.r / 2.0, n**2 * (1.25 * n**2 - 0.25))
                vector *= 2.5 * self.mu * self.w[:, None] / stress
            return np.where(self.k > 0.0, factor(), 0.0)

    def points(self, u):
        """Displacements of all points."""
        tied = np.einsum("ga,cad->cgd", _SHAPE, u[self.n_free + self.node[self.cells[self.tied]]]).reshape(-1, 3)
        return np.concatenate([u[: self.n_free], tied])

    def force(self, u):
        """Internal forces of the unknowns, shape as ``u``, (n, 3): minus the derivative of the energy."""
        p = self.points(u)
        eta = p[None] - p[:, None]
        y = self.xi + eta if self.finite else self.xi
        size = np.sqrt((y**2).sum(axis=2))
        np.fill_diagonal(size, 1.0)
        if self.finite:
            extension = (eta * (2.0 * self.xi + eta)).sum(axis=2) / (size + self.r)
        else:
            extension = (eta * self.xi).sum(axis=2) / self.r
        theta = (self.k * extension).sum(axis=1) / (10.0 * self.mu * self.w)
        pressure = (self.lam - self.mu) * theta / (10.0 * self.mu)
        pull = self.k * (extension / self.r + pressure[:, None] + pressure[None])
        of_points = ((pull / size)[:, :, None] * y).sum(axis=1)
        total = np.zeros_like(u)
        total[: self.n_free] = of_points[: self.n_free]
        lumped = np.einsum("ga,cgd->cad", _SHAPE, of_points[self.n_free :].reshape(-1, 8, 3))
        np.add.at(total, self.n_free + self.node[self.cells[self.tied]], lumped)
        places = self.n_free + self.node[self.cells[self.elements]]
        np.add.at(total, places, self._of_elements(u[places]))
        return total

    def _of_elements(self, u):
        h = np.einsum("eai,egaj->egij", u, self.gradient[self.elements])
        strain = 0.5 * (h + h.swapaxes(2, 3))
        if self.finite:
            strain = strain + 0.5 * np.einsum("egki,egkj->egij", h, h)
        stress = self.lam * np.einsum("egkk->eg", strain)[:, :, None, None] * np.eye(3) + 2.0 * self.mu * strain
        if self.finite:
            stress = np.einsum("egik,egkj->egij", np.eye(3) + h, stress)
        return -np.einsum("egij,egaj,eg->eai", stress, self.gradient[self.elements], self.volume[self.elements])

    def solve(self, prescribed, steps=12, h=1e-6):
        """Displacements without loads where ``prescribed``, (n, 3), is not NaN; by Newton's method on differences."""
        held = ~np.isnan(prescribed)
        u = np.where(held, prescribed, 0.0)
        free = np.flatnonzero(~held.reshape(-1))
        size = np.nanmax(np.abs(prescribed))
        for _ in range(steps):
            force = self.force(u).reshape(-1)[free]
            tangent = np.empty((len(free), len(free)))
            for column, place in enumerate(free):
                moved = u.copy()
                moved.reshape(-1)[place] += h
                ahead = self.force(moved).reshape(-1)[free]
                moved.reshape(-1)[place] -= 2.0 * h
                tangent[:, column] = (ahead - self.force(moved).reshape(-1)[free]) / (2.0 * h)
            step = np.linalg.solve(tangent, -force)
            u.reshape(-1)[free] += step
            if np.abs(step).max() < 1e-12 * size:
                return u
        raise AssertionError("the dense solution did not converge")
