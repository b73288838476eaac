"""The coarse level: the intact body's elasticity on a background grid of about two cells' spacing, and coarser ones.

The grid's trilinear functions need not follow the mesh. Their stiffness is integrated at the Gauss points of all
cells, through the 27 moments of each grid cell. A small grid has rank 0, which factorises it and solves. Of a larger
one each rank has the cells and the rows of the nodes around its part of the body, and one symmetric multigrid cycle
over nested grids takes the place of the direct solve, down to a grid for rank 0. No rank has an array of a whole grid
but for that last one. Sums over ranks are sums of integers, and every other number is made whole by one owner.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pdfem_mpi.body.share import Share
from pdfem_mpi.finite_elements.nodes import Nodes
from pdfem_mpi.kernels.dense import orthonormal_rows, product
from pdfem_mpi.kernels.hex8 import GAUSS_POINTS, gauss_positions
from pdfem_mpi.mesh.background_grid import CORNERS, add_moments, cell_nodes
from pdfem_mpi.mesh.rigid_motions import rigid_motions
from pdfem_mpi.model.model import Model
from pdfem_mpi.solvers.preconditioner.grid_cells import (
    MOMENT_QUANTUM,
    GridCells,
    added_up,
    coarser_cells,
    moments_of_cells,
)
from pdfem_mpi.solvers.preconditioner.grid_stiffness import make_last, make_level
from pdfem_mpi.solvers.preconditioner.levels import LastLevel, Level, Transfer, cycle, make_transfer
from pdfem_mpi.solvers.preconditioner.nested_grids import coarser_nodes, grid_counts, halved, number_in
from pdfem_mpi.solvers.preconditioner.spread import Spread, spread_by_claims


@dataclass(frozen=True)
class Grid:
    """The level as seen from the nodes of one rank.

    Attributes
    ----------
    down : tuple of Transfer
        From the mesh to the first grid, and from each grid to the next.
    levels : tuple of Level
        The rank's part of the grids that are smoothed, from fine to coarse.
    last : LastLevel
    """

    down: tuple[Transfer, ...]
    levels: tuple[Level, ...]
    last: LastLevel

    def add_correction(self, r: np.ndarray, quantum: float, z: np.ndarray) -> None:
        """``z += T C^-1 T^t r`` for all nodes that the rank sees. Collective.

        Parameters
        ----------
        r : float64, shape (n_owned_nodes * 3,)
        z : float64, shape (n_nodes * 3,)
            The rank's own nodes first.
        quantum : float
            For the restriction; equal on all ranks.
        """
        right = self.down[0].restrict(r, quantum)
        self.down[0].add(cycle(self.levels, self.last, self.down[1:], right, quantum), z)


def make_grid(
    intact: Model, share: Share, held_by: np.ndarray, spring: float, motions: np.ndarray, kept: Grid | None = None
) -> Grid:
    """Set up the grid over a finite-element model. Collective.

    Parameters
    ----------
    intact : Model
        Finite elements in every cell.
    share : Share
        Of the same body.
    held_by : float64, shape (n_owned_nodes, 3)
        Stiffness to the ground of each component, over ``spring``: 1 of those that do not move.
    motions : float64, shape (n_motions, 6)
        Rigid motions that nothing holds, as combinations of translations and rotations.
    kept : Grid, optional
        Of the same body with the same supports on other ranks: what ranks have of its levels is taken from there.
    """
    comm, nodes, subdomain = intact.comm, intact.nodes, intact.subdomain
    counts, n_halvings = grid_counts(share)
    h = (share.upper - share.lower) / counts
    ratios = np.unique(share.materials.poissons_ratio)

    own = subdomain.elements
    points = gauss_positions(share.nodes[share.mesh.cells[own]])
    of_points, xi_points = _locate(points.reshape(-1, 3), share.lower, h, counts)
    own_cell, _ = _locate(nodes.x[: nodes.n_owned], share.lower, h, counts)
    spread = _deal_out_cells(comm, of_points, own_cell, first_rank=n_halvings == 0)
    stiffest, quantum, moments = moments_of_cells(share, own, spread.places(of_points), xi_points, spread.halo, ratios)

    beside, _ = _locate(_points_beside(share, own, points)[subdomain.owned_nodes], share.lower, h, counts)
    where = np.where((stiffest > 0.0)[spread.places(own_cell)], own_cell, beside)
    xi = (nodes.x[: nodes.n_owned] - share.lower) / h - np.stack(np.unravel_index(where, counts), axis=1)
    of_node, rounding = spread.places(where), np.full_like(quantum, MOMENT_QUANTUM)
    for d, held in enumerate((held_by > 0.0).T):
        at = of_node[held], xi[held], held_by[held, d].astype(float)
        add_moments(moments[:, len(ratios) + d], *at, rounding)

    if kept:
        levels, last, between = kept.levels, kept.last, kept.down[1:]
    else:
        sums = added_up(spread.halo, moments, quantum, MOMENT_QUANTUM)
        cells = GridCells(counts, h, spread.owned, sums, stiffest[: len(spread.owned)])
        levels, last, between = _make_levels(comm, cells, n_halvings, ratios, spring)
    last = with_free_motions(last, share, motions)
    return Grid((_from_nodes(comm, nodes, where, xi, counts, (*levels, last)[0].nodes), *between), levels, last)


def with_free_motions(last: LastLevel, share: Share, motions: np.ndarray) -> LastLevel:
    """The last grid with the rigid motions that nothing holds, on rank 0, which solves on it.

    Also of a grid that is kept: motions are scaled by the unknowns, which are others where bonds have moved.
    """
    if share.comm.rank > 0:
        return last
    of_last = halved(*grid_counts(share))
    index = np.stack(np.unravel_index(last.nodes, of_last + 1), axis=1)
    places = share.lower + index * ((share.upper - share.lower) / of_last)
    return replace(last, free=orthonormal_rows(product(motions, rigid_motions(places).reshape(6, -1))))


def _from_nodes(
    comm, nodes: Nodes, where: np.ndarray, xi: np.ndarray, counts: np.ndarray, owned: np.ndarray
) -> Transfer:
    """The way from all nodes that the rank sees to the first grid. Collective.

    Parameters
    ----------
    where, xi : int64, shape (n_owned,), and float64, shape (n_owned, 3)
        Grid cell of each of the rank's own nodes, and coordinates in it.
    counts : int64, shape (3,)
        Cells of the grid.
    owned : int64
        Numbers of the grid nodes of this rank, rising.
    """
    at = np.empty((len(nodes.number), 4))
    at[: nodes.n_owned, 0], at[: nodes.n_owned, 1:] = where, xi
    nodes.halo.scatter_forward(at)  # an owner may have chosen between two grid cells
    weights = np.ones((len(at), 8))
    for d in range(3):
        weights *= np.where(CORNERS[:, d], at[:, 1 + d, None], 1.0 - at[:, 1 + d, None])
    corners = cell_nodes(counts, 1, at[:, 0].astype(np.int64))
    return make_transfer(comm, corners, weights, owned, int(np.prod(counts + 1)))


def _make_levels(comm, cells: GridCells, n_halvings: int, ratios: np.ndarray, spring: float):
    """Levels from the finest grid's cells on, the last one, and the ways between them. Collective."""
    levels, all_counts = [], []
    for level in range(1, n_halvings + 1):
        levels.append(make_level(comm, cells, ratios, spring))
        all_counts.append(cells.counts)
        cells = coarser_cells(comm, cells, level, last=level == n_halvings)
    last = make_last(comm, cells, ratios, spring)
    coarser = [*levels, last][1:]
    between = [
        make_transfer(comm, *coarser_nodes(level.nodes, counts), below.nodes, int(np.prod(halved(counts) + 1)))
        for level, counts, below in zip(levels, all_counts, coarser, strict=True)
    ]
    return tuple(levels), last, tuple(between)


