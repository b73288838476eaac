"""Fitted bond factors: one symmetric factor a bond, so that every uniform strain is an equilibrium. Collective.

Because lambda = mu at nu = 1/4, the six strains times three components of a point's equilibrium are ten equations::

    sum_j k_ij g_ij n_a n_b n_c = -mu (delta_ab N_c + delta_ac N_b + delta_bc N_a)(i)        for a <= b <= c

with ``k_ij = c exp(-r^2) w_i w_j`` and the area vectors N of `boundary_areas`. The bonds come corrected by the virial
stress. The factors of smallest weighted change from it are ``1 + (v_i - v_j) . t(xi) / r^4`` times its own, with
ten multipliers ``v`` a point: one symmetric linear system for all of them, solved by conjugate gradients whose operator
is a sweep over the bonds (`bond_moments`). Its preconditioner adds the inverse 10 x 10 blocks of the points and a solve
with the operator's local limit on a background grid (`factor_grid`). Where the fit starts decides how bonds near a
surface answer to gradients of strain, which the equations leave open.

**Signs.** Factors of either sign balance any body. Positive ones, ``max(0, ...)``, are found by a semi-smooth Newton
iteration on the multipliers: the energy whose gradient is the miss of the equations is convex, so a step is too long
only where it leads up again. At corners of skewed cells no positive factors exist; there a slack ``omega v`` is
added, and once it is solved for, ``omega (v - v1)`` about that solution ``v1``: what could do without slack then has
hardly any.

**Rounding.** Bonds are stored in single precision, which would leave 1e-8 of the strain. The miss is measured with the
stored numbers and undone by the long bonds, whose numbers are a hundred times smaller and so are their last bits.

All sums over bonds, points and ranks are exact: factors have the same bits on any number of ranks.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from pdfem_mpi.kernels.moment_blocks import multiply_blocks
from pdfem_mpi.kernels.monomials import BLOCK_ENTRIES, MULTIPLICITY, N
from pdfem_mpi.kernels.rounding import pattern_for
from pdfem_mpi.kernels.simd import W
from pdfem_mpi.parallel.comm import largest, sum_integers
from pdfem_mpi.parallel.sums import exact_dots
from pdfem_mpi.peridynamics.bonds import Bonds
from pdfem_mpi.peridynamics.fit.grid import FactorGrid, share_of_long_bonds
from pdfem_mpi.peridynamics.fit.iterations import solve
from pdfem_mpi.peridynamics.fit.operator import Operator, inverse_blocks, size_of
from pdfem_mpi.peridynamics.fit.outcome import Fit
from pdfem_mpi.peridynamics.points import Points

#: Shear modulus in model units, where E = 1 and nu = 1/4.
SHEAR_MODULUS = 0.4
#: A fit ends at this residual, relative to that of the start.
TOLERANCE = 1e-9
#: Reduction of the residual by one linear solve on the way to positive factors, and most of its iterations.
INNER_REDUCTION, MOST_INNER = 1e-3, 100
#: Weight of a bond whose factor is held at 0, relative to others, in a linear solve.
HELD = 1e-6
#: Sweeps and turns after which a fit ends with what it has.
MOST_SWEEPS, MOST_TURNS = 1500, 60
#: A step towards positive factors is halved so often at most.
MOST_HALVINGS = 8
#: Slack of the points that may miss their targets, relative to the mean diagonal of the operator.
SLACK = 2e-5
#: Rounding is undone by the bonds longer than these fractions of the cutoff radius, in turn.
LONG_BONDS = (0.64, 0.8, 0.9)
#: Reduction asked of each of these turns, most iterations, and the least reduction that is used.
REFINEMENT, MOST_REFINEMENTS, LEAST_REFINEMENT = 0.02, 60, 0.7
#: Each body's clusters among the owned ones, and its background grid.
Grids = list[tuple[np.ndarray | slice, FactorGrid]]


def targets(areas: np.ndarray) -> np.ndarray:
    """The ten moments that balance a uniform strain.

    Parameters
    ----------
    areas : float64, shape (n, 3), dimension length^2
        Area vectors of whole clusters of points.

    Returns
    -------
    float64, shape (n / 4, 10, 4), dimension force
    """
    x, y, z = areas.T
    zero = np.zeros(len(areas))
    rows = np.stack([3 * x, y, z, x, zero, x, 3 * y, z, y, 3 * z], axis=1)
    return np.ascontiguousarray((-SHEAR_MODULUS * np.sqrt(MULTIPLICITY) * rows).reshape(-1, W, N).swapaxes(1, 2))


def fit_factors(
    comm,
    points: Points,
    bonds: Bonds,
    modulus: np.ndarray,
    areas: np.ndarray,
    slack: np.ndarray,
    bounded: bool,
    make_grids: Callable[[float], Grids],
    compatibility_change: float,
) -> tuple[Bonds, Fit, list[np.ndarray]]:
    """Fit the factors of bodies and write them into their bonds. Collective.

    Parameters
    ----------
    bonds : Bonds
        With the correction by the virial stress; the stored numbers are overwritten.
    modulus : float64, shape (n_materials,)
        Young's moduli in model units.
    areas : float64, shape (n_owned * 8, 3), dimension length^2
        Compatible area vectors of the owned points.
    slack, bounded : bool, shape (n_owned * 8,), and bool
        Points that may miss their targets a little; positive factors only.
    make_grids : callable
        From a weight of the slack to each body's clusters among the owned ones, and its background grid.
    compatibility_change : float
        Of the area vectors, for the report.

    Returns
    -------
    bonds, fit : Bonds, Fit
        The same rows with their new extremes.
    multipliers : list of float64, shape (n_clusters, 10, 4)
        Those of the fit, then those that undo the rounding; `write_factors` makes the same bonds from them.
    """
    operator = Operator(comm, points, bonds, modulus)
    equations = _Equations(operator, targets(areas), bounded, slack, make_grids)
    v, turns = equations.solve_bounded() if bounded else (equations.solve_free(), 1)
    multipliers = [v]
    held, smallest, top = operator.write(v, bounded)
    miss = equations.miss_of_bonds()
    for fraction in LONG_BONDS:
        nearest, to_refine = _nearest(bonds, fraction), np.where(equations.in_slack, 0.0, miss)
        v, reached = _undo_rounding(operator, equations.grids, to_refine, nearest)
        if not reached <= LEAST_REFINEMENT:
            break
        multipliers.append(v)
        held += operator.write(v, bounded, nearest)[0]
        miss = equations.miss_of_bonds()
    fit = Fit(
        signs="bounded" if bounded else "free",
        sweeps=operator.sweeps,
        turns=turns,
        **_residuals(equations, miss),
        smallest_factor=smallest,
        largest_factor=top,
        share_at_bound=held / max(int(sum_integers(comm, np.array([bonds.count]))[0]), 1),
        compatibility_change=compatibility_change,
    )
    return operator.bonds, fit, multipliers


def _residuals(equations: _Equations, miss: np.ndarray) -> dict[str, Any]:
    """What is left of the equations over the largest of their targets, outside of the slack and in it. Collective.

    Parameters
    ----------
    miss : float64, shape (n_clusters, 10, 4)
    """
    comm, goal, slack, in_slack = equations.comm, equations.goal, equations.slack, equations.in_slack
    scale = float(largest(comm, np.array([np.abs(goal).max(initial=0.0)]))[0]) or 1.0
    parts = [np.where(in_slack, 0.0, miss), np.where(in_slack, miss, 0.0)]
    peaks = largest(comm, np.array([np.abs(part).max(initial=0.0) for part in parts])) / scale
    of_bodies = np.array([np.abs(miss[clusters]).max(initial=0.0) for clusters, _ in equations.grids])
    counts = sum_integers(comm, np.array([np.count_nonzero(~slack), np.count_nonzero(slack)])).tolist()
    squares = exact_dots(comm, ((part, part) for part in parts))
    means = [math.sqrt(q / (N * max(n, 1))) / scale for q, n in zip(squares, counts, strict=True)]
    return {
        "residual": float(peaks[0]),
        "residual_in_slack": float(peaks[1]),
        "residual_rms": means[0],
        "residual_rms_in_slack": means[1],
        "residual_of_bodies": tuple((largest(comm, of_bodies) / scale).tolist()),
        "slack_points": counts[1],
    }


def write_factors(
    comm, points: Points, bonds: Bonds, modulus: np.ndarray, multipliers: list[np.ndarray], bounded: bool
) -> Bonds:
    """Write the factors of an earlier fit into bonds corrected by the virial stress: the same bits. Collective."""
    operator = Operator(comm, points, bonds, modulus)
    operator.write(multipliers[0], bounded)
    for v, fraction in zip(multipliers[1:], LONG_BONDS, strict=False):
        operator.write(v, bounded, _nearest(bonds, fraction))
    return operator.bonds


def _nearest(bonds: Bonds, fraction: float) -> float:
    return (fraction * bonds.cutoff) ** 2


def _undo_rounding(operator: Operator, grids: Grids, miss: np.ndarray, nearest: float) -> tuple[np.ndarray, float]:
    """Multipliers of the bonds longer than ``sqrt(nearest)`` that take a miss away; the reduction reached.

    The grid matters more than its share of the miss: a body bends by what varies slowly.
    """
    blocks = inverse_blocks(operator.blocks(1.0, nearest), np.zeros(miss.size // N))
    stiffness = share_of_long_bonds(nearest, operator.bonds.cutoff)

    def multiply(v, size):
        return operator.multiply(v, size, 1.0, nearest)

    def precondition(r):
        return _precondition(operator.comm, blocks, grids, stiffness, r)

    return solve(operator.comm, multiply, precondition, miss, REFINEMENT, MOST_REFINEMENTS)


def _precondition(comm, blocks: np.ndarray, grids: Grids, stiffness: float, r: np.ndarray) -> np.ndarray:
    """``B^-1 r + T (stiffness C)^-1 T^t r``."""
    z = np.empty_like(r)
    multiply_blocks(blocks, r.reshape(-1), z.reshape(-1))
    add_grids(comm, grids, stiffness, r, z)
    return z


def add_grids(comm, grids: Grids, stiffness: float, r: np.ndarray, z: np.ndarray) -> None:
    """``z += T (stiffness C)^-1 T^t r`` of all bodies. Collective."""
    quantum, _ = pattern_for(64.0 * size_of(comm, r))
    for clusters, grid in grids:
        part = z[clusters]
        grid.add_correction(comm, r[clusters], quantum, stiffness, part)
        z[clusters] = part


class _Equations:
    """The ten equations of every point, linearised about some multipliers."""

    def __init__(self, operator: Operator, goal: np.ndarray, bounded: bool, slack: np.ndarray, make_grids):
        self.operator, self.goal, self.bounded, self.comm = operator, goal, bounded, operator.comm
        self.slack = slack
        self.in_slack = np.ascontiguousarray(np.broadcast_to(slack.reshape(-1, 1, W), goal.shape))
        sums = operator.blocks(HELD)
        diagonal = np.ascontiguousarray(sums[:, BLOCK_ENTRIES.diagonal()] * MULTIPLICITY)
        (total,) = exact_dots(self.comm, [(diagonal, np.ones_like(diagonal))])
        n_points, n_slack = sum_integers(self.comm, np.array([slack.size, np.count_nonzero(slack)])).tolist()
        self.omega = SLACK * total / (N * n_points) if n_slack else 0.0
        self.blocks = inverse_blocks(sums, np.where(slack, self.omega, 0.0))
        self.grids = make_grids(self.omega)
        self.centre: np.ndarray | float = 0.0  # the slack holds about these multipliers

    def solve_free(self) -> np.ndarray:
        """Multipliers whose factors have any sign: one linear solve."""
        miss = self._miss(np.zeros_like(self.goal))
        v, _ = solve(self.comm, self._multiply, self._precondition, miss, TOLERANCE, MOST_SWEEPS)
        return v

    def solve_bounded(self) -> tuple[np.ndarray, int]:
        """Multipliers whose factors are positive: semi-smooth Newton steps; their number."""
        v = np.zeros_like(self.goal)
        miss = self._miss(v)
        first = size = math.sqrt(exact_dots(self.comm, [(miss, miss)])[0])
        turns, slack_is_new = 0, self.omega > 0.0
        while size > TOLERANCE * first and turns < MOST_TURNS and self.operator.sweeps < MOST_SWEEPS:
            if turns:
                self.blocks = inverse_blocks(self.operator.blocks(HELD), np.where(self.slack, self.omega, 0.0))
            goal = max(INNER_REDUCTION, 0.3 * TOLERANCE * first / size)
            step, _ = solve(self.comm, self._multiply, self._precondition, miss, goal, MOST_INNER)
            before, turns = size, turns + 1
            for halving in range(MOST_HALVINGS + 1):
                v += step
                miss = self._miss(v)
                square, along = exact_dots(self.comm, [(miss, miss), (step, miss)])
                size = math.sqrt(square)
                if size < before or along >= 0.0 or halving == MOST_HALVINGS:
                    break  # closer, or still on the way down: the energy along the step is convex
                v -= step
                step *= 0.5
            if slack_is_new and size <= TOLERANCE * first:
                slack_is_new, self.centre = False, v.copy()
                miss = self._miss(v)
                size = math.sqrt(exact_dots(self.comm, [(miss, miss)])[0])
        return v, turns

    def miss_of_bonds(self) -> np.ndarray:
        """What the bonds leave of the equations as they are written."""
        return self.goal - self.operator.moments(np.zeros_like(self.goal), False)

    def _miss(self, v: np.ndarray) -> np.ndarray:
        """What is left of the equations; marks the bonds whose factors are held at 0."""
        miss = self.goal - self.operator.moments(v, self.bounded)
        if self.omega:
            miss -= self.omega * np.where(self.in_slack, v - self.centre, 0.0)
        return miss

    def _multiply(self, v: np.ndarray, size: float) -> np.ndarray:
        product = self.operator.multiply(v, size, HELD)
        if self.omega:
            product += self.omega * np.where(self.in_slack, v, 0.0)
        return product

    def _precondition(self, r: np.ndarray) -> np.ndarray:
        return _precondition(self.comm, self.blocks, self.grids, 1.0, r)
