"""What the preconditioner's cycle has of the intact body: kept where bonds move, and nothing else does.

It hangs on the cells, their materials and shares, and on what holds them; not on which of them are bonds.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pdfem_mpi.body.share import Share
from pdfem_mpi.model.bounds import Bounds
from pdfem_mpi.model.forces import Forces
from pdfem_mpi.model.loads import LoadCase
from pdfem_mpi.model.model import Model
from pdfem_mpi.parallel.comm import largest, sum_integers
from pdfem_mpi.solvers.preconditioner.blocks import inverted, node_blocks, softest, with_springs
from pdfem_mpi.solvers.preconditioner.coarse_grid import Grid, make_grid, with_free_motions
from pdfem_mpi.solvers.preconditioner.smoothing import damping

#: Fixed components are held on the grid by springs this much stiffer than the stiffest node.
SPRING = 10.0


@dataclass(frozen=True)
class Cycle:
    """Of one rank, of the body with elements in every cell.

    Attributes
    ----------
    intact : Model
    cell_owner : int32, shape (n_cells,)
        Of the share's cells, for which it was made.
    fixed : bool, shape (n_nodes, 3)
        Components that do not move.
    blocks : float64, shape (n_nodes, 6)
        Inverse blocks of its nodes.
    damping : float
        Weight of the blocks.
    bounds : tuple of float
        Of the forces, as the search for the weight left them.
    grid : Grid
    """

    intact: Model
    cell_owner: np.ndarray
    fixed: np.ndarray
    blocks: np.ndarray
    damping: float
    bounds: tuple[float, float]
    grid: Grid

    def is_of(self, share: Share) -> bool:
        """Whether all ranks still have the cells for which it was made. Collective."""
        same = np.array_equal(self.cell_owner, share.cell_owner)
        return sum_integers(share.comm, np.array([int(same)]))[0] == share.comm.size

    def holds(self, fixed: np.ndarray) -> bool:
        """Whether the same components are fixed on all ranks. Collective."""
        comm = self.intact.comm
        return sum_integers(comm, np.array([int(np.array_equal(self.fixed, fixed))]))[0] == comm.size

    def with_motions(self, share: Share, motions: np.ndarray) -> Cycle:
        """The same of a model with other bonds, whose motions that nothing holds are ``motions``, as of `make_grid`."""
        grid = self.grid
        return replace(self, grid=replace(grid, last=with_free_motions(grid.last, share, motions)))

    def forces(self, bounds: Bounds) -> Forces:
        """Forces of the intact body, whose bounds are as if the weight had just been looked for with them."""
        bounds.bond, bounds.element = self.bounds
        return Forces(self.intact, bounds)


def make_cycle(
    share: Share, intact: Model, case: LoadCase, fixed: np.ndarray, bounds: Bounds, kept: Grid | None
) -> tuple[Cycle, Forces]:
    """Blocks, weight and grid of the intact model, and its forces with the bounds. Collective.

    Parameters
    ----------
    fixed : bool, shape (n_nodes, 3)
    bounds : Bounds
        New ones.
    kept : Grid, optional
        Of the same body with the same supports on other ranks.
    """
    forces = Forces(intact, bounds)
    blocks, held_by, spring = _blocks_of_cycle(share, intact, fixed)
    weight = damping(forces, blocks, fixed.reshape(-1))
    grid = make_grid(intact, share, held_by, spring, case.untied_motions, kept)
    return Cycle(intact, share.cell_owner, fixed, blocks, weight, (bounds.bond, bounds.element), grid), forces


def _blocks_of_cycle(share: Share, intact: Model, fixed: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """Inverse blocks of the intact model, and how stiff its nodes are held on the grid. Collective.

    Parameters
    ----------
    fixed : bool, shape (n_nodes, 3)

    Returns
    -------
    blocks : float64, shape (n_nodes, 6)
    held_by : float64, shape (n_nodes, 3)
        Over the last: 1 of what is fixed, and that of springs.
    spring : float, dimension force / length
    """
    blocks = node_blocks(intact, None)
    modulus = stiffest_around(share, np.ones(len(share.mesh.cells), bool))[intact.subdomain.owned_nodes]
    spring = SPRING * float(largest(intact.comm, np.array([blocks[:, :3].max(initial=0.0)]))[0])
    springs = intact.springs and intact.springs.rows(intact.unknowns)
    limits = softest(intact.comm, blocks, modulus)
    held_by = fixed.astype(float) if springs is None else np.where(fixed, 1.0, springs / spring)
    return inverted(with_springs(blocks, springs, slice(None)), fixed, limits), held_by, spring


def stiffest_around(share: Share, chosen: np.ndarray) -> np.ndarray:
    """Largest Young's modulus of the chosen cells at each node of the share; float64, shape (n_nodes,)."""
    around = np.zeros(len(share.nodes))
    for corner in share.mesh.cells[chosen].T:
        np.maximum.at(around, corner, share.youngs_modulus[chosen])
    return around
