"""Preconditioner of conjugate gradients: ``P r = T V T^t r + omega B^-1 r``.

``T`` interpolates trilinearly from the nodes of each cell to its points and is the identity on the scene's own nodes;
``V`` is one symmetric cycle for the finite-element model of the intact body on the same cells, the local limit of
the bonds: block smoothing, a correction on a background grid (`grid`), block smoothing. ``B`` are the 3x3 blocks
of the surviving bonds and of the elements (`blocks`). Only ``B`` changes when bonds break.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pdfem_mpi.body.share import Share
from pdfem_mpi.finite_elements.nodes import local_nodes
from pdfem_mpi.kernels import cycle_steps
from pdfem_mpi.kernels.multigrid import correct_points, restrict_points
from pdfem_mpi.kernels.node_table import add_rounded_rows
from pdfem_mpi.kernels.rounding import pattern_for
from pdfem_mpi.model.bounds import COARSE, Bounds, power_above
from pdfem_mpi.model.forces import Forces
from pdfem_mpi.model.loads import LoadCase
from pdfem_mpi.model.model import Model, build_intact_elements
from pdfem_mpi.model.restraints import tie
from pdfem_mpi.parallel.comm import sum_integers
from pdfem_mpi.peridynamics.clusters import point_rows
from pdfem_mpi.peridynamics.failure import Broken
from pdfem_mpi.peridynamics.point_blocks import PointBlocks, point_blocks
from pdfem_mpi.solvers.preconditioner.blocks import inverted, node_blocks, softest, with_springs
from pdfem_mpi.solvers.preconditioner.coarse_grid import Grid
from pdfem_mpi.solvers.preconditioner.cycle import Cycle, make_cycle, stiffest_around

#: Weight of the blocks beside the cycle.
OMEGA = 0.8


@dataclass
class Preconditioner:
    """One rank's part of the preconditioner; made by `make_preconditioner`.

    Attributes
    ----------
    model : Model
    of_points : PointBlocks or None
        What the inverse blocks of points are made from.
    fixed_points : bool, shape (n_free * 8, 3)
    softest : float64, shape (n_free * 8,), dimension force / length
        Limits of their inversion, that of the intact body.
    blocks : float64, shape (n_triples, 6)
        Inverse blocks of free points, then of owned nodes.
    of_springs : float64, shape (n_triples, 3), dimension force / length, or None
        Stiffness of springs in them.
    forces : Forces
        Of the intact finite-element model.
    cells : int32, shape (n_free, 8)
        Its local nodes of the cells with free points.
    own_nodes : int32, shape (n_owned_nodes,)
        Its local nodes that are the scene's own.
    fixed : bool, shape (n_cycle_unknowns,)
        Of all nodes that the cycle sees, the rank's own first.
    cycle : Cycle
    """

    model: Model
    of_points: PointBlocks | None
    fixed_points: np.ndarray
    softest: np.ndarray
    blocks: np.ndarray
    of_springs: np.ndarray | None
    forces: Forces
    cells: np.ndarray
    own_nodes: np.ndarray
    fixed: np.ndarray
    cycle: Cycle

    @property
    def grid(self) -> Grid:
        """The coarse level."""
        return self.cycle.grid

    @cached_property
    def held(self) -> tuple[np.ndarray, np.ndarray]:
        """Places of the fixed unknowns of the cycle: of the rank's own nodes, and of all that it sees."""
        return np.flatnonzero(self.fixed[: len(self.cycle.fixed) * 3]), np.flatnonzero(self.fixed)

    def apply(self, r: np.ndarray, size: float, z: np.ndarray) -> None:
        """``z = P r``. Collective.

        The result counts only if `check_bounds` of all ranks' `flags` says so; else apply again.

        Parameters
        ----------
        r : float64, shape (n_unknowns,), dimension force
            0 on fixed unknowns.
        size : float, dimension force
            A bound of ``|r_i|``, equal on all ranks. The cycle works on ``r`` over the power of two above it, so that
            what it meets, and with that its bounds, stay of one size while the residual falls.
        z : float64, shape (n_unknowns,), dimension length
            Overwritten; 0 on fixed unknowns.
        """
        unknowns, nodes = self.model.unknowns, self.forces.model.nodes
        quantum, scale = pattern_for(64.0)[0], power_above(size)
        sums = np.zeros((len(nodes.number), 3), np.int64)
        restrict_points(self.cells, unknowns.of_points(r), quantum * scale, sums)
        add_rounded_rows(self.own_nodes, unknowns.of_nodes(r), quantum * scale, sums)
        nodes.halo.scatter_reverse(sums)
        correction = np.zeros((len(nodes.number), 3))
        self._cycle(sums, quantum, scale, correction)
        nodes.halo.scatter_forward(correction)
        n, of_points = unknowns.n_points, (unknowns.of_points(vector) for vector in (r, z))
        correct_points(self.cells, correction, self.blocks[:n], OMEGA, *of_points)
        of_nodes = (unknowns.of_nodes(vector) for vector in (r, z))
        cycle_steps.correct_nodes(self.own_nodes, correction, self.blocks[n:], OMEGA, *of_nodes)
        tie(self.model, z)

    def apply_surely(self, r: np.ndarray, size: float, z: np.ndarray) -> None:
        """`apply`, again until the bounds hold and fit. Collective; for where no sum of others is due."""
        bounds, enough = self.forces.bounds, False
        while not enough:
            before = bounds.element
            self.apply(r, size, z)
            counts = self.check_bounds(sum_integers(self.model.comm, np.array(self.flags())))
            enough = counts and before <= COARSE * bounds.element

    def flags(self) -> tuple[int, int, int]:
        """This rank's votes about the bounds of the last cycle, as `Forces.flags`."""
        return self.forces.flags()

    def check_bounds(self, votes: np.ndarray) -> bool:
        """Act on the summed votes, as `Forces.check_bounds`. Collective."""
        return self.forces.check_bounds(votes)

    def update_after_breaks(self, broken: Broken) -> None:
        """Renew the blocks of points that lost bonds; nodes of the overlap keep theirs. Collective."""
        points = self.of_points.take_out(self.model.points, self.model.bonds, broken)
        points = points[points < len(self.fixed_points)]
        values = with_springs(self.of_points.values(points), self.of_springs, points)
        self.blocks[points] = inverted(values, self.fixed_points[points], self.softest[points])

    def _cycle(self, sums: np.ndarray, quantum: float, scale: float, correction: np.ndarray) -> None:
        """One symmetric cycle for the intact model, from 0, with ``quantum * sums`` on the right.

        Its result times ``scale`` is written to the rows of the owned nodes. The grid's correction is added to all
        nodes that the rank sees, in the same bits as by their owners: the second residual needs no displacements sent.
        """
        n, blocks, damping = self.forces.model.nodes.n_owned, self.cycle.blocks, self.cycle.damping
        right, residual, x = np.empty(3 * n), np.empty(3 * n), np.empty(len(self.fixed))
        own, others = x[: 3 * n], x[3 * n :].reshape(-1, 3)
        cycle_steps.start_cycle(sums, quantum, self.fixed, blocks, damping, right, own)
        self._residual(own, right, residual)
        others[:] = self.forces.of_nodes.u[n:]
        met = self.forces.met.copy()
        self.grid.add_correction(residual, quantum, x)
        x[self.held[1]] = 0.0
        self._residual(own, right, residual, others)
        np.maximum(met, self.forces.met, out=self.forces.met)
        cycle_steps.finish_cycle(blocks, damping, residual, own, scale, correction)

    def _residual(self, x, right, residual, ghosts=None):
        self.forces.evaluate(x, right, residual, ghosts=ghosts)
        residual[self.held[0]] = 0.0


