"""The right-hand side (30): internal and external forces of all unknowns, in the paper's order.

Bonds and elements have their forces in `peridynamics.bond_forces` and `finite_elements.element_forces`; here stand the
order of their phases, in which messages travel while rows are swept, and the overlap between them: its points follow
the nodes (25), and their forces are lumped on the nodes (26).
"""

from __future__ import annotations

import math
from copy import copy
from dataclasses import dataclass, field
from time import perf_counter

import numpy as np

from pdfem_mpi.finite_elements.element_forces import ElementForces
from pdfem_mpi.kernels import interpolation
from pdfem_mpi.kernels.exact_sums import SIZE, value
from pdfem_mpi.kernels.rounding import pattern_for
from pdfem_mpi.model.bounds import COARSE, LARGEST, Bounds, power_above
from pdfem_mpi.model.model import Model
from pdfem_mpi.model.not_finite import NotFinite, describe_not_finite
from pdfem_mpi.model.restraints import energy_of_springs, restrain
from pdfem_mpi.parallel.comm import largest, sum_integers
from pdfem_mpi.peridynamics.bond_forces import BondForces
from pdfem_mpi.peridynamics.failure import Failure
from pdfem_mpi.peridynamics.volumetric_forces import VolumetricForces


@dataclass
class Forces:
    """Evaluates the residual force for a model.

    Attributes
    ----------
    model : Model
    bounds : Bounds
    tangent : bool
        Evaluate the tangent of finite kinematics, at the displacements given to `linearise`.
    restrained : bool
        With the forces of springs, and the mean over places that are tied.
    evaluations : int
        Sweeps over the bonds and elements so far.
    swept : set of str
        Names of the bond kernels called so far.
    met : float64, shape (2,)
        What the last evaluation met on this rank, in the order of ``bounds``.
    seconds : dict of float
        Wall time by phase: bonds, elements, exchange, other.
    of_bonds : BondForces or None
    of_nodes : ElementForces or None
        None where the model has no points, or no nodes.
    """

    model: Model
    bounds: Bounds = field(default_factory=Bounds)
    tangent: bool = False
    restrained: bool = True
    evaluations: int = 0
    swept: set[str] = field(default_factory=set)
    met: np.ndarray = field(default_factory=lambda: np.zeros(2))
    seconds: dict[str, float] = field(
        default_factory=lambda: {"bonds": 0.0, "elements": 0.0, "exchange": 0.0, "other": 0.0}
    )

    def __post_init__(self):
        model, self.of_bonds, self.of_nodes = self.model, None, None
        if model.points:
            kind = VolumetricForces if model.bonds.volumetric else BondForces
            self.of_bonds = kind(model.points, model.bonds, self.tangent, self.swept)
        if model.nodes:
            self.of_nodes = ElementForces(model.nodes, model.elements, self.tangent)

    def with_own_bounds(self) -> Forces:
        """The same forces on the same table with bounds of their own, for displacements of another size."""
        other = copy(self)
        other.bounds, other.met, other.evaluations = Bounds(), np.zeros(2), 0
        return other

    def guess_bounds(self, u: np.ndarray) -> None:
        """Set bounds that displacements of the size of ``u`` hardly meet, of linear forces or a tangent. Collective."""
        size = float(largest(self.model.comm, np.array([np.abs(u).max(initial=0.0)]))[0])
        if self.model.bonds:
            self.bounds.bond = power_above(8.0 * self.model.bonds.stiffest * size)
        if self.model.elements and self.model.elements.finite:
            size *= self.model.elements.bound
        self.bounds.element = power_above(2.0 * size)

    def evaluate(
        self,
        u: np.ndarray,
        external: np.ndarray,
        force: np.ndarray,
        failure: Failure | None = None,
        margin: float = 0.0,
        ghosts: np.ndarray | None = None,
    ) -> None:
        """``force = external - internal(u)``. Collective. Counts if `check_bounds` of all `flags` says so; else again.

        Parameters
        ----------
        u, external, force : float64, shape (n_unknowns,), dimensions length and force
            ``force`` is overwritten.
        failure : Failure, optional
            Bonds beyond their critical stretch break (4), are booked, and give no force: also where it does not count.
        margin : float
            They break this fraction below it.
        ghosts : float64, shape (n_ghost_nodes, 3), optional
            Displacements of nodes that other ranks own, where they are known here: they do not travel.
        """
        model, bonds, nodes, unknowns = self.model, self.of_bonds, self.of_nodes, self.model.unknowns
        clock, bond_quantum = _Clock(self.seconds), 0.0
        self.evaluations += 1
        with np.errstate(over="ignore", invalid="ignore"):  # NaN would pass the sweeps' comparisons
            self.met[:] = 0.0 if math.isfinite(np.dot(u, u)) else math.inf
        self.last = u, force
        if nodes:
            nodes.start_forward(unknowns.of_nodes(u), ghosts)
        if bonds:
            bond_quantum = bonds.start(unknowns.of_points(u), self.bounds.bond)
        clock.lap("other")
        if nodes:
            nodes.finish_forward()
            clock.lap("exchange")
        if bonds:
            self._sweep_bonds(failure, margin, clock)
        node_quantum = bond_quantum
        if model.elements:
            # elements may be at rest while the overlap pulls: its sums must fit the nodes' integers
            node_quantum = max(self._element_quantum(), bond_quantum if model.overlap else 0.0)
            nodes.sweep(node_quantum, self.met)
            clock.lap("elements")
        if bonds:
            bonds.finish_reverse()
            clock.lap("exchange")
            if model.overlap:
                place = model.points.n_free, model.overlap.connectivity
                interpolation.lump(nodes.force, bonds.SI, *place, bond_quantum / node_quantum)
            bonds.read(bond_quantum, unknowns.of_points(external), unknowns.of_points(force))
            clock.lap("other")
        if nodes:
            nodes.scatter_reverse()
            clock.lap("exchange")
            nodes.read(node_quantum, unknowns.of_nodes(external), unknowns.of_nodes(force))
            if len(model.rollers):
                force[model.rollers] = 0.0  # the body's mirror image answers
            clock.lap("other")
        restrain(self, u, force)

    def _sweep_bonds(self, failure: Failure | None, margin: float, clock: _Clock) -> None:
        """Sweep the bonds while displacements arrive, and send the forces on ghosts."""
        bonds = self.of_bonds
        if self.model.overlap:
            self._move_overlap()
            bonds.complete_overlap()
            clock.lap("other")
        for kind, phase in bonds.phases(failure, margin, self.met):
            phase()
            clock.lap(kind)

    def _move_overlap(self) -> None:
        """Displace the overlap's points with the nodes of their cells (25)."""
        place = self.model.points.n_free, self.model.overlap.connectivity
        interpolation.interpolate(self.of_bonds.S, *place, self.of_nodes.u)

    def _element_quantum(self) -> float:
        return pattern_for(self.of_nodes.force_bound(self.bounds.element))[0]

    def linearise(self, u: np.ndarray, largest_e: float) -> None:
        """Take the tangent at the displacements ``u``, shape (n_unknowns,), where ``|e| <= largest_e``. Collective."""
        unknowns = self.model.unknowns
        if self.of_nodes:
            self.of_nodes.linearise(unknowns.of_nodes(u))
        if self.of_bonds:
            self.of_bonds.linearise(unknowns.of_points(u), largest_e)
            if self.model.overlap:
                self._move_overlap()
            self.of_bonds.finish_linearise()

    def flags(self) -> tuple[int, int, int]:
        """This rank's votes about the bounds after an evaluation, to be added over all ranks; see `Bounds.votes`."""
        return self.bounds.votes(self.met)

    def check_bounds(self, votes: np.ndarray) -> bool:
        """Act on the summed votes: fit the bounds where needed, and say whether the evaluation counts. Collective.

        Raises
        ------
        NotFinite
            No bound can hold what the last evaluation met.
        """
        beyond, near_bond, near_element = votes
        waste = (self.model.bonds and not near_bond) or (self.model.elements and not near_element)
        if beyond or waste:
            met = largest(self.model.comm, self.met)
            if not met.max() < LARGEST:
                raise NotFinite(describe_not_finite(self.model, *self.last))
            self.bounds.fit(met)
        return not beyond

    def evaluate_surely(
        self,
        u: np.ndarray,
        external: np.ndarray,
        force: np.ndarray,
        failure: Failure | None = None,
        margin: float = 0.0,
    ) -> None:
        """`evaluate`, again until the bounds hold and fit. Collective; for use outside the solvers' loops."""
        bounds, enough = self.bounds, False
        while not enough:
            before = bounds.bond, bounds.element
            self.evaluate(u, external, force, failure, margin)
            counts = self.check_bounds(sum_integers(self.model.comm, np.array(self.flags())))
            enough = counts and before[0] <= COARSE * bounds.bond and before[1] <= COARSE * bounds.element

    def stored_energy(self, u: np.ndarray) -> float:
        """Strain energy of all bonds, elements and springs at ``u``, dimension force length. Collective.

        ``u`` are the displacements of the last evaluation, whose table the bonds are read from.
        """
        digits = np.zeros((2, SIZE), np.int64)
        if self.of_bonds:
            self.of_bonds.add_energy(digits[0])
        if self.model.elements:
            self.of_nodes.add_energy(self.model.unknowns.of_nodes(u), self.bounds.element, self.met, digits[1])
        self.evaluations += 1
        bonds, elements = (value(row) for row in sum_integers(self.model.comm, digits))
        return bonds - 0.5 * elements + energy_of_springs(self.model, u)

    def largest_ratio(self, failure: Failure, most: float = math.inf) -> float:
        """`Failure.largest_ratio` at the displacements of the last evaluation. Collective."""
        return failure.largest_ratio(self.model.comm, self.model.bonds, self.of_bonds.S, most)

    def point_displacements(self) -> np.ndarray:
        """Displacements of the owned points at the last evaluation, shape (n_owned * 8, 3), dimension length."""
        return self.of_bonds.displacements()


class _Clock:
    """Adds the time since its last lap to a phase."""

    def __init__(self, seconds: dict[str, float]):
        self.seconds, self.last = seconds, perf_counter()

    def lap(self, phase: str) -> None:
        now = perf_counter()
        self.seconds[phase] += now - self.last
        self.last = now
