"""The coarse level: the intact body's elasticity on a background grid of about two cells' spacing, factorised once.

The grid's trilinear functions need not follow the mesh. Their stiffness is integrated at the Gauss points of all
cells, through the 27 moments of each grid cell. The moments are order-independent sums on rank 0, which alone has the
grid, factorises and solves; the other ranks know the grid cells and grid nodes that their own points and nodes touch,
and exchange integers with it. Where factors would outgrow `nested_grids.MOST_FILL`, one symmetric
multigrid cycle over nested grids takes the place of the direct solve, down to a grid that can be factorised.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product as pairs_of
from typing import TYPE_CHECKING

import numpy as np

from pdfem_mpi.body.share import Share
from pdfem_mpi.kernels.dense import orthonormal_rows, product, without_components
from pdfem_mpi.kernels.element_tables import lame_moduli
from pdfem_mpi.kernels.hex8 import GAUSS_POINTS, gauss_positions, gauss_volumes
from pdfem_mpi.kernels.multigrid import interpolate, restrict
from pdfem_mpi.mesh.background_grid import CORNERS, add_moments, cell_nodes, moment_table
from pdfem_mpi.mesh.rigid_motions import rigid_motions
from pdfem_mpi.model.model import Model
from pdfem_mpi.parallel.halo import Halo, build_halo
from pdfem_mpi.solvers.preconditioner.levels import Level, solve
from pdfem_mpi.solvers.preconditioner.nested_grids import grid_counts, nested_levels

if TYPE_CHECKING:
    from scipy import sparse

#: Added to the diagonal, relative: pins the rigid motions of free bodies.
PIN = 1e-8
#: Moments are rounded to this fraction of a cell of unit volume, and of the stiffest material in the grid cell.
MOMENT_QUANTUM = 2.0**-40


@dataclass(frozen=True)
class Grid:
    """The level as seen from the nodes of one rank.

    Attributes
    ----------
    corners : int32, shape (n_nodes, 8)
        Grid nodes around each owned node, by their places in the halo.
    weights : float64, shape (n_nodes, 8)
    halo : Halo
        Of the grid nodes that touch the body: rank 0 owns them all, others see those around their nodes.
    levels : tuple of Level
        From fine to coarse; rank 0 has them, others none.
    free : float64, shape (n_motions, 3 n_nodes)
        Orthonormal rigid motions that nothing holds. They are kept out of the solve: round-off along them would
        be amplified by the inverse of ``PIN``.
    known : int64
        Numbers of the grid nodes in the halo.
    """

    corners: np.ndarray
    weights: np.ndarray
    halo: Halo
    levels: tuple[Level, ...]
    free: np.ndarray
    known: np.ndarray

    @property
    def n_nodes(self) -> int:
        """Grid nodes that this rank sees: on rank 0 all that touch the body."""
        return self.halo.n_owned + self.halo.n_ghost

    def add_correction(self, r: np.ndarray, quantum: float, z: np.ndarray) -> None:
        """``z += T C^-1 T^t r`` for the owned nodes. Collective.

        Parameters
        ----------
        r, z : float64, shape (n_nodes * 3,)
        quantum : float
            For the restriction; equal on all ranks.
        """
        sums = np.zeros((self.n_nodes, 3), np.int64)
        restrict(self.corners, self.weights, r, quantum, sums)
        self.halo.scatter_reverse(sums)
        correction = np.zeros((self.n_nodes, 3))
        if self.levels:
            right = without_components(self.free, (sums * quantum).reshape(-1))
            correction[:] = without_components(self.free, solve(self.levels, right)).reshape(-1, 3)
        self.halo.scatter_forward(correction)
        interpolate(self.corners, self.weights, correction, z)


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
        Of the same body with the same supports on other ranks: what rank 0 has is taken from there.
    """
    comm, nodes, subdomain = intact.comm, intact.nodes, intact.subdomain
    lower, (counts, n_halvings) = share.lower, grid_counts(share)
    h = (share.upper - lower) / counts

    own = subdomain.elements
    points = gauss_positions(share.nodes[share.mesh.cells[own]])
    where, xi = _locate(points.reshape(-1, 3), lower, h, counts)
    own_cell, _ = _locate(nodes.x[: nodes.n_owned], lower, h, counts)
    known = np.arange(int(np.prod(counts))) if comm.rank == 0 else np.unique(np.concatenate([where, own_cell]))
    halo = _halo_of_rank_0(comm, known)
    ratios = np.unique(share.materials.poissons_ratio)
    stiffest, quantum, moments = _moments_of_cells(share, own, np.searchsorted(known, where), xi, halo, ratios)

    where, _ = _locate(_points_beside(share, own, points)[subdomain.owned_nodes], lower, h, counts)
    where = np.where((stiffest > 0.0)[np.searchsorted(known, own_cell)], own_cell, where)
    xi = (nodes.x[: nodes.n_owned] - lower) / h - np.stack(np.unravel_index(where, counts), axis=1)
    of_node, rounding = np.searchsorted(known, where), np.full_like(quantum, MOMENT_QUANTUM)
    for d, held in enumerate((held_by > 0.0).T):
        at = of_node[held], xi[held], held_by[held, d].astype(float)
        add_moments(moments[:, len(ratios) + d], *at, rounding)

    corners = cell_nodes(counts, 1, where)
    known, levels, free = np.unique(corners), (), np.empty((0, 0))
    if not kept:
        halo.scatter_reverse(moments)
    elif comm.rank == 0:
        known, levels = kept.known, kept.levels
    if comm.rank == 0 and not kept:
        of_ratios = moments.swapaxes(0, 1).astype(float)
        of_ratios[: len(ratios)] *= quantum[:, None]
        of_ratios[len(ratios) :] *= MOMENT_QUANTUM
        number, matrix = _stiffness(of_ratios, stiffest, h, counts, ratios, spring)
        known = np.flatnonzero(number >= 0)
        levels = nested_levels(number, matrix, counts, n_halvings)
    if comm.rank == 0:  # also beside what is kept: motions are scaled by the unknowns, which are others now
        places = lower + np.stack(np.unravel_index(known, counts + 1), axis=1) * h
        free = orthonormal_rows(product(motions, rigid_motions(places).reshape(6, -1)))
    weights = np.ones((len(where), 8))
    for d in range(3):
        weights *= np.where(CORNERS[:, d], xi[:, d, None], 1.0 - xi[:, d, None])
    places = np.ascontiguousarray(np.searchsorted(known, corners).astype(np.int32))
    return Grid(places, weights, _halo_of_rank_0(comm, known), levels, free, known)


