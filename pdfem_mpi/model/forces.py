"""The right-hand side (30): internal and external forces of all unknowns, in the paper's order.

Unknowns are flat vectors: free points in cluster layout, then owned nodes. The overlap's points follow the nodes
(25), and their forces are lumped on the nodes (26).
"""

from __future__ import annotations

import math
from copy import copy
from dataclasses import dataclass, field
from time import perf_counter

import numpy as np

from pdfem_mpi.kernels import finite_elements, overlap, peridynamics, turning_elements
from pdfem_mpi.kernels.exact_sums import SIZE, add_products, value
from pdfem_mpi.kernels.failure import add_energies
from pdfem_mpi.kernels.simd import W
from pdfem_mpi.model.model import Model, TurningElements
from pdfem_mpi.model.unknowns import point_rows
from pdfem_mpi.parallel.comm import agree, largest, sum_integers
from pdfem_mpi.peridynamics.bonds import integer_bits, pattern_for
from pdfem_mpi.peridynamics.failure import Failure

#: Points whose interior rows are swept between two looks at the messages under way.
CHUNK = 16384
#: Bounds are powers of two, at least this much above what was met, so that they are rarely met again.
HEADROOM = 2.0
#: A bound this much above what is met is lowered: it costs digits.
SLACK = 2.0**8
#: An evaluation with a bound this much above the fitting one lacks digits.
COARSE = 2.0**16
#: Numbers from here on count as infinite: their products would be.
LARGEST = 2.0**400
#: Elements in finite kinematics: displacements from here on count as infinite, since their cubes would be.
LARGEST_TURNING = 2.0**250

#: What sweeps that break nothing get in place of classes, limits and records.
NOTHING_FAILS = (
    np.empty(0, np.uint8),
    np.empty(0),
    np.empty((0, 0)),
    np.empty((0, 2), np.int64),
    np.empty((0, 2), np.float32),
    np.zeros(1, np.int64),
)


class NotFinite(Exception):
    """A displacement or a force is not finite; the sentence names its point or node. Raised on all ranks alike."""


@dataclass
class Bounds:
    """What the quanta of the order-independent sums rest on; equal on all ranks, part of the state.

    Attributes
    ----------
    bond : float
        Bound of ``|e|`` (finite kinematics, dimension 1), of ``|K' eta . xi|`` (linear, force / length), or of a
        component of a bond's force (tangent, force).
    element : float
        Bound of the differences of displacements within an element (linear, length), or of a component of an element's
        force (finite kinematics and tangent, force).
    parts : dict of Bounds
        Those of other forces that a run keeps: the preconditioner's cycle, a tangent. See `part`.

    They start generous: the first evaluations then count, with fewer digits.
    """

    bond: float = 2.0**-3
    element: float = 2.0**-3
    parts: dict[str, Bounds] = field(default_factory=dict)

    def part(self, name: str) -> Bounds:
        """The bounds of other forces; new ones if they were not asked for before."""
        return self.parts.setdefault(name, Bounds())

    def expect(self, change: np.ndarray, from_rest: bool) -> None:
        """Make room for displacements that change by what meets at most ``change``, in the order of `Forces.met`."""
        self.bond, self.element = (
            _power_above(float(more) + (0.0 if from_rest else bound))
            for more, bound in zip(change, (self.bond, self.element), strict=True)
        )


