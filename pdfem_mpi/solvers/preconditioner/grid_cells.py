"""Moments of the body in the cells of a grid, on the ranks that own them, and those of the cells of a coarser one.

Moments are sums of integers, and have the same bits on any number of ranks.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pdfem_mpi.body.share import Share
from pdfem_mpi.kernels.dense import product
from pdfem_mpi.kernels.hex8 import gauss_volumes
from pdfem_mpi.mesh.background_grid import add_moments
from pdfem_mpi.parallel.halo import Halo
from pdfem_mpi.solvers.preconditioner.nested_grids import halved, number_in, ratio_of
from pdfem_mpi.solvers.preconditioner.spread import spread_by_claims

#: Moments are rounded to this fraction of a cell of unit volume, and of the stiffest material in the grid cell.
MOMENT_QUANTUM = 2.0**-40
#: Cells of the body whose points are looked at together.
CHUNK = 2**12
#: Ranks whose cells come together on one of them, a level of the grid: the levels of a large body live on fewer and
#: fewer ranks, which have half as many cells of each as of the one before.
TOGETHER = 4


@dataclass(frozen=True)
class GridCells:
    """Cells of a grid with a part of the body in them, those that one rank owns.

    Attributes
    ----------
    counts : int64, shape (3,)
        Cells of the whole grid along the axes.
    h : float64, shape (3,), dimension length
        Edges of a cell.
    ids : int64, shape (n_cells,)
        Their numbers in the grid.
    moments : float64, shape (n_cells, n_ratios + 3, 27)
        Of Young's modulus for each of Poisson's ratios, and of what holds nodes in x, y and z.
    stiffest : float64, shape (n_cells,)
        Largest Young's modulus in each.
    """

    counts: np.ndarray
    h: np.ndarray
    ids: np.ndarray
    moments: np.ndarray
    stiffest: np.ndarray

    @property
    def active(self) -> np.ndarray:
        """Cells with some stiffness; bool, shape (n_cells,)."""
        return (self.moments[:, :-3, 0] > 0.0).any(axis=1)


def moments_of_cells(share: Share, own: np.ndarray, where: np.ndarray, xi: np.ndarray, halo: Halo, ratios: np.ndarray):
    """What the Gauss points of the rank's cells give to the grid cells that it knows. Collective.

    Parameters
    ----------
    own : int64
        The rank's cells.
    where, xi : int64, shape (n,), and float64, shape (n, 3)
        Place of each Gauss point's grid cell in the halo, and coordinates in it from 0 to 1.
    ratios : float64, shape (n_ratios,)
        Poisson's ratios of the body.

    Returns
    -------
    stiffest, quantum : float64, shape (n_known,)
        Largest Young's modulus in each grid cell, on all ranks, and what its moments are rounded to.
    moments : int64, shape (n_known, n_ratios + 3, 27)
        Of Young's modulus for each of Poisson's ratios, of this rank; the last three are 0.
    """
    modulus, nu = share.youngs_modulus[own], share.poissons_ratio[own]
    stiffest = _largest_in(halo, where, np.repeat(modulus, 8))
    quantum = MOMENT_QUANTUM * _power_of_two(stiffest)
    moments = np.zeros((len(stiffest), len(ratios) + 3, 27), np.int64)
    for first in range(0, len(own), CHUNK):
        for k, ratio in enumerate(ratios):
            same = first + np.flatnonzero(nu[first : first + CHUNK] == ratio)
            terms = modulus[same, None] * gauss_volumes(share.nodes[share.mesh.cells[own[same]]])
            points = (8 * same[:, None] + np.arange(8)).reshape(-1)
            add_moments(moments[:, k], where[points], xi[points], terms.reshape(-1), quantum)
    return stiffest, quantum, moments


def added_up(halo: Halo, moments: np.ndarray, quantum: np.ndarray, of_nodes: float) -> np.ndarray:
    """Moments of the rank's own grid cells over all ranks, float64, shape (n_owned, n_ratios + 3, 27). Collective.

    Parameters
    ----------
    moments : int64, shape (n_known, n_ratios + 3, 27)
    quantum : float64, shape (n_known,)
        Of the first ones of each grid cell.
    of_nodes : float
        Of the last three.
    """
    halo.scatter_reverse(moments)
    result = moments[: halo.n_owned].astype(float)
    result[:, :-3] *= quantum[: halo.n_owned, None, None]
    result[:, -3:] *= of_nodes
    return result


def coarser_cells(comm, cells: GridCells, level: int, last: bool) -> GridCells:
    """The cells of the grid of half the cells, with the moments that follow from these. Collective.

    Parameters
    ----------
    level : int
        Of the coarser grid, from 1 on.
    last : bool
        The coarser grid is the last one: rank 0 owns it.
    """
    counts, ratio = halved(cells.counts), ratio_of(cells.counts)
    active = cells.active
    index = np.stack(np.unravel_index(cells.ids[active], cells.counts), axis=1)
    parents, where, children = np.unique(number_in(counts, index // ratio), return_inverse=True, return_counts=True)
    spread = spread_by_claims(comm, parents, children, comm.size if last else TOGETHER**level)
    where = spread.places(parents)[where]
    stiffest = _largest_in(spread.halo, where, cells.stiffest[active])
    volume = 8.0**level  # of a cell, over that of the finest grid
    quantum, of_nodes = MOMENT_QUANTUM * volume * _power_of_two(stiffest), MOMENT_QUANTUM * volume
    sums = np.zeros((len(stiffest), *cells.moments.shape[1:]), np.int64)
    terms = _seen_from_parents(cells.moments[active], index % ratio, ratio)
    terms[:, :-3] /= quantum[where, None, None]
    terms[:, -3:] /= of_nodes
    np.add.at(sums, where, np.rint(terms).astype(np.int64))
    moments = added_up(spread.halo, sums, quantum, of_nodes)
    return GridCells(counts, cells.h * ratio, spread.owned, moments, stiffest[: spread.halo.n_owned])


def _seen_from_parents(moments: np.ndarray, octant: np.ndarray, ratio: np.ndarray) -> np.ndarray:
    """Moments in the coordinates of the coarser grid's cell, of which each cell is one of eight; shape of ``moments``.

    Parameters
    ----------
    octant : int64, shape (n_cells, 3)
        Which half of the coarser cell along each axis.
    ratio : int64, shape (3,)
        2, or 1 where an axis is not halved.
    """
    result = np.empty_like(moments)
    number = number_in(ratio, octant)
    for k in range(int(np.prod(ratio))):
        factors = [_halves(part, n) for part, n in zip(np.unravel_index(k, ratio), ratio, strict=True)]
        table = (
            factors[0][:, None, None, :, None, None]
            * factors[1][None, :, None, None, :, None]
            * factors[2][None, None, :, None, None, :]
        ).reshape(27, 27)
        chosen = number == k
        result[chosen] = product(moments[chosen], table.T)
    return result


def _halves(part: int, ratio: int) -> np.ndarray:
    """Coefficients of the powers 0 to 2 of ``(part + xi) / ratio`` in those of ``xi``; float64, shape (3, 3)."""
    a, b = part / ratio, 1.0 / ratio
    return np.array([[1.0, 0.0, 0.0], [a, b, 0.0], [a * a, 2.0 * a * b, b * b]])


def _largest_in(halo: Halo, where: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Largest value in each grid cell on all ranks, 0 where there is none; float64, shape (n_known,). Collective."""
    smallest = np.zeros(halo.n_owned + halo.n_ghost)  # of the negative values: the halo knows the smallest
    np.minimum.at(smallest, where, -values)
    halo.scatter_smallest(smallest)
    return -smallest


def _power_of_two(x: np.ndarray) -> np.ndarray:
    """The next power of two from each number on; 1 for 0."""
    mantissa, exponent = np.frexp(np.where(x > 0.0, x, 1.0))
    return np.ldexp(1.0, exponent - (mantissa == 0.5))