def _fixed(intact: Model, held: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Components that do not move, bool (n, 3): of all nodes that the rank sees, and of its own. Collective.

    Parameters
    ----------
    held : int64, shape (n_nodes, 3)
        How often a node is held, of the rank's own.
    """
    fixed = held > 0
    fixed.reshape(-1)[intact.rollers] = True
    intact.nodes.halo.scatter_forward(fixed)
    return fixed, fixed[: intact.nodes.n_owned]


def make_preconditioner(
    share: Share, model: Model, case: LoadCase, bounds: Bounds | None = None, kept: Cycle | None = None
) -> Preconditioner:
    """Set up all levels. Collective.

    Parameters
    ----------
    bounds : Bounds, optional
        Of the state, where the bounds of the cycle are kept.
    kept : Cycle, optional
        Of the same body and supports, with bonds elsewhere.
    """
    bounds = Bounds() if bounds is None else bounds
    same = kept is not None and kept.is_of(share)
    intact = kept.intact if same else build_intact_elements(share, model)
    local, cells = local_nodes(share, intact.subdomain), share.mesh.cells
    unknowns, of_points, values = model.unknowns, None, None
    blocks, around, held = [], np.empty((0, 8), np.int32), np.zeros((len(intact.nodes.number), 3), np.int64)
    limit, modulus = np.empty(0), share.youngs_modulus
    springs, n = model.springs and model.springs.rows(unknowns), unknowns.n_points
    if model.points:
        of_points = point_blocks(model.points, model.bonds)
        values = of_points.values()
        owned = np.concatenate([model.subdomain.free, model.subdomain.overlap])
        limit = softest(model.comm, values, np.repeat(modulus[owned], 8))[:n]
        held_points = with_springs(values[:n], springs, slice(0, n))
        blocks.append(inverted(held_points, point_rows(unknowns.of_points(case.fixed)), limit))
        around = np.ascontiguousarray(local[cells[model.subdomain.free]])
        # the nodes around fixed points do not move either
        fixed_points = point_rows(unknowns.of_points(case.fixed)).reshape(-1, 8, 3).any(axis=1)
        np.add.at(held, around.reshape(-1), np.repeat(fixed_points, 8, axis=0))
    own_nodes = np.empty(0, np.int32)
    if model.nodes:
        fixed_nodes, own = unknowns.of_nodes(case.fixed), model.subdomain.owned_nodes
        of_nodes = node_blocks(model, values)
        stiffest = stiffest_around(share, share.has_nodes)[own]
        held_nodes = with_springs(of_nodes, springs, slice(n, None))
        blocks.append(inverted(held_nodes, fixed_nodes, softest(model.comm, of_nodes, stiffest)))
        own_nodes = local[own]
        held[own_nodes] += fixed_nodes
    intact.nodes.halo.scatter_reverse(held)
    fixed, of_own = _fixed(intact, held)
    if same and kept.holds(of_own):
        cycle, cycle_forces = kept.with_motions(share, case.untied_motions), kept.forces(bounds.part("cycle"))
    else:
        cycle, cycle_forces = make_cycle(share, intact, case, of_own, bounds.part("cycle"), kept and kept.grid)
    return Preconditioner(
        model=model,
        of_points=of_points,
        fixed_points=point_rows(unknowns.of_points(case.fixed)),
        softest=limit,
        blocks=np.concatenate(blocks),
        of_springs=springs,
        forces=cycle_forces,
        cells=around,
        own_nodes=own_nodes,
        fixed=fixed.reshape(-1),
        cycle=cycle,
    )