def _moments_of_cells(share: Share, own: np.ndarray, where: np.ndarray, xi: np.ndarray, halo: Halo, ratios: np.ndarray):
    """What the Gauss points of the rank's cells give to the grid cells that it knows. Collective.

    Parameters
    ----------
    own : int64
        The rank's cells.
    where, xi : int64, shape (n,), and float64, shape (n, 3)
        Grid cell of each Gauss point, and coordinates in it from 0 to 1.
    ratios : float64, shape (n_ratios,)
        Poisson's ratios of the body.

    Returns
    -------
    stiffest, quantum : float64, shape (n_known,)
        Largest Young's modulus in each grid cell, on all ranks, and what its moments are rounded to.
    moments : int64, shape (n_known, n_ratios + 3, 27)
        Of Young's modulus for each of Poisson's ratios, of this rank; the last three are 0.
    """
    modulus, nu = (np.repeat(v[own], 8) for v in (share.youngs_modulus, share.poissons_ratio))
    softest = np.zeros(halo.n_owned + halo.n_ghost)  # of the negative moduli: the halo knows the smallest
    np.minimum.at(softest, where, -modulus)
    halo.scatter_smallest(softest)
    stiffest = -softest
    quantum = MOMENT_QUANTUM * _power_of_two(stiffest)
    moments = np.zeros((len(stiffest), len(ratios) + 3, 27), np.int64)
    terms = modulus * gauss_volumes(share.nodes[share.mesh.cells[own]]).reshape(-1)
    for k, ratio in enumerate(ratios):
        same = nu == ratio
        add_moments(moments[:, k], where[same], xi[same], terms[same], quantum)
    return stiffest, quantum, moments


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


