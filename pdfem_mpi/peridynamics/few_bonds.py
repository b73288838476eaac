"""Pairs of ranks with few bonds between them: one of the two takes all of them, and its ghosts travel one way.

Ranks that meet at an edge or a corner have less than a fifth of the bonds that they have with a rank across a face
(for cubes of an edge `a` about `0.17 r_c / a` and less). A message between them costs as much as one with many ghosts;
so there is one in place of two. Ranks across a face go on to share their bonds, or the ranks' work would be uneven.

Which of the two takes the bonds is settled in turns, by who has fewer rows at that time: the pairs of a turn are known
from the ranks' numbers, and loads are told before each. All numbers are counts, so that both ranks decide alike.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pdfem_mpi.parallel.directory import Exchange
from pdfem_mpi.peridynamics.points import Depths, Points

#: Rows of a pair over those of the largest pair of either rank, up to which they are few. Pairs across an edge were
#: found to have up to 0.15, and across a face 0.6 and more.
FEW = 0.25
#: Turns in which pairs are settled, by the distance of the ranks' numbers. With one, a rank that has little takes what
#: all its neighbours have to give.
TURNS = 8


def settled(points: Points, comm, rows_at_cells: np.ndarray) -> Points | None:
    """The points with depths by which few bonds are on one side; None, if this rank has no such pair. Collective.

    Parameters
    ----------
    points : Points
        With depths.
    rows_at_cells : int64, shape (n_cells,)
        Rows between ranks that point at each local cell, as the depths share them out.
    """
    neighbours, owner = np.array(points.halo.neighbours, np.int64), points.depths.neighbour
    rows = np.zeros(len(neighbours), np.int64)
    np.add.at(rows, owner[owner >= 0], rows_at_cells[owner >= 0])
    few, taken = share_out(comm, neighbours, rows)
    if not few.any():
        return None
    return replace(points, depths=_one_sided(points.depths, points.n_owned, few, taken))


def share_out(comm, neighbours: np.ndarray, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Which pairs have few bonds, and whether this rank takes them; bool, shape (n_neighbours,). Collective.

    Parameters
    ----------
    neighbours : int64, shape (n_neighbours,)
        Ranks, rising.
    rows : int64, shape (n_neighbours,)
        This rank's rows of bonds with each.
    """
    told = Exchange(comm, neighbours)
    both = rows + told.there(rows)
    own_most = both.max(initial=0)
    least_most = np.minimum(own_most, told.there(np.full(len(both), own_most)))
    few = (both > 0) & (both <= FEW * least_most)
    taken = np.zeros(len(few), bool)
    apart = np.abs(neighbours - comm.rank)
    first = (comm.rank < neighbours) == (apart % 2 == 0)
    load = int((2 * rows - both)[~few].sum())  # twice the rows beyond an even share
    for turn in range(TURNS):
        other = told.there(np.full(len(few), load))
        now = few & (apart % TURNS == turn)
        taken[now] = np.where(load == other, first, load < other)[now]
        load += int(np.where(taken, both, -both)[now].sum())
    return few, taken


def _one_sided(depths: Depths, n_owned: int, few: np.ndarray, taken: np.ndarray) -> Depths:
    """Depths of which this rank has the larger ones in each pair that it takes, and the smaller ones in others."""
    neighbour, depth = depths.neighbour, depths.depth.copy()
    depth[:n_owned, few] = taken[few]
    ghosts = np.flatnonzero(neighbour >= 0)
    of = neighbour[ghosts]
    ghosts, of = ghosts[few[of]], of[few[of]]
    depth[ghosts, of] = ~taken[of]
    return Depths(neighbour, depth)
