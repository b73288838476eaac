"""Forces of bonds with a volumetric part (`volumetric`): two sweeps, and one number a point between them.

The first sweep sums the dilatations, on which nothing but displacements bear; owners make ``q = M theta / (10 mu)`` of
them and send it to the ranks that see their points; the second sweep adds the forces. The sums are made in the array
where ``q`` stands afterwards: 8 bytes a point are all that this takes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np

from pdfem_mpi.kernels import bond_response, dilatation_changes, dilatation_sweeps, dilatations, volumetric_sweeps
from pdfem_mpi.kernels.exact_sums import SIZE, add_products
from pdfem_mpi.kernels.rounding import integer_bits, pattern_for
from pdfem_mpi.kernels.simd import W
from pdfem_mpi.parallel.comm import largest, sum_integers
from pdfem_mpi.peridynamics.bond_forces import BondForces, for_breaking, interior_halves
from pdfem_mpi.peridynamics.failure import Broken, Failure
from pdfem_mpi.peridynamics.images import SCALAR, halo_for
from pdfem_mpi.peridynamics.softened_dilatations import add_dilatations, add_softened, sum_softened


@dataclass
class VolumetricForces(BondForces):
    """`BondForces` of bonds with a volumetric part.

    Attributes
    ----------
    q, qi : float64, int64, shape (n_clusters * 4,)
        Sums of the dilatations, then ``q``, of all points that the rank sees; of the tangent their changes.
    linearised : float64, shape (n_clusters * 4,), or None
        Tangent: ``q`` where it is taken.
    """

    def __post_init__(self):
        super().__post_init__()
        self.law = self.bonds.volumetric
        self.q = np.zeros(self.points.n_clusters * W)
        self.qi = self.q.view(np.int64)
        self.of_points = halo_for(self.points.halo, SCALAR)
        self.linearised = np.zeros_like(self.q) if self.tangent else None

    def force_bound(self, bound: float) -> float:
        """Bound of a component of a bond's force: a part of its own, and one of its points."""
        return super().force_bound(bound) * (1.0 if self.tangent else 2.0)

    def dilatation_bound(self, bound: float) -> float:
        """Bound of a term of the dilatations, from that of `Bounds.bond`."""
        widest, cutoff = self.law.largest_weight, self.bonds.cutoff
        if self.tangent:
            return bound * widest * cutoff
        return bound * widest * cutoff * (self.bonds.strongest if self.bonds.finite else cutoff)

    def start(self, u: np.ndarray, bound: float) -> float:
        """As of `BondForces`; and clear the sums of the dilatations."""
        quantum = super().start(u, bound)
        self._clear(self.dilatation_bound(bound))
        return quantum

    def phases(self, failure: Failure | None, margin: float, met: np.ndarray) -> Iterator[tuple[str, Callable]]:
        """As of `BondForces`; bonds break in the first sweep."""
        if failure:
            failure.released_at_points = partial(released, self)
        breaking, (first, last), sums = (failure, margin, met), interior_halves(self), self.qi.reshape(-1, 2, 1, W)
        yield "exchange", self.start_forward
        yield "bonds", partial(self._sweep_dilatations, 0, first, *breaking)
        yield "exchange", self.finish_forward
        yield "bonds", partial(self._sweep_dilatations, 1, None, *breaking)
        if self.bonds.softened:
            yield "bonds", partial(sum_softened, self, *breaking)
        yield "exchange", partial(self.of_points.start_reverse, sums)
        if last:
            yield "bonds", partial(self._sweep_dilatations, 0, last, *breaking)
        yield "exchange", partial(self.of_points.finish_reverse, sums)
        yield "bonds", partial(_make_pressures, self, met)
        yield "exchange", partial(self.of_points.start_forward, self.q.reshape(-1, 2, 1, W))
        yield "bonds", partial(self._sweep_forces, 0, first, met)
        yield "exchange", partial(self.of_points.finish_forward, self.q.reshape(-1, 2, 1, W))
        yield "bonds", partial(self._sweep_forces, 1, None, met)
        if self.bonds.softened:
            yield "bonds", partial(add_softened, self, met)
        yield "exchange", self.start_reverse
        if last:
            yield "bonds", partial(self._sweep_forces, 0, last, met)

    def linearise(self, u: np.ndarray, largest_e: float) -> None:
        """As of `BondForces`."""
        super().linearise(u, largest_e)
        self._largest_e = largest_e

    def finish_linearise(self) -> None:
        """Make ``q`` where the tangent is taken, and the deformed positions. Collective."""
        points = self.points
        points.halo.scatter_forward(self.S.reshape(-1, 2, 9, W)[:, :, 0:3])
        if self._largest_e == 0.0:
            self.q[:] = 0.0
        else:
            self.S[:, 3:6] = 2.0 * points.x.reshape(-1, 3, W) + self.S[:, 0:3]
            self._clear(self._largest_e * self.law.largest_weight * self.bonds.cutoff * self.bonds.strongest)
            for kind, rows in enumerate(self.bonds.rows):
                sweep = dilatation_sweeps.SWEEPS[True, self.series, False, self.law.is_weighted]
                shared = *self._dilatation_arguments(kind), np.zeros(2), *for_breaking(self.bonds, None, 0.0)
                self._call(sweep, rows, None, shared)
            if self.bonds.softened:
                add_dilatations(self, np.zeros(2))
            self.of_points.scatter_reverse(self.qi.reshape(-1, 2, 1, W))
            _make_pressures(self, np.zeros(2))
            self.of_points.scatter_forward(self.q.reshape(-1, 2, 1, W))
        self.linearised[:] = self.q
        self.S[:, 3:6] = points.x.reshape(-1, 3, W) + self.S[:, 0:3]

    def add_energy(self, digits: np.ndarray) -> None:
        """As of `BondForces`, with the volumetric part of the points."""
        super().add_energy(digits)
        theta = self.dilatation()
        material = self.law.material[: 2 * self.points.n_owned]
        weight = self.points.volume.reshape(-1, W)[: len(material)] * (0.5 * self.law.modulus[material])[:, None]
        add_products((weight * theta).reshape(-1), theta.reshape(-1), digits)

    def beyond_stretch(self, held: np.ndarray) -> tuple[np.ndarray, np.ndarray | float]:
        """As of `BondForces`: ``q`` of all points, and ``1/2 M theta^2``."""
        q = self.q - held if held.size else self.q
        theta = self.law.dilatation(q.reshape(-1, W)[: 2 * self.points.n_owned])
        modulus = self.law.modulus[self.law.material[: len(theta)]]
        return q, (0.5 * modulus[:, None] * theta**2).reshape(-1, 8)

    def dilatation(self) -> np.ndarray:
        """``theta`` of the owned points at the last evaluation, 0 where ``M`` is; shape (n_owned_clusters, 4)."""
        return self.law.dilatation(self.q.reshape(-1, W)[: 2 * self.points.n_owned])

    def _clear(self, bound: float) -> None:
        """Start the sums of the dilatations anew, for terms up to a bound."""
        self.dilatation_quantum, self._pattern = pattern_for(bound)
        rows = self.bonds.rows_of_point, self.bonds.rows_at_cluster
        dilatations.start_dilatations(self.qi, *rows, integer_bits(self._pattern))

    def _dilatation_arguments(self, kind: int) -> tuple:
        table = dilatation_sweeps.constants(self._pattern) if self.bonds.finite else self._pattern
        law, rows = self.law, self.bonds.rows[kind]
        return *rows.arrays, self.S.reshape(-1), self.q, self.qi, table, law.weights[kind]

    def _sweep_dilatations(self, kind: int, points: range | None, failure: Failure | None, margin, met) -> None:
        """Add the terms of interior (0) or boundary rows to the dilatations of their points; bonds break."""
        extremes, shared, rows = np.zeros(2), self._dilatation_arguments(kind), self.bonds.rows[kind]
        if self.tangent:
            sweep = dilatation_changes.CHANGES[self.series, self.law.is_weighted]
            self._call(sweep, rows, points, (*shared, extremes))
            size = extremes[0] * self.law.largest_weight
            met[0] = max(met[0], size / (self.law.largest_weight * self.bonds.cutoff))
            return
        sweep = dilatation_sweeps.SWEEPS[self.bonds.finite, self.series, failure is not None, self.law.is_weighted]
        shared = (*shared, extremes, *for_breaking(self.bonds, failure, margin))
        self._call(sweep, rows, points, shared, failure)
        met[0] = max(met[0], extremes[0], -extremes[1])

    def _sweep_forces(self, kind: int, points: range | None, met: np.ndarray) -> None:
        """Add the forces of interior (0) or boundary rows of bonds."""
        extremes, rows, weighted = np.zeros(2), self.bonds.rows[kind], self.law.is_weighted
        weights = self.law.weights[kind]
        table = self.S.reshape(-1), self.SI.reshape(-1), bond_response.constants(self.pattern)
        if self.tangent:
            sweep = volumetric_sweeps.TANGENTS[self.series, weighted]
            shared = (*rows.arrays, *table, self.linearised, weights, self.q, extremes)
        else:
            sweep = volumetric_sweeps.SWEEPS[self.bonds.finite, self.series, weighted]
            shared = (*rows.arrays, *table, self.q, weights)
        self.swept.add(volumetric_sweeps.NAMES[sweep])
        self._call(sweep, rows, points, shared)
        met[0] = max(met[0], extremes[0])


