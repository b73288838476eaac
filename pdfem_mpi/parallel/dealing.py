"""Recursive bisection of cells that ranks hold parts of: the owners that `bisection.bisect` finds with all of them.

In each step the ranks of a set of cells find the dividing planes across x, y and z by sums of integers: the cell at
which the weight before it reaches a share is sought digit by digit of its coordinate and number. The cells then go to
the half of the ranks that their side belongs to, and each half goes on by itself. A rank holds as many cells as the
others all the while.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from pdfem_mpi.parallel.bisection import REACH, SLACK, mean_edge
from pdfem_mpi.parallel.comm import largest, sum_before, sum_integers
from pdfem_mpi.parallel.directory import Exchange

if TYPE_CHECKING:
    from mpi4py.MPI import Intracomm

#: Bits of a digit, and of a coordinate.
DIGIT, COORDINATE = 11, 64

Array = np.ndarray


@dataclass(frozen=True)
class Cells:
    """Cells that a rank holds for the time being.

    Attributes
    ----------
    id, weight : int64, shape (n,)
    place : float64, shape (n, 3), dimension length
    """

    id: Array
    weight: Array
    place: Array

    def keys(self) -> Array:
        """Coordinates as integers that are in the same order, uint64, shape (3, n)."""
        bits = np.ascontiguousarray((self.place + 0.0).T).view(np.uint64)  # no -0
        negative = bits >> np.uint64(63) == 1
        return np.where(negative, ~bits, bits | np.uint64(1 << 63))

    def at_ranks(self, comm: Intracomm, to: Array) -> Cells:
        """What this rank holds when all have sent their cells to these ranks, int64 (n,). Collective."""
        exchange = Exchange(comm, to)
        return Cells(*(exchange.there(rows) for rows in (self.id, self.weight, self.place)))


@dataclass(frozen=True)
class Cut:
    """Cells that come first along x, y and z: those before a coordinate and, of equal ones, before an id.

    Attributes
    ----------
    key : uint64, shape (3,)
    id : int64, shape (3,)
    before, own : int64, shape (3,)
        Sums of what was counted of the cells before, and of the cell that is there.
    """

    key: Array
    id: Array
    before: Array
    own: Array

    def less(self, cells: Cells, keys: Array) -> Array:
        """Cells before the cut, bool, shape (3, n)."""
        key, number = self.key[:, None], self.id[:, None]
        return (keys < key) | ((keys == key) & (cells.id < number))


def deal(comm: Intracomm, ids: Array, places: Array, weights: Array) -> tuple[Array, Array]:
    """Give each rank the cells that `bisect` would, with as many parts as ranks. Collective.

    Parameters
    ----------
    ids : int64, shape (n_held,)
        Of the cells that this rank holds; each cell of the body, at least as many as ranks, is held by one rank.
    places : float64, shape (n_held, 3), dimension length
        Centres of the cells.
    weights : int64, shape (n_held,), >= 1

    Returns
    -------
    ids : int64, shape (n_owned,)
        Rising.
    places : float64, shape (n_owned, 3)
    """
    if not np.isfinite(places).all() or (weights < 1).any():
        raise ValueError("deal: places must be finite and weights positive.")
    cells = Cells(np.asarray(ids, np.int64), np.asarray(weights, np.int64), np.asarray(places, np.float64))
    n = int(sum_integers(comm, np.array([len(ids)]))[0])
    low, high = _extent(comm, cells)
    edge = mean_edge(n, high - low)
    digits = [*_shifts(COORDINATE), *(shift - COORDINATE for shift in _shifts(n.bit_length()))]
    part, owned = comm, cells
    while part.size > 1:
        left = _left_side(part, owned, edge, digits)
        whole, part = part, part.Split(int(part.rank >= part.size // 2), part.rank)
        owned = owned.at_ranks(whole, _receivers(whole, left))
        if whole is not comm:
            whole.Free()
    if part is not comm:
        part.Free()
    order = np.argsort(owned.id, kind="stable")
    return owned.id[order], owned.place[order]


def _shifts(bits: int) -> range:
    return range(DIGIT * (-(-bits // DIGIT) - 1), -1, -DIGIT)


def _extent(comm: Intracomm, cells: Cells) -> tuple[Array, Array]:
    """Lowest and highest coordinates of all cells, both (3,). Collective."""
    ends = np.full(6, -np.inf)
    if len(cells.id):
        ends = np.concatenate([(-cells.place).max(axis=0), cells.place.max(axis=0)])
    ends = largest(comm, ends)
    return -ends[:3], ends[3:]


def _left_side(comm: Intracomm, cells: Cells, edge: float, digits: list[int]) -> Array:
    """Cells that the lower half of the ranks gets, bool, shape (n,): see `bisect` for which. Collective."""
    keys, ones = cells.keys(), np.ones(len(cells.id), np.int64)
    n, weight = sum_integers(comm, np.array([len(cells.id), cells.weight.sum()])).tolist()
    n_left = comm.size // 2
    share = weight * n_left // comm.size
    first = _select(comm, cells, keys, cells.weight, np.full(3, share), digits)
    k = sum_integers(comm, np.count_nonzero(first.less(cells, keys), axis=1))
    k += np.abs(first.before - share) > np.abs(first.before + first.own - share)
    ends = sorted((n_left, n - (comm.size - n_left)))
    k = np.clip(k, max(ends[0], 0), ends[1])
    cut = _select(comm, cells, keys, ones, k, digits)
    less = cut.less(cells, keys)
    below = largest(comm, np.where(less, cells.place.T, -np.inf).max(axis=1, initial=-np.inf))
    above = _coordinates(cut.key)
    low, high = _extent(comm, cells)
    reach = np.maximum(REACH * edge, 0.5 * (above - below) + SLACK * edge)
    plane = 0.5 * (below + above)
    near = [np.count_nonzero(cells.place < end, axis=0) for end in (plane - reach, plane + reach)]
    first_near, last_near = sum_integers(comm, np.array(near))
    axis = min((int(last_near[d] - first_near[d]), float(low[d] - high[d]), d) for d in range(3))[2]
    return less[axis]


def _coordinates(keys: Array) -> Array:
    """The coordinates of keys, float64, shape (3,)."""
    positive = keys >> np.uint64(63) == 1
    return np.where(positive, keys & np.uint64((1 << 63) - 1), ~keys).view(np.float64)


def _select(comm: Intracomm, cells: Cells, keys: Array, amounts: Array, targets: Array, digits: list[int]) -> Cut:
    """The cell along x, y and z up to which, itself included, the sum of amounts exceeds a target. Collective.

    Parameters
    ----------
    amounts : int64, shape (n,), >= 1
    targets : int64, shape (3,), below the sum of all amounts
    """
    left, alive = np.array(targets, np.int64), [np.arange(len(cells.id))] * 3
    found, numbers, own = np.zeros(3, np.uint64), np.zeros(3, np.int64), np.zeros(3, np.int64)
    for shift in digits:
        of_id, table, digit = shift < 0, np.zeros((3, 1 << DIGIT), np.int64), []
        for d in range(3):
            words = cells.id[alive[d]].astype(np.uint64) if of_id else keys[d, alive[d]]
            move = np.uint64(shift + COORDINATE if of_id else shift)
            digit.append(((words >> move) & np.uint64((1 << DIGIT) - 1)).astype(np.int64))
            np.add.at(table[d], digit[d], amounts[alive[d]])
        table = sum_integers(comm, table)
        for d in range(3):
            sums = np.cumsum(table[d])
            pick = int(np.searchsorted(sums, left[d], side="right"))
            own[d] = table[d, pick]
            left[d] -= sums[pick] - own[d]
            alive[d] = alive[d][digit[d] == pick]
            if of_id:
                numbers[d] |= pick << (shift + COORDINATE)
            else:
                found[d] |= np.uint64(pick << shift)
    return Cut(found, numbers, targets - left, own)


def _receivers(comm: Intracomm, left: Array) -> Array:
    """Ranks that cells go to, as many to each rank of a side as to the others; int64, shape (n,). Collective."""
    counts = np.array([np.count_nonzero(left), np.count_nonzero(~left)])
    before, total = sum_before(comm, counts), sum_integers(comm, counts)
    n_left = comm.size // 2
    to = np.empty(len(left), np.int64)
    for side, (first, n) in zip((left, ~left), ((0, n_left), (n_left, comm.size - n_left)), strict=True):
        k = int(first != 0)
        number = before[k] + np.arange(counts[k])
        to[side] = first + number * n // max(int(total[k]), 1)
    return to


def median(comm: Intracomm, values: Array) -> float:
    """Median of the numbers of all ranks, as `numpy.median` has it. Collective.

    Parameters
    ----------
    values : float64, shape (n,)
    """
    n = int(sum_integers(comm, np.array([len(values)]))[0])
    targets = np.array([(n - 1) // 2, n // 2, n // 2])
    rows = Cells(np.zeros(len(values), np.int64), np.ones(len(values), np.int64), np.repeat(values[:, None], 3, axis=1))
    found = _coordinates(_select(comm, rows, rows.keys(), rows.weight, targets, list(_shifts(COORDINATE))).key)
    return 0.5 * float(found[0] + found[1])