def _deal_out_cells(comm, of_points: np.ndarray, of_nodes: np.ndarray, first_rank: bool) -> Spread:
    """Owners of the grid cells around Gauss points and nodes: who has most points in each, or rank 0. Collective."""
    known = np.unique(np.concatenate([of_points, of_nodes]))
    n_points = np.bincount(np.searchsorted(known, of_points), minlength=len(known))
    return spread_by_claims(comm, known, n_points, comm.size if first_rank else 1)


def _points_beside(share: Share, own: np.ndarray, points: np.ndarray) -> np.ndarray:
    """A Gauss point beside each node, of the first of its cells on this rank; float64, shape (n_nodes, 3).

    A node belongs to its own grid cell or, where the body leaves that empty, to the one of this point; always taking
    the latter would make the grid's functions of a mirror-symmetric body unsymmetric.
    """
    beside = np.zeros((len(share.nodes), 3))
    lowest_last = np.argsort(own, kind="stable")[::-1]
    for g, signs in enumerate(GAUSS_POINTS > 0):
        a = [0, 1, 3, 2][signs[0] + 2 * signs[1]] + 4 * signs[2]
        beside[share.mesh.cells[own[lowest_last], a]] = points[lowest_last, g]
    return beside


def _locate(x: np.ndarray, lower, h, counts) -> tuple[np.ndarray, np.ndarray]:
    """Grid cell of each position, and its coordinates there from 0 to 1."""
    scaled = (x - lower) / h
    index = np.clip(np.floor(scaled).astype(np.int64), 0, counts - 1)
    return number_in(counts, index), scaled - index