@dataclass
class Forces:
    """Evaluates the residual force for a model.

    Attributes
    ----------
    model : Model
    bounds : Bounds
    tangent : bool
        Evaluate the tangent of finite kinematics, at the displacements given to `linearise`.
    evaluations : int
        Sweeps over the bonds and elements so far.
    swept : set of str
        Names of the bond kernels called so far.
    met : float64, shape (2,)
        What the last evaluation met on this rank, in the order of ``bounds``.
    seconds : dict of float
        Wall time by phase: bonds, elements, exchange, other.
    """

    model: Model
    bounds: Bounds = field(default_factory=Bounds)
    tangent: bool = False
    evaluations: int = 0
    swept: set[str] = field(default_factory=set)
    met: np.ndarray = field(default_factory=lambda: np.zeros(2))
    seconds: dict[str, float] = field(
        default_factory=lambda: {"bonds": 0.0, "elements": 0.0, "exchange": 0.0, "other": 0.0}
    )

    def __post_init__(self):
        model, self.series = self.model, False
        if model.points:
            # a table of whole pages, so that its alignment does not vary between runs
            self.S = pages((model.points.n_clusters, 9, W))
            self.S[:, 3:6] = model.points.x.reshape(-1, 3, W)
            self.SI = self.S.view(np.int64)
            self.excess = model.bonds.added - model.bonds.taken
        if model.nodes:
            self.u_nodes = np.zeros((len(model.nodes.number), 3))
            self.force_nodes = np.zeros((len(model.nodes.number), 3), np.int64)

    def with_own_bounds(self) -> Forces:
        """The same forces on the same table with bounds of their own, for displacements of another size."""
        other = copy(self)
        other.bounds, other.met, other.evaluations = Bounds(), np.zeros(2), 0
        return other

    def guess_bounds(self, u: np.ndarray) -> None:
        """Set bounds that displacements of the size of ``u`` hardly meet, of linear forces or a tangent. Collective."""
        size = float(largest(self.model.comm, np.array([np.abs(u).max(initial=0.0)]))[0])
        if self.model.bonds:
            self.bounds.bond = _power_above(8.0 * self.model.bonds.stiffest * size)
        if self.model.elements and self.model.elements.finite:
            size *= self.model.elements.bound
        self.bounds.element = _power_above(2.0 * size)

    def evaluate(
        self,
        u: np.ndarray,
        external: np.ndarray,
        force: np.ndarray,
        failure: Failure | None = None,
        margin: float = 0.0,
    ) -> None:
        """Compute ``force = external - internal(u)``. Collective.

        The result counts only if `check_bounds` of all ranks' `flags` says so; else evaluate again.

        Parameters
        ----------
        u : float64, shape (n_unknowns,), dimension length
        external, force : float64, shape (n_unknowns,), dimension force
            ``force`` is overwritten.
        failure : Failure, optional
            Bonds beyond their critical stretch break (4), are booked there, and give no force. They are broken also
            where the result does not count.
        margin : float
            They break this fraction below it.
        """
        model, clock = self.model, _Clock(self.seconds)
        points, bonds, nodes = model.points, model.bonds, model.nodes
        unknowns = model.unknowns
        self.evaluations += 1
        with np.errstate(over="ignore", invalid="ignore"):  # NaN would pass the sweeps' comparisons
            self.met[:] = 0.0 if math.isfinite(np.dot(u, u)) else math.inf
        self.last = u, force
        if nodes:
            self.u_nodes[: nodes.n_owned] = unknowns.of_nodes(u)
            nodes.halo.start_forward(self.u_nodes)
            self.force_nodes[:] = 0
        if points:
            flat, blocks = self.S.reshape(-1), self.S.reshape(-1, 2, 9, W)
            has_z = bonds.finite and not self.tangent
            bond_quantum, pattern = pattern_for(self._bond_force_bound())
            peridynamics.load_displacements(unknowns.of_points(u), points.x, flat, 2 * points.n_free, has_z)
            peridynamics.reset_forces(self.SI.reshape(-1), self.excess, integer_bits(pattern))
        clock.lap("other")
        if nodes:
            nodes.halo.finish_forward(self.u_nodes)
            clock.lap("exchange")
        if points:
            if model.overlap:
                overlap.interpolate(self.S, points.n_free, model.overlap.connectivity, self.u_nodes)
                if has_z:
                    peridynamics.complete_z(2 * points.n_free, 2 * points.n_owned, points.x, flat)
                clock.lap("other")
            points.halo.start_forward(blocks[:, :, 0:3])
            clock.lap("exchange")
            breaking = failure, failure.limits(bonds.finite, margin) if failure else ()
            self._sweep_bonds(bonds.interior, pattern, breaking, points.halo)
            clock.lap("bonds")
            points.halo.finish_forward(blocks[:, :, 0:3])
            clock.lap("exchange")
            if has_z:
                peridynamics.complete_z(2 * points.n_owned, points.n_clusters, points.x, flat)
            self._sweep_bonds(bonds.boundary, pattern, breaking)
            clock.lap("bonds")
            points.halo.start_reverse(self.SI.reshape(-1, 2, 9, W)[:, :, 6:9])
            clock.lap("exchange")
        if model.elements:
            node_quantum, _ = pattern_for(self._element_force_bound())
            if model.overlap:
                # elements may be at rest while the overlap pulls: its sums must fit the nodes' integers
                node_quantum = max(node_quantum, bond_quantum)
            self._sweep_elements(node_quantum)
            clock.lap("elements")
        elif nodes:
            node_quantum = bond_quantum
        if points:
            points.halo.finish_reverse(self.SI.reshape(-1, 2, 9, W)[:, :, 6:9])
            clock.lap("exchange")
            if model.overlap:
                ratio = bond_quantum / node_quantum
                overlap.lump(self.force_nodes, self.SI, points.n_free, model.overlap.connectivity, ratio)
            of_points = unknowns.of_points(external), unknowns.of_points(force)
            peridynamics.read_forces(self.SI.reshape(-1), bond_quantum, *of_points)
            clock.lap("other")
        if nodes:
            nodes.halo.scatter_reverse(self.force_nodes)
            clock.lap("exchange")
            of_nodes = unknowns.of_nodes(force)
            np.multiply(self.force_nodes[: nodes.n_owned], node_quantum, out=of_nodes)
            of_nodes += unknowns.of_nodes(external)
            if len(model.rollers):
                force[model.rollers] = 0.0  # the body's mirror image answers
            clock.lap("other")

    def linearise(self, u: np.ndarray, largest_e: float) -> None:
        """Take the tangent at the displacements ``u``, shape (n_unknowns,), where ``|e| <= largest_e``. Collective."""
        model = self.model
        self.series = largest_e <= peridynamics.SERIES_LIMIT
        points, unknowns = model.points, model.unknowns
        if model.nodes:
            self.u_nodes[: model.nodes.n_owned] = unknowns.of_nodes(u)
            model.nodes.halo.scatter_forward(self.u_nodes)
        if model.elements:
            self.at_nodes = self.u_nodes.copy()
        if not points:
            return
        peridynamics.load_displacements(unknowns.of_points(u), points.x, self.S.reshape(-1), 2 * points.n_free, False)
        if model.overlap:
            overlap.interpolate(self.S, points.n_free, model.overlap.connectivity, self.u_nodes)
        points.halo.scatter_forward(self.S.reshape(-1, 2, 9, W)[:, :, 0:3])
        self.S[:, 3:6] = points.x.reshape(-1, 3, W) + self.S[:, 0:3]

    def flags(self) -> tuple[int, int, int]:
        """This rank's votes about the bounds, to be added over all ranks.

        Returns
        -------
        beyond : int
            1 if the last evaluation met more than a bound: it does not count on any rank.
        near_bond, near_element : int
            1 unless so little was met that the bound wastes digits.
        """
        bond, element = self.met
        bounds = self.bounds
        beyond = not (bond <= bounds.bond and element <= bounds.element)
        return int(beyond), int(bond * SLACK >= bounds.bond), int(element * SLACK >= bounds.element)

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
                raise NotFinite(self.describe_not_finite(*self.last))
            self.bounds.bond = _fitted(self.bounds.bond, float(met[0]))
            self.bounds.element = _fitted(self.bounds.element, float(met[1]))
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
        """Strain energy of all bonds and elements at ``u``, dimension force length, an exact sum. Collective.

        ``u`` are the displacements of the last evaluation, whose table the bonds are read from.
        """
        model = self.model
        digits = np.zeros((2, SIZE), np.int64)
        if model.bonds:
            for rows in model.bonds.rows:
                add_energies(*rows.arrays, self.S.reshape(-1), model.bonds.finite, digits[0])
        if model.elements and model.elements.finite:
            for part in model.elements.turning:
                energy, _, _ = measured(part, self.u_nodes)
                add_products(energy, np.full(len(energy), -2.0), digits[1])
        elif model.elements:
            quantum, _ = pattern_for(self._element_force_bound())
            self.force_nodes[:] = 0
            self._sweep_elements(quantum)
            model.nodes.halo.scatter_reverse(self.force_nodes)
            inner = self.force_nodes[: model.nodes.n_owned] * quantum
            add_products(np.ascontiguousarray(model.unknowns.of_nodes(u)).reshape(-1), inner.reshape(-1), digits[1])
        self.evaluations += 1
        bonds, elements = (value(row) for row in sum_integers(model.comm, digits))
        return bonds - 0.5 * elements

    def point_displacements(self) -> np.ndarray:
        """Displacements of the owned points at the last evaluation, shape (n_owned * 8, 3), dimension length."""
        owned = self.S[: 2 * self.model.points.n_owned, 0:3]
        return point_rows(np.ascontiguousarray(owned).reshape(-1))

    def describe_not_finite(self, u: np.ndarray, force: np.ndarray) -> str:
        """A sentence that names the first point or node whose displacement, or else force, is not finite. Collective.

        Parameters
        ----------
        u, force : float64, shape (n_unknowns,)
            Displacements, and the residual force on them.
        """
        for what, values in (("displacement", u), ("force", force)):
            if places := agree(self.model.comm, self._places_not_finite(values)):
                return f"the {what} of {places[0]} is not finite."
        return "a sum over the unknowns is not finite."

    def _places_not_finite(self, values: np.ndarray) -> list[str]:
        """This rank's first point and first node with such a value."""
        model, places = self.model, []

        def first_of(rows):
            return np.flatnonzero(~(np.abs(rows) < LARGEST).all(axis=1))[:1]

        if model.points:
            x, cell = point_rows(model.points.x), model.points.cell_number
            of_points = point_rows(model.unknowns.of_points(values))
            places += [("point", 8 * cell[i // 8] + i % 8, x[i]) for i in first_of(of_points)]
        if model.nodes:
            number, x = model.nodes.number, model.nodes.x
            places += [("node", number[i], x[i]) for i in first_of(model.unknowns.of_nodes(values))]
        units = model.units
        return [
            f"{kind} {number} at ({', '.join(f'{c:.6g}' for c in x * units.length + units.origin)})"
            for kind, number, x in places
        ]

    def _bond_force_bound(self) -> float:
        """Bound of a component of a bond's force."""
        bonds = self.model.bonds
        if self.tangent:
            return self.bounds.bond
        return self.bounds.bond * (bonds.strongest if bonds.finite else bonds.cutoff)

    def _element_force_bound(self) -> float:
        """Bound of a component of an element's force."""
        elements = self.model.elements
        return self.bounds.element * (1.0 if elements.finite else elements.bound)

    def _sweep_bonds(self, rows, pattern, breaking, halo=None) -> None:
        bonds = self.model.bonds
        failure, limits = breaking
        extremes = np.zeros(2)
        shared = (*rows.arrays, self.S.reshape(-1), self.SI.reshape(-1), peridynamics.constants(pattern), extremes)
        if self.tangent:
            sweep = peridynamics.add_tangent_series if self.series else peridynamics.add_tangent_closed
        else:
            series = bonds.finite and self.bounds.bond <= peridynamics.SERIES_LIMIT
            sweep = peridynamics.SWEEPS[bonds.finite, series, failure is not None]
            shared += (failure.class_of, *limits, *failure.records) if failure else NOTHING_FAILS
        self.swept.add(peridynamics.NAMES[sweep])
        n_points = len(rows.start) - 1
        for start in range(0, n_points, CHUNK):
            first, last = start, min(start + CHUNK, n_points)
            while first < last:
                first = sweep(first, last, *shared)
                if failure:
                    failure.book(self.model, self.S)
            if halo is not None:
                halo.test()
        self.met[0] = max(self.met[0], extremes[0], -extremes[1])

    def _sweep_elements(self, quantum) -> None:
        elements = self.model.elements
        if elements.finite:
            self._sweep_turning(quantum)
            return
        met = np.zeros(1)
        for part in elements.shared:
            finite_elements.add_shared_forces(
                self.force_nodes, self.u_nodes, part.connectivity, part.stiffness, part.scale, quantum, met
            )
        if elements.general:
            part = elements.general
            finite_elements.add_general_forces(
                self.force_nodes,
                self.u_nodes,
                part.connectivity,
                part.tables,
                part.lam,
                part.mu,
                quantum,
                met,
            )
        self.met[1] = max(self.met[1], met[0])

    def _sweep_turning(self, quantum) -> None:
        """Elements in finite kinematics, or their tangent."""
        met, nodal = np.zeros(2), (self.force_nodes, self.u_nodes)
        sweep = turning_elements.add_forces
        if self.tangent:
            sweep, nodal = turning_elements.add_tangent, (*nodal, self.at_nodes)
        for part in self.model.elements.turning:
            sweep(*nodal, part.connectivity, part.tables, part.lam, part.mu, quantum, met)
        self.met[1] = max(self.met[1], met[0] if met[1] < LARGEST_TURNING else math.inf)


def measured(part: TurningElements, u_nodes: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Strain energy, smallest ``det F``, largest ``|E|`` of each element at displacements of shape (n_nodes, 3)."""
    result = np.empty((3, len(part.connectivity)))
    turning_elements.measure(u_nodes, part.connectivity, part.tables, part.lam, part.mu, *result)
    return result[0], result[1], result[2]


def _fitted(bound: float, met: float) -> float:
    if met > bound or met * SLACK < bound:
        return _power_above(HEADROOM * met)
    return bound


def _power_above(x: float) -> float:
    return 2.0 ** math.frexp(max(x, 2.0**-199))[1]


def pages(shape: tuple[int, ...]) -> np.ndarray:
    """Zeros on a page boundary, float64."""
    size = 8 * int(np.prod(shape))
    raw = np.zeros(size + 4096, np.uint8)
    start = -raw.ctypes.data % 4096
    return raw[start : start + size].view(np.float64).reshape(shape)


class _Clock:
    """Adds the time since its last lap to a phase."""

    def __init__(self, seconds: dict[str, float]):
        self.seconds, self.last = seconds, perf_counter()

    def lap(self, phase: str) -> None:
        now = perf_counter()
        self.seconds[phase] += now - self.last
        self.last = now