def _halo_of_rank_0(comm, known: np.ndarray) -> Halo:
    """Exchange of grid cells or nodes by number: rank 0 owns all of them, others see some. Collective."""
    none = np.empty(0, np.int64)
    owned, ghosts = (known, none) if comm.rank == 0 else (none, known)
    return build_halo(comm, owned, ghosts, np.zeros(len(ghosts), np.int32))


def _locate(x: np.ndarray, lower, h, counts) -> tuple[np.ndarray, np.ndarray]:
    """Grid cell of each position, and its coordinates there from 0 to 1."""
    scaled = (x - lower) / h
    index = np.clip(np.floor(scaled).astype(np.int64), 0, counts - 1)
    return (index[:, 0] * counts[1] + index[:, 1]) * counts[2] + index[:, 2], scaled - index


def _power_of_two(x: np.ndarray) -> np.ndarray:
    """The next power of two from each number on; 1 for 0."""
    mantissa, exponent = np.frexp(np.where(x > 0.0, x, 1.0))
    return np.ldexp(1.0, exponent - (mantissa == 0.5))


def _stiffness(moments, stiffest, h, counts, ratios, spring: float) -> tuple[np.ndarray, sparse.csc_array]:
    """Numbers of the grid nodes that touch the body (-1 elsewhere), and the stiffness of their unknowns.

    Parameters
    ----------
    moments : float64, shape (n_ratios + 3, n_cells, 27)
        Of Young's modulus, for each of Poisson's ratios ``ratios``, and of the fixed x, y and z components.
    stiffest : float64, shape (n_cells,)
        Largest Young's modulus in each grid cell; a node is pinned in proportion to that around it.
    """
    from scipy import sparse

    active = (moments[: len(ratios), :, 0] > 0.0).any(axis=0)
    cells = cell_nodes(counts)[active]
    number = np.full(int(np.prod(counts + 1)), -1)
    used = np.unique(cells)
    number[used] = np.arange(len(used))

    stiffness = np.zeros((len(cells), 8, 3, 8, 3))
    for k, nu in enumerate(ratios):
        lam, mu = (float(modulus[0]) for modulus in lame_moduli(np.ones(1), float(nu)))
        for a, b in pairs_of(range(3), repeat=2):
            products = product(moments[k, active], moment_table((a, b)).reshape(27, 64)) / (h[a] * h[b])
            products = products.reshape(-1, 8, 8)
            stiffness[:, :, a, :, b] += lam * products
            stiffness[:, :, b, :, a] += mu * products
            if a == b:
                for c in range(3):
                    stiffness[:, :, c, :, c] += mu * products
    for d in range(3):
        held = product(moments[len(ratios) + d, active], moment_table((None, None)).reshape(27, 64))
        stiffness[:, :, d, :, d] += spring * held.reshape(-1, 8, 8)

    dofs = (3 * number[cells][:, :, None] + np.arange(3)).reshape(-1, 24).astype(np.int32)  # a quarter of the peak less
    rows = np.repeat(dofs, 24, axis=1).reshape(-1)
    columns = np.tile(dofs, (1, 24)).reshape(-1)
    matrix = sparse.coo_array((stiffness.reshape(-1), (rows, columns)), shape=(3 * len(used),) * 2).tocsc()
    diagonal, around = matrix.diagonal(), np.zeros(len(used))
    np.maximum.at(around, number[cells], stiffest[active][:, None])
    around = np.repeat(around, 3)
    pins = PIN * np.maximum(diagonal, around * (diagonal / around).mean())
    return number, 0.5 * (matrix + matrix.T) + sparse.diags_array(pins)
