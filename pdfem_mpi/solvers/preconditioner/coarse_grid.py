"""The coarse level: the intact body's elasticity on a background grid of about two cells' spacing, factorised once.

The grid's trilinear functions need not follow the mesh. Their stiffness is integrated at the Gauss points of all
cells, through the 27 moments of each grid cell; the moments are order-independent sums, every rank then factorises
and solves the same small problem, and so finds the same bits. Where factors would outgrow ``MOST_FILL``, one symmetric
multigrid cycle over nested grids takes the place of the direct solve, down to a grid that can be factorised.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy import sparse

from pdfem_mpi.body.share import Share
from pdfem_mpi.kernels.element_tables import lame_moduli
from pdfem_mpi.kernels.hex8 import GAUSS_POINTS, gauss_positions, gauss_volumes
from pdfem_mpi.kernels.multigrid import interpolate, restrict
from pdfem_mpi.mesh.background_grid import CORNERS, add_moments, cell_nodes, moment_table
from pdfem_mpi.mesh.rigid_motions import rigid_motions
from pdfem_mpi.model.model import Model
from pdfem_mpi.parallel.comm import largest, sum_integers
from pdfem_mpi.solvers.preconditioner.levels import DAMPING, Level, factorise, solve

#: Spacing of the grid in cell edges.
COARSENING = 2.0
#: Most entries of the factor, 8 bytes each on every rank: unknowns times half a band.
MOST_FILL = 2.5e7
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
        Grid nodes around each owned node.
    weights : float64, shape (n_nodes, 8)
    n_nodes : int
        Grid nodes that touch the body.
    levels : tuple of Level
        From fine to coarse, the same on every rank.
    free : float64, shape (3 n_nodes, n_motions)
        Orthonormal rigid motions that nothing holds. They are kept out of the solve: round-off along them would
        be amplified by the inverse of ``PIN``.
    """

    corners: np.ndarray
    weights: np.ndarray
    n_nodes: int
    levels: tuple[Level, ...]
    free: np.ndarray

    def add_correction(self, comm, r: np.ndarray, quantum: float, z: np.ndarray) -> None:
        """``z += T C^-1 T^t r`` for the owned nodes. Collective.

        Parameters
        ----------
        r, z : float64, shape (n_nodes * 3,)
        quantum : float
            For the restriction; equal on all ranks.
        """
        sums = np.zeros((self.n_nodes, 3), np.int64)
        restrict(self.corners, self.weights, r, quantum, sums)
        right = self._held((sum_integers(comm, sums) * quantum).reshape(-1))
        correction = self._held(solve(self.levels, right))
        interpolate(self.corners, self.weights, correction.reshape(-1, 3), z)

    def _held(self, x: np.ndarray) -> np.ndarray:
        return x - self.free @ (self.free.T @ x)


def make_grid(intact: Model, share: Share, fixed: np.ndarray, spring: float, motions: np.ndarray) -> Grid:
    """Set up the grid over a finite-element model. Collective.

    Parameters
    ----------
    intact : Model
        Finite elements in every cell.
    share : Share
        Of the same body.
    fixed : bool, shape (n_owned_nodes, 3)
        Components that do not move: held by springs of stiffness ``spring``.
    motions : float64, shape (n_motions, 6)
        Rigid motions that nothing holds, as combinations of translations and rotations.
    """
    comm, nodes, subdomain = intact.comm, intact.nodes, intact.subdomain
    positions, cells = share.nodes, share.mesh.cells
    lower, upper = share.lower, share.upper
    spacing = COARSENING * share.typical_edge
    counts = np.maximum(1, np.rint((upper - lower) / spacing)).astype(np.int64)
    n_halvings = 0
    while _fill(_halved(counts, n_halvings)) > MOST_FILL:
        n_halvings += 1
    counts = _nested(counts, n_halvings)
    h = (upper - lower) / counts

    own = subdomain.elements
    points = gauss_positions(positions[cells[own]])
    where, xi = _locate(points.reshape(-1, 3), lower, h, counts)
    modulus, nu = (np.repeat(v[own], 8) for v in (share.youngs_modulus, share.poissons_ratio))
    stiffest = np.zeros(int(np.prod(counts)))
    np.maximum.at(stiffest, where, modulus)
    stiffest = largest(comm, stiffest)
    quantum = MOMENT_QUANTUM * _power_of_two(stiffest)
    ratios = np.unique(share.materials.poissons_ratio)
    moments = np.zeros((len(ratios) + 3, len(stiffest), 27), np.int64)
    terms = modulus * gauss_volumes(positions[cells[own]]).reshape(-1)
    for k, ratio in enumerate(ratios):
        same = nu == ratio
        add_moments(moments[k], where[same], xi[same], terms[same], quantum)

    # a node belongs to its own grid cell or, where the body leaves that empty, to the one of a Gauss point beside it;
    # always taking the latter would make the grid's functions of a mirror-symmetric body unsymmetric
    beside = np.zeros((len(positions), 3))
    for g, signs in enumerate(GAUSS_POINTS > 0):
        a = [0, 1, 3, 2][signs[0] + 2 * signs[1]] + 4 * signs[2]
        lowest_last = np.argsort(own)[::-1]
        beside[cells[own[lowest_last], a]] = points[lowest_last, g]
    where, _ = _locate(beside[subdomain.owned_nodes], lower, h, counts)
    own_cell, _ = _locate(nodes.x[: nodes.n_owned], lower, h, counts)
    where = np.where((stiffest > 0.0)[own_cell], own_cell, where)
    xi = (nodes.x[: nodes.n_owned] - lower) / h - np.stack(np.unravel_index(where, counts), axis=1)
    for d in range(3):
        held = fixed[:, d]
        weight = np.ones(np.count_nonzero(held))
        add_moments(moments[len(ratios) + d], where[held], xi[held], weight, np.full_like(quantum, MOMENT_QUANTUM))

    moments = sum_integers(comm, moments).astype(float)
    moments[: len(ratios)] *= quantum[:, None]
    moments[len(ratios) :] *= MOMENT_QUANTUM
    number, matrix = _stiffness(moments, stiffest, h, counts, ratios, spring)
    index = np.stack(np.unravel_index(np.flatnonzero(number >= 0), counts + 1), axis=1)
    free = np.linalg.qr((motions @ rigid_motions(lower + index * h).reshape(6, -1)).T)[0]
    corners = np.ascontiguousarray(number[cell_nodes(counts)[where]].astype(np.int32))
    n_nodes = int(number.max()) + 1
    weights = np.ones((len(where), 8))
    for d in range(3):
        weights *= np.where(CORNERS[:, d], xi[:, d, None], 1.0 - xi[:, d, None])
    levels = []
    for _ in range(n_halvings):
        below, prolongation = _prolongation(number, counts)
        levels.append(Level(None, matrix.tocsr(), DAMPING / matrix.diagonal(), prolongation))
        matrix = prolongation.T @ matrix @ prolongation
        number, counts = below, _halved(counts, 1)
    levels.append(Level(factorise(matrix, number, counts)))
    return Grid(corners, weights, n_nodes, tuple(levels), free)


