"""Forces of the elements on the nodes, their tangent and energy, in either kinematics."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from pdfem_mpi.finite_elements.elements import Elements, TurningElements
from pdfem_mpi.finite_elements.nodes import Nodes
from pdfem_mpi.kernels import linear_elements, node_table, turning_elements
from pdfem_mpi.kernels.exact_sums import add_products
from pdfem_mpi.kernels.rounding import pattern_for

#: Elements in finite kinematics: displacements from here on count as infinite, since their cubes would be.
LARGEST_TURNING = 2.0**250


@dataclass
class ElementForces:
    """Displacements of a rank's nodes, and the forces that its elements, and the overlap, have on them.

    One evaluation calls the methods in the order in which they stand here.

    Attributes
    ----------
    nodes : Nodes
    elements : Elements or None
    tangent : bool
        The change of the forces for a small change of the displacements, at those given to `linearise`.
    u : float64, shape (n_nodes, 3), dimension length
    force : int64, shape (n_nodes, 3)
        In quanta.
    under_way : bool
        Whether displacements travel.
    """

    nodes: Nodes
    elements: Elements | None
    tangent: bool

    def __post_init__(self):
        self.u = np.zeros((len(self.nodes.number), 3))
        self.force = np.zeros((len(self.nodes.number), 3), np.int64)
        self.under_way = False

    def force_bound(self, bound: float) -> float:
        """Bound of a component of an element's force, from that of `Bounds.element`."""
        return bound * (1.0 if self.elements.finite else self.elements.bound)

    def start_forward(self, u: np.ndarray, ghosts: np.ndarray | None) -> None:
        """Take the displacements of the owned nodes, (n_owned, 3), and clear the forces. The others', (n_ghost, 3), are
        taken too where they are known; else the owned ones are sent.
        """
        self.u[: self.nodes.n_owned] = u
        self.under_way = ghosts is None
        if self.under_way:
            self.nodes.halo.start_forward(self.u)
        else:
            self.u[self.nodes.n_owned :] = ghosts
        self.force[:] = 0

    def finish_forward(self) -> None:
        """Wait for the displacements of nodes that other ranks own, if they travel."""
        if self.under_way:
            self.nodes.halo.finish_forward(self.u)

    def sweep(self, quantum: float, met: np.ndarray) -> None:
        """Add the elements' forces; the second of ``met`` is raised to what `Bounds.element` bounds."""
        if self.elements.finite:
            self._sweep_turning(quantum, met)
        else:
            self._sweep_linear(quantum, met)

    def scatter_reverse(self) -> None:
        """Add the forces on nodes that other ranks own to those of their owners. Collective."""
        self.nodes.halo.scatter_reverse(self.force)

    def read(self, quantum: float, external: np.ndarray, force: np.ndarray) -> None:
        """``force = external - internal`` of the owned nodes, (n_owned, 3)."""
        node_table.read_nodes(self.force, quantum, external, force)

    def linearise(self, u: np.ndarray) -> None:
        """Take displacements of the owned nodes for the tangent. Collective."""
        self.u[: self.nodes.n_owned] = u
        self.nodes.halo.scatter_forward(self.u)
        if self.elements:
            self.at_nodes = self.u.copy()

    def add_energy(self, u: np.ndarray, bound: float, met: np.ndarray, digits: np.ndarray) -> None:
        """Take twice the strain energy from an exact sum, at the displacements of the last evaluation. Collective.

        Parameters
        ----------
        u : float64, shape (n_owned, 3)
            Those of the owned nodes.
        bound : float
            `Bounds.element`.
        """
        if self.elements.finite:
            for part in self.elements.turning:
                energy, _, _ = measured(part, self.u)
                add_products(energy, np.full(len(energy), -2.0), digits)
            return
        quantum, _ = pattern_for(self.force_bound(bound))
        self.force[:] = 0
        self.sweep(quantum, met)
        self.scatter_reverse()
        inner = self.force[: self.nodes.n_owned] * quantum
        add_products(np.ascontiguousarray(u).reshape(-1), inner.reshape(-1), digits)

    def _sweep_linear(self, quantum: float, met: np.ndarray) -> None:
        top, nodal = np.zeros(1), (self.force, self.u)
        for part in self.elements.shared:
            linear_elements.add_shared_forces(*nodal, part.connectivity, part.stiffness, part.scale, quantum, top)
        if self.elements.general:
            part = self.elements.general
            linear_elements.add_general_forces(*nodal, part.connectivity, part.tables, part.lam, part.mu, quantum, top)
        met[1] = max(met[1], top[0])

    def _sweep_turning(self, quantum: float, met: np.ndarray) -> None:
        """Elements in finite kinematics, or their tangent."""
        top, nodal = np.zeros(2), (self.force, self.u)
        sweep = turning_elements.add_forces
        if self.tangent:
            sweep, nodal = turning_elements.add_tangent, (*nodal, self.at_nodes)
        for part in self.elements.turning:
            sweep(*nodal, part.connectivity, part.tables, part.lam, part.mu, quantum, top)
        met[1] = max(met[1], top[0] if top[1] < LARGEST_TURNING else math.inf)


def measured(part: TurningElements, u_nodes: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Strain energy, smallest ``det F``, largest ``|E|`` of each element at displacements of shape (n_nodes, 3)."""
    result = np.empty((3, len(part.connectivity)))
    turning_elements.measure(u_nodes, part.connectivity, part.tables, part.lam, part.mu, *result)
    return result[0], result[1], result[2]
