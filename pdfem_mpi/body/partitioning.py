"""Which rank owns which cell: recursive bisection, with what a force evaluation costs as weights.

The unit of the partition is the cell: its points and its element live on one rank.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pdfem_mpi.body.counts import too_many_ranks
from pdfem_mpi.body.discretization import Discretization
from pdfem_mpi.body.near_places import NearPlaces
from pdfem_mpi.body.subdomain import centroids_of, near_images
from pdfem_mpi.deck.table import SceneError
from pdfem_mpi.kernels.exact_sums import MOST_RANKS
from pdfem_mpi.parallel.bisection import bisect
from pdfem_mpi.parallel.comm import report_progress, sum_integers
from pdfem_mpi.parallel.dealing import deal

if TYPE_CHECKING:
    from mpi4py.MPI import Intracomm

#: Cost of a bond sweep over the neighbour cells of a peridynamic cell, per neighbour, of one element, and of any cell
#: in the cycle of conjugate gradients' preconditioner; units of ns.
NEIGHBOUR_COST, ELEMENT_COST, CYCLE_COST = 40, 60, 280
#: Cells between two beats of this rank: it is at work, and says so.
BATCH = 65536


def count_neighbours(discretization: Discretization, comm: Intracomm) -> np.ndarray | None:
    """Neighbours of all cells with points, each rank counting those of a block; None on one rank. Collective."""
    if comm.size == 1:
        return None
    cells = np.flatnonzero(discretization.has_points)
    block = slice(*(len(cells) * k // comm.size for k in (comm.rank, comm.rank + 1)))
    counts = np.zeros(len(cells), np.int64)
    counts[block] = _neighbours(discretization, cells[block])
    return sum_integers(comm, counts)


def _neighbours(discretization: Discretization, cells: np.ndarray) -> np.ndarray:
    """Cells with points, and images of them, within the cutoff radius of some cells, centre to centre; int64, (n,)."""
    counts = np.zeros(len(cells), np.int64)
    if len(cells):
        centroids = centroids_of(discretization)
        chosen = centroids[discretization.has_points]
        _, _, images = near_images(discretization, chosen, centroids[cells])
        near = NearPlaces(np.concatenate([chosen, images]), discretization.cutoff)
        for start in range(0, len(cells), BATCH):
            part = slice(start, start + BATCH)
            counts[part] = near.counts(centroids[cells[part]])
            report_progress()
    return counts


def partition(discretization: Discretization, n_parts: int, neighbours: np.ndarray | None = None) -> np.ndarray:
    """Owner of every cell of the mesh: recursive bisection, cells weighted by the cost of a force evaluation.

    Parameters
    ----------
    neighbours : int64, shape (n_point_cells,), optional
        What `count_neighbours` finds; counted here, if not given.

    Returns
    -------
    int32, shape (n_cells,)

    Raises
    ------
    SceneError
        More parts than cells, or than sums are exact for.
    """
    n_cells = len(discretization.mesh.cells)
    check_ranks(n_parts, n_cells)
    points = np.flatnonzero(discretization.has_points)
    if neighbours is None:
        neighbours = _neighbours(discretization, points) if n_parts > 1 else np.zeros(len(points), np.int64)
    weights = _costs(discretization)
    weights[points] += NEIGHBOUR_COST * neighbours
    return bisect(centroids_of(discretization), weights, n_parts)


def check_ranks(n_ranks: int, n_cells: int) -> None:
    """Refuse numbers of ranks that no body can be divided among, or not this one.

    Raises
    ------
    SceneError
    """
    if n_ranks > MOST_RANKS:
        raise SceneError(
            [f"{n_ranks} ranks are more than {MOST_RANKS:,}, up to which sums over ranks are exact. Use fewer."]
        )
    if n_ranks > n_cells:
        raise SceneError([too_many_ranks(n_ranks, n_cells)])


def _costs(discretization: Discretization) -> np.ndarray:
    """Cost of each cell without its bonds; int64, shape (n_cells,)."""
    costs = np.full(len(discretization.mesh.cells), CYCLE_COST if discretization.has_cycle else 0, np.int64)
    costs[discretization.has_nodes] += ELEMENT_COST
    return costs


def deal_out(discretization: Discretization, comm: Intracomm) -> tuple[np.ndarray, np.ndarray]:
    """Cells that `partition` gives to this rank, of a body of which each rank answers for a part. Collective.

    Returns
    -------
    numbers : int64, shape (n_owned,)
        In the whole mesh, rising.
    centroids : float64, shape (n_owned, 3), dimension length
        Model units.
    """
    own, weights = discretization.mesh.everywhere.own, _costs(discretization)
    points = np.flatnonzero(own & discretization.has_points)
    weights[points] += NEIGHBOUR_COST * _neighbours(discretization, points)
    return deal(comm, discretization.mesh.cell_id[own], centroids_of(discretization)[own], weights[own])