def _make_pressures(forces: VolumetricForces, met: np.ndarray) -> None:
    """``q`` of the owned points from their sums."""
    law, points, n_owned = forces.law, forces.points, 2 * forces.points.n_owned
    rows = forces.q, forces.qi, n_owned, forces.dilatation_quantum
    top = dilatations.make_pressures(*rows, law.material, law.factor, points.volume)
    if not forces.tangent:  # whose forces are looked at one by one
        strength = 1.0 if forces.bonds.finite else 2.0 * forces.bonds.stiffest
        met[0] = max(met[0], 2.0 * law.largest_weight * top * strength)


def released(forces: VolumetricForces, comm, broken: Broken) -> np.ndarray:
    """Energy of the volumetric part that bonds which the last evaluation broke or softened took away. Collective.

    ``1/2 M w (theta^2 - theta'^2)`` of every point, ``w theta' = w theta - sum A e`` over its broken bonds, and over
    what the others lost of theirs.

    Returns
    -------
    int64, shape (SIZE,)
        An exact sum over all ranks.
    """
    law, points = forces.law, forces.points
    n, digits = 2 * points.n_owned, np.zeros(SIZE, np.int64)
    listed = broken.pairs, broken.strengths, forces.S.reshape(-1), forces.bonds.finite
    terms = dilatations.listed_terms(*listed)
    if broken.share is not None:
        terms *= broken.share
    quantum, _ = pattern_for(float(largest(comm, np.array([np.abs(terms).max(initial=0.0)]))[0]))
    lost = np.zeros(points.n_clusters * W, np.int64)
    np.add.at(lost, broken.pairs.reshape(-1), np.repeat(np.rint(terms / quantum).astype(np.int64), 2))
    forces.of_points.scatter_reverse(lost.reshape(-1, 2, 1, W))
    material, volume = law.material[:n, None], points.volume.reshape(-1, W)[:n]
    change = quantum * lost.reshape(-1, W)[:n] / volume / (10.0 * law.shear[material])
    both = change + 2.0 * forces.dilatation()
    add_products((0.5 * law.modulus[material] * volume * change).reshape(-1), both.reshape(-1), digits)
    return sum_integers(comm, digits)