def _halved(counts: np.ndarray, times: int) -> np.ndarray:
    """Cells along each axis of the grid ``times`` levels coarser; an axis of one cell stays."""
    for _ in range(times):
        counts = (counts + 1) // 2
    return counts


def _nested(counts: np.ndarray, times: int) -> np.ndarray:
    """The next larger counts that can be halved so often, where they are not 1."""
    coarsest = _halved(counts, times)
    return np.where(counts == 1, 1, coarsest * 2**times)


def _fill(counts: np.ndarray) -> float:
    """Entries of the factor: unknowns times half the band, which the two shorter axes set."""
    nodes = np.sort(counts + 1).astype(float)
    return 9.0 * float(np.prod(nodes)) * nodes[0] * nodes[1]


def _prolongation(number: np.ndarray, counts: np.ndarray) -> tuple[np.ndarray, sparse.csr_array]:
    """Trilinear interpolation from the grid of half the cells.

    Parameters
    ----------
    number : int64, shape (n_grid_nodes,)
        Numbers of the grid nodes in use, -1 elsewhere.
    counts : int64, shape (3,)

    Returns
    -------
    number : int64, shape (n_coarser_grid_nodes,)
    prolongation : sparse, shape (n_unknowns, n_coarser_unknowns)
    """
    coarser = _halved(counts, 1)
    ratio = np.where(counts == coarser, 1, 2)
    index = np.stack(np.unravel_index(np.flatnonzero(number >= 0), counts + 1), axis=1)
    base, odd = index // ratio, index % ratio
    rows, columns, weights = [], [], []
    for corner in CORNERS:
        # an odd node lies half-way between two coarser ones, an even one on one of them
        used = ((corner == 0) | (odd == 1)).all(axis=1)
        node = base[used] + corner
        rows.append(np.flatnonzero(used))
        columns.append((node[:, 0] * (coarser[1] + 1) + node[:, 1]) * (coarser[2] + 1) + node[:, 2])
        weights.append(np.prod(np.where(odd[used] == 1, 0.5, 1.0), axis=1))
    columns = np.concatenate(columns)
    below = np.full(int(np.prod(coarser + 1)), -1)
    below[np.unique(columns)] = np.arange(len(np.unique(columns)))
    scalar = sparse.coo_array(
        (np.concatenate(weights), (np.concatenate(rows), below[columns])), shape=(len(index), int(below.max()) + 1)
    )
    return below, sparse.csr_array(sparse.kron(scalar, sparse.eye_array(3)))


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
    active = (moments[: len(ratios), :, 0] > 0.0).any(axis=0)
    cells = cell_nodes(counts)[active]
    number = np.full(int(np.prod(counts + 1)), -1)
    used = np.unique(cells)
    number[used] = np.arange(len(used))

    stiffness = np.zeros((len(cells), 8, 3, 8, 3))
    for k, nu in enumerate(ratios):
        lam, mu = (float(modulus[0]) for modulus in lame_moduli(np.ones(1), float(nu)))
        for a, b in product(range(3), repeat=2):
            products = moments[k, active] @ moment_table((a, b)).reshape(27, 64) / (h[a] * h[b])
            products = products.reshape(-1, 8, 8)
            stiffness[:, :, a, :, b] += lam * products
            stiffness[:, :, b, :, a] += mu * products
            if a == b:
                for c in range(3):
                    stiffness[:, :, c, :, c] += mu * products
    for d in range(3):
        held = moments[len(ratios) + d, active] @ moment_table((None, None)).reshape(27, 64)
        stiffness[:, :, d, :, d] += spring * held.reshape(-1, 8, 8)

    dofs = (3 * number[cells][:, :, None] + np.arange(3)).reshape(-1, 24)
    rows = np.repeat(dofs, 24, axis=1).reshape(-1)
    columns = np.tile(dofs, (1, 24)).reshape(-1)
    matrix = sparse.coo_array((stiffness.reshape(-1), (rows, columns)), shape=(3 * len(used),) * 2).tocsc()
    diagonal, around = matrix.diagonal(), np.zeros(len(used))
    np.maximum.at(around, number[cells], stiffest[active][:, None])
    around = np.repeat(around, 3)
    pins = PIN * np.maximum(diagonal, around * (diagonal / around).mean())
    return number, 0.5 * (matrix + matrix.T) + sparse.diags_array(pins)
