"""Fictitious masses that bound the stiffness of any body, for relaxation with a time step of 1.

Central differences are stable while no eigenvalue of ``M^-1 K`` exceeds 4. Eq. (11) keeps to that in the bulk, and does
not at the free edges and corners of rods one cell thick, whose bonds point all the same way. What does is a theorem of
Gershgorin's kind, on the bonds as they are stored (`kernels.weighted_blocks`): with any positive weights of the
points, ``u^T K u <= sum_i u_i^T (B_i + C_i / d_i) u_i``, so that masses ``m_i`` of at least a quarter of the largest
eigenvalue of each of these 3x3 blocks suffice. Weights near those of the stiffest motion make the bound nearly sharp;
they are found by a power iteration, each step of which is a proof by itself.

Masses of the overlap's points pass to its nodes by the interpolation that its forces go by: squares of interpolated
displacements are at most the interpolated squares, so the bound holds there too. Elements have a bound of their own in
eq. (22), and bounds add up as stiffnesses do.

A body that eq. (11) does bound keeps its masses bit for bit. The decision is one for the whole body, and it rests on
exact sums alone: any number of ranks comes to the same masses.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pdfem_mpi.deck.programs import Ramp
from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.kernels.simd import W
from pdfem_mpi.kernels.weighted_blocks import add_weighted_blocks, stiffness_bounds
from pdfem_mpi.parallel.comm import largest, sum_integers
from pdfem_mpi.peridynamics.bonds import Bonds
from pdfem_mpi.peridynamics.images import MAGNITUDES, MIXED_PRODUCTS, SCALAR, halo_for
from pdfem_mpi.peridynamics.points import Points, sums_table
from pdfem_mpi.peridynamics.volumetric import stiffening

#: Eigenvalues of ``M^-1 K`` that central differences bear, and what raised masses leave of it: at the limit itself a
#: motion would never be damped. The tenth also covers bonds that turn and stretch in finite kinematics.
LIMIT, RAISED = 4.0, 3.6
#: Steps of the power iteration. Bodies thicker than one cell pass at the second; the last digits of the bound do not
#: matter to masses that are raised.
STEPS = 12
#: Steps that go further than the power method does, to the power of 3/2: from equal weights that is nearer.
LONG_STEPS = 2
#: Bonds of a point, at most, for the rounding of their sums. How many terms a point's sum has in fact depends on the
#: ranks, and must not matter.
MOST_BONDS = 2.0**16
#: Smallest weight, of points that take no part in the stiffest motion.
LEAST_WEIGHT = 1e-9


@dataclass(frozen=True)
class Densities:
    """Fictitious densities of the owned points.

    Attributes
    ----------
    values : float64, shape (n_owned * 8,), dimension force / length
        By cluster and lane.
    raised : int
        Points of the whole body whose density is above that of eq. (11).
    bound : float
        What no eigenvalue of the points' ``M^-1 K`` exceeds.
    """

    values: np.ndarray
    raised: int
    bound: float


def stable_densities(comm, points: Points, bonds: Bonds, densities: np.ndarray) -> Densities:
    """The densities of eq. (11) where they bound the stiffness, and raised ones where they do not. Collective.

    Parameters
    ----------
    densities : float64, shape (n_owned * 8,), dimension force / length
        From `bonds.fictitious_masses`.
    """
    weight = np.ones(len(densities))
    asked, proven, bound, blocks = np.empty_like(weight), np.inf, densities, None
    growth_of_bonds = stiffening(comm, points, bonds)
    for step in range(STEPS):
        weighted, slack = _weighted_blocks(points, bonds, weight, *growth_of_bonds)
        blocks = weighted if blocks is None else blocks  # all weights are 1 at first
        stiffness_bounds(blocks, weighted, weight, slack, asked)
        ratio = np.divide(asked, densities, out=np.where(asked > 0.0, np.inf, 0.0), where=densities > 0.0)
        worst = float(largest(comm, np.array([ratio.max(initial=0.0)]))[0])
        if step == 0 or worst < proven:
            proven, bound = worst, asked.copy()
        if proven <= LIMIT or not np.isfinite(worst):
            break
        growth = ratio / worst
        weight *= growth * np.sqrt(growth) if step < LONG_STEPS else growth
        np.clip(weight, LEAST_WEIGHT, None, out=weight)
    if proven <= LIMIT:
        return Densities(densities, 0, proven)
    values = np.maximum(densities, bound / RAISED)
    raised = int(sum_integers(comm, np.array([np.count_nonzero(values > densities)]))[0])
    return Densities(values, raised, RAISED)


def relaxes(scene: Scene) -> bool:
    """Whether a scene is meant for relaxation, and not only where conjugate gradients break down."""
    return scene.solver.kind == "adr" or isinstance(scene.stepping, Ramp)


def describe_raised(raised: int, n_points: int) -> str:
    """What a run with relaxation says of them."""
    return (
        f"relaxation: the masses of eq. (11) do not bound the stiffness here (rods one cell thick, cut corners): "
        f"{raised:,} of {n_points:,} points have larger ones."
    )


def _weighted_blocks(
    points: Points, bonds: Bonds, weight: np.ndarray, h: np.ndarray, growth: float
) -> tuple[np.ndarray, float]:
    """``C`` of the owned points for weights of at most 1, (n_points, 6), and the rounding of an entry. Collective.

    ``h`` and ``growth`` are those of `volumetric.stiffening`.
    """
    bound = 2.0 * bonds.stiffest * (1.0 + growth)
    T, _ = sums_table(points)
    n, halves = 2 * points.n_owned, []
    T[:n, 0] = weight.reshape(-1, W)
    halo_for(points.halo, SCALAR).scatter_forward(T.reshape(-1, 2, 9, W)[:, :, 0:1])
    for mixed in (False, True):
        parity = MIXED_PRODUCTS if mixed else MAGNITUDES
        sums, quantum, _ = bonds.sum_over(add_weighted_blocks, T, bound, points, parity, mixed, h)
        halves.append(sums * quantum)
    blocks = np.ascontiguousarray(np.concatenate(halves, axis=1).swapaxes(1, 2).reshape(-1, 6))
    return blocks, 0.5 * quantum * MOST_BONDS
