"""Forces of the bonds, their tangent and energy, in a table of the points; the loops are in `kernels.bond_forces`."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np

from pdfem_mpi.kernels import bond_response, bond_sweeps, bond_tangent, point_table
from pdfem_mpi.kernels.bond_failure import add_energies
from pdfem_mpi.kernels.rounding import integer_bits, pattern_for
from pdfem_mpi.kernels.simd import W
from pdfem_mpi.peridynamics.bonds import Bonds
from pdfem_mpi.peridynamics.clusters import point_rows
from pdfem_mpi.peridynamics.failure import Failure
from pdfem_mpi.peridynamics.points import Points
from pdfem_mpi.peridynamics.rows import Rows

#: Points whose interior rows are swept between two looks at the messages under way.
CHUNK = 16384
#: Points of a cell, which are swept together.
OF_A_CELL = 8

#: What sweeps that break nothing get in place of classes, limits and records.
NOTHING_FAILS = (
    np.empty(0, np.uint8),
    np.empty(0),
    np.empty((0, 0)),
    np.empty((0, 2), np.int64),
    np.empty((0, 2), np.float32),
    np.zeros(1, np.int64),
)


@dataclass
class BondForces:
    """The bonds' forces on a rank's points. One evaluation calls the methods in the order in which they stand here.

    Attributes
    ----------
    points : Points
    bonds : Bonds
    tangent : bool
        The change of the forces for a small change of the displacements, at those given to `linearise`.
    swept : set of str
        Names of the kernels called so far.
    S, SI : float64, int64, shape (n_clusters, 9, 4)
        The table (see `kernels.bond_forces`) and its view as integers.
    """

    points: Points
    bonds: Bonds
    tangent: bool
    swept: set[str]

    def __post_init__(self):
        # a table of whole pages, so that its alignment does not vary between runs
        self.S = pages((self.points.n_clusters, 9, W))
        self.S[:, 3:6] = self.points.x.reshape(-1, 3, W)
        self.SI = self.S.view(np.int64)
        self.excess = self.bonds.added - self.bonds.taken
        self.series = False

    def phases(self, failure: Failure | None, margin: float, met: np.ndarray) -> Iterator[tuple[str, Callable]]:
        """What an evaluation does between `start` and `finish_reverse`, in order: kind of phase, and its call.

        Parameters
        ----------
        failure, margin : Failure or None, float
            Bonds beyond their critical stretch, less the margin, break and are booked there.
        met : float64, shape (2,)
            The first is raised to what `Bounds.bond` bounds.
        """
        breaking, (first, last) = (failure, margin, met), interior_halves(self)
        yield "exchange", self.start_forward
        yield "bonds", partial(self._sweep, self.bonds.interior, first, *breaking)
        yield "exchange", self.finish_forward
        yield "bonds", partial(self._sweep, self.bonds.boundary, None, *breaking)
        if self.bonds.softened:
            yield "bonds", partial(add_softened, self, *breaking)
        yield "exchange", self.start_reverse
        if last:
            yield "bonds", partial(self._sweep, self.bonds.interior, last, *breaking)

    @property
    def _has_z(self) -> bool:
        """Whether rows 3-5 of the table follow the displacements."""
        return self.bonds.finite and not self.tangent

    def force_bound(self, bound: float) -> float:
        """Bound of a component of a bond's force, from that of `Bounds.bond`."""
        if self.tangent:
            return bound
        return bound * (self.bonds.strongest if self.bonds.finite else self.bonds.cutoff)

    def start(self, u: np.ndarray, bound: float) -> float:
        """Take the displacements of the free points, in cluster layout, and clear the forces; the quantum of these."""
        self.quantum, self.pattern = pattern_for(self.force_bound(bound))
        self.series = self.series if self.tangent else self.bonds.finite and bound <= bond_response.SERIES_LIMIT
        table = self.points.x, self.S.reshape(-1), self.SI.reshape(-1)
        point_table.start_evaluation(u, *table, self._has_z, self.excess, integer_bits(self.pattern))
        return self.quantum

    def complete_overlap(self) -> None:
        """Follow the displacements of the overlap's points, which have just been written."""
        if self._has_z:
            points = self.points
            point_table.complete_z(2 * points.n_free, 2 * points.n_owned, points.x, self.S.reshape(-1))

    def start_forward(self) -> None:
        """Send displacements to the ranks that have the points as ghosts."""
        self.points.halo.start_forward(self.S.reshape(-1, 2, 9, W)[:, :, 0:3])

    def finish_forward(self) -> None:
        """Wait for the displacements of the ghosts and images, and follow them."""
        points = self.points
        points.halo.finish_forward(self.S.reshape(-1, 2, 9, W)[:, :, 0:3])
        if self._has_z:
            point_table.complete_z(2 * points.n_owned, points.n_clusters, points.x, self.S.reshape(-1))

    def start_reverse(self) -> None:
        """Send the forces on ghosts to their owners."""
        self.points.halo.start_reverse(self.SI.reshape(-1, 2, 9, W)[:, :, 6:9])

    def finish_reverse(self) -> None:
        """Wait for the forces that other ranks have for owned points."""
        self.points.halo.finish_reverse(self.SI.reshape(-1, 2, 9, W)[:, :, 6:9])

    def read(self, quantum: float, external: np.ndarray, force: np.ndarray) -> None:
        """``force = external - internal`` of the free points, in cluster layout."""
        point_table.read_forces(self.SI.reshape(-1), quantum, external, force)

    def linearise(self, u: np.ndarray, largest_e: float) -> None:
        """Take displacements of the free points for the tangent, where ``|e| <= largest_e`` on all bonds."""
        points = self.points
        self.series = largest_e <= bond_response.SERIES_LIMIT
        point_table.load_displacements(u, points.x, self.S.reshape(-1), 2 * points.n_free, False)

    def finish_linearise(self) -> None:
        """Make the deformed positions, once the overlap's points are displaced too. Collective."""
        self.points.halo.scatter_forward(self.S.reshape(-1, 2, 9, W)[:, :, 0:3])
        self.S[:, 3:6] = self.points.x.reshape(-1, 3, W) + self.S[:, 0:3]

    def add_energy(self, digits: np.ndarray) -> None:
        """Add the strain energy at the displacements of the last evaluation to an exact sum."""
        for rows in self.bonds.rows:
            add_energies(*rows.arrays, self.S.reshape(-1), self.bonds.finite, digits)
        if self.bonds.softened:
            self.bonds.softened.add_energies(self.S.reshape(-1), digits)

    def beyond_stretch(self, held: np.ndarray) -> tuple[np.ndarray, np.ndarray | float]:
        """For `virial`: what the forces of a point's bonds have in common, less what a thermal strain gives them
        (``held``, shape (n_clusters * 4,), or empty), and the energy density that is the point's own."""
        return np.empty(0), 0.0

    def displacements(self) -> np.ndarray:
        """Those of the owned points at the last evaluation, shape (n_owned * 8, 3), dimension length."""
        return point_rows(np.ascontiguousarray(self.S[: 2 * self.points.n_owned, 0:3]).reshape(-1))

    def _sweep(self, rows: Rows, points: range | None, failure, margin, met) -> None:
        """Add the forces of rows of bonds, of all points or some; parameters as of `phases`."""
        extremes = np.zeros(2)
        table = self.S.reshape(-1), self.SI.reshape(-1), bond_response.constants(self.pattern)
        shared = (*rows.arrays, *table, extremes)
        if self.tangent:
            sweep = bond_tangent.add_tangent_series if self.series else bond_tangent.add_tangent_closed
            self.swept.add(bond_tangent.NAMES[sweep])
        else:
            sweep = bond_sweeps.SWEEPS[self.bonds.finite, self.series, failure is not None]
            self.swept.add(bond_sweeps.NAMES[sweep])
            shared += for_breaking(self.bonds, failure, margin)
        self._call(sweep, rows, points, shared, failure)
        met[0] = max(met[0], extremes[0], -extremes[1])

    def _call(self, sweep: Callable, rows: Rows, points: range | None, shared: tuple, failure=None) -> None:
        """Call a sweep over points in pieces, book what broke in each, and let messages progress."""
        points = range(len(rows.start) - 1) if points is None else points
        for start in points[::CHUNK]:
            first, last = start, min(start + CHUNK, points.stop)
            while first < last:
                first = sweep(first, last, *shared)
                if failure:
                    failure.book(self.points, self.bonds, self.S)
            self.points.halo.test()


def interior_halves(forces: BondForces) -> tuple[range, range]:
    """Points whose interior rows are swept while displacements travel, and those while forces do.

    All are in the first range where nothing travels, and where bonds soften: softened ones come after all others, and
    before the forces on ghosts are sent.
    """
    start = forces.bonds.interior.start
    middle = n = len(start) - 1
    if forces.points.halo.neighbours and not forces.bonds.softened:
        middle = int(np.searchsorted(start, start[-1] // 2)) // OF_A_CELL * OF_A_CELL
    return range(middle), range(middle, n)


def add_softened(forces: BondForces, failure: Failure | None, margin: float, met: np.ndarray) -> None:
    """Add the forces of bonds that have softened, once those that go on in this sweep have done so."""
    softened = forces.bonds.softened
    if failure:
        failure.advance(forces.points, forces.S, margin)
    forces.swept.add("tangent, softened" if forces.tangent else "softened")
    add = softened.add_tangent if forces.tangent else softened.add_forces
    met[0] = max(met[0], add(forces.S.reshape(-1), forces.SI.reshape(-1), forces.quantum))


def pages(shape: tuple[int, ...]) -> np.ndarray:
    """Zeros on a page boundary, float64."""
    size = 8 * int(np.prod(shape))
    raw = np.zeros(size + 4096, np.uint8)
    start = -raw.ctypes.data % 4096
    return raw[start : start + size].view(np.float64).reshape(shape)


def for_breaking(bonds: Bonds, failure: Failure | None, margin: float) -> tuple:
    """What sweeps that may break bonds take besides."""
    if failure is None:
        return NOTHING_FAILS
    return failure.class_of, *failure.limits(bonds.finite, margin), *failure.records
