"""Parts of the body that hang together through surviving bonds, elements and the overlap, and what holds each of them.

A part is found by union and find on each rank; the smallest global id of its points and nodes is its label, spread over
the ranks until nothing changes. So labels do not depend on the order of bonds or on the number of ranks. Sums over
parts are sums of integers: the same bits on any number of ranks.

A part moves rigidly without force. Where supports do not hold a rigid motion of a part, equilibrium asks that the loads
on that part do no work on it, and the motion itself is arbitrary: it is chosen so that its mean over the part's volume
vanishes. Parts that hang together by too little to be rigid, like two blocks with one common edge, are one part here:
`describe_motion` names such a mechanism once a solver has met it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pdfem_mpi.kernels.simd import W
from pdfem_mpi.kernels.union_find import join_rows, spread_smallest
from pdfem_mpi.model.model import Model
from pdfem_mpi.model.motions import PAIRS, left_free, modes_at, motion_names
from pdfem_mpi.model.restraints import sprung_unknowns
from pdfem_mpi.parallel.comm import largest, sum_integers
from pdfem_mpi.parallel.directory import Directory
from pdfem_mpi.peridynamics.clusters import point_rows
from pdfem_mpi.peridynamics.images import SCALAR, halo_for

#: Parts that a message names, at most.
NAMED = 3
_DIAGONAL = [k * (k + 3) // 2 for k in range(6)]  # of pairs of equal motions


@dataclass(frozen=True)
class Parts:
    """Which unknowns hang together.

    Attributes
    ----------
    of : int64, shape (n_triples,)
        Number of the part of each free point, by cluster and lane, then of each owned node.
    count : int
        Parts of the whole body, numbered from 0 in the order of their smallest global id.
    """

    of: np.ndarray
    count: int


@dataclass(frozen=True)
class UnsupportedPart:
    """A part with rigid motions that no support holds.

    Attributes
    ----------
    part : int
    centre : float64, shape (3,), dimension length
    motions : float64, shape (n_motions, 6)
        Orthonormal combinations of translations and of rotations about the centre.
    text : str
        The part's size and place, in the deck's units.
    """

    part: int
    centre: np.ndarray
    motions: np.ndarray
    text: str

    def names(self) -> str:
        """The free motions in words."""
        return motion_names(self.motions)


def find_parts(model: Model) -> Parts:
    """Connected components of the body as it is now. Collective."""
    points, bonds, nodes = model.points, model.bonds, model.nodes
    n_points = 8 * len(points.cell_number) if points else 0
    n_nodes = len(nodes.number) if nodes else 0
    parent = np.arange(n_points + n_nodes)
    label = np.empty(n_points + n_nodes, np.int64)
    if points:
        label[:n_points] = (8 * points.cell_number[:, None] + np.arange(8)).reshape(-1)
        bonded = np.zeros(n_points, np.int64)
        bonds.join(parent, bonded)
        halo_for(points.halo, SCALAR).scatter_reverse(bonded.reshape(-1, 2, 1, W))
        if points.images:
            source = points.images.source  # what hangs on an image hangs on its point
            cells = np.column_stack([source, len(points.cell_number) - len(source) + np.arange(len(source))])
            join_rows((8 * cells[:, None] + np.arange(8)[:, None]).reshape(-1, 2), parent)
    if nodes:
        above = int(largest(model.comm, np.array([label[:n_points].max(initial=-1)], float))[0]) + 1
        label[n_points:] = above + nodes.number
    if model.elements:
        kinds = [*model.elements.shared, *([model.elements.general] if model.elements.general else [])]
        for elements in kinds:
            join_rows(elements.connectivity + np.int64(n_points), parent)
    if model.overlap:
        # a point of the overlap moves with the nodes of its cell, and ties them to its bonds
        own = np.arange(8 * points.n_free, 8 * points.n_owned)
        tied = np.column_stack([own, np.repeat(model.overlap.connectivity, 8, axis=0) + n_points])
        join_rows(tied[bonded[own] > 0], parent)
    while True:
        before = label.copy()
        spread_smallest(parent, label)
        if points:
            points.halo.scatter_smallest(label[:n_points].reshape(-1, 8))
        if nodes:
            nodes.halo.scatter_smallest(label[n_points:])
        if not sum_integers(model.comm, np.array([np.count_nonzero(before != label)]))[0]:
            break
    own = np.concatenate(
        [label[: 8 * points.n_free] if points else label[:0], label[n_points:][: nodes.n_owned if nodes else 0]]
    )
    return _numbered(model, own)


def _numbered(model: Model, label: np.ndarray) -> Parts:
    """Number the labels, int64 (n_triples,), from 0 in rising order; no rank has the list of them. Collective."""
    comm, ends = model.comm, np.array([-np.inf, -np.inf])
    if len(label):
        ends = np.array([label.max(), -label.min()], float)
    last, first = largest(comm, ends).tolist()
    if last == -first:
        return Parts(np.zeros(len(label), np.int64), 1)
    numbers = Directory.of_places(comm, label, int(last) + 1)
    return Parts(numbers.ask(label), numbers.count())


def find_unsupported(model: Model, parts: Parts, fixed: np.ndarray) -> tuple[UnsupportedPart, ...]:
    """Parts that supports, springs and ties do not hold, with the motions left to them. Collective.

    Parameters
    ----------
    fixed : bool, shape (n_unknowns,)
    """
    x, held = positions(model), model.unknowns.rows(fixed | sprung_unknowns(model))
    ones = np.ones(len(x), bool)
    sums = sum_over_parts(model.comm, parts, ones, np.column_stack([np.ones(len(x)), x]))
    number, centre = sums[:, :1], sums[:, 1:] / sums[:, :1]
    y = x - centre[parts.of]
    products = y[:, :, None] * y[:, None, :]
    second = sum_over_parts(model.comm, parts, ones, products.reshape(-1, 9)).reshape(-1, 3, 3) / number[:, :, None]
    inertia = np.trace(second, axis1=1, axis2=2)[:, None, None] * np.eye(3) - second
    kept = np.zeros((len(x), 21))
    anywhere = held.any(axis=1)
    modes = modes_at(y[anywhere]) * held[anywhere][:, None, :]
    for column, (a, b) in enumerate(zip(*PAIRS, strict=True)):
        kept[anywhere, column] = (modes[:, a] * modes[:, b]).sum(axis=1)
    kept = sum_over_parts(model.comm, parts, anywhere, kept)
    if model.ties:
        kept += _kept_by_ties(model, parts, y)
    if model.mirrors:
        size = np.trace(second, axis1=1, axis2=2)[:, None]
        kept[:, _DIAGONAL] += number * _kept_by_planes(model, parts) * np.where(np.arange(6) < 3, 1.0, size)
    counts, reach = extents(model, parts)
    found = []
    for part in range(model.comm.rank, parts.count, model.comm.size):  # the ranks take turns: parts may be many
        motions = left_free(inertia[part], kept[part])
        if len(motions):
            found.append(UnsupportedPart(part, centre[part], motions, in_words(model, counts[part], reach[part])))
    found = [part for some in model.comm.allgather(found) for part in some]
    return tuple(sorted(found, key=lambda part: part.part))


def _kept_by_ties(model: Model, parts: Parts, y: np.ndarray) -> np.ndarray:
    """What ties keep of the motions of each part, shape (count, 21), as `PAIRS` runs. Collective.

    A tie within one part keeps what its places move against each other, and lets be what all of them do alike. One
    between parts counts as a support: what holds the other part is not looked at.

    Parameters
    ----------
    y : float64, shape (n_triples, 3), dimension length
        Positions from the middle of each one's part.
    """
    kept = np.zeros((parts.count, len(PAIRS[0])))
    for group in model.ties.groups:
        tied = np.zeros(model.n_unknowns, bool)
        tied[group.index] = True
        places = model.unknowns.rows(tied)[:, group.axis]
        along = modes_at(y[places])[:, :, group.axis]
        table = np.zeros((len(places), 28))
        table[places, 0] = 1.0
        table[places, 1:7] = along
        table[places, 7:] = along[:, PAIRS[0]] * along[:, PAIRS[1]]
        sums = sum_over_parts(model.comm, parts, places, table)
        number, sum_, squares = sums[:, :1], sums[:, 1:7], sums[:, 7:]
        alike = np.where(number == group.count, sum_[:, PAIRS[0]] * sum_[:, PAIRS[1]] / group.count, 0.0)
        kept += squares - alike
    return kept


def _kept_by_planes(model: Model, parts: Parts) -> np.ndarray:
    """Translations and rotations that each part cannot make: it hangs together with its image across a mirror plane.

    Nodes on a plane do not count: they are held anyway. Collective.

    Returns
    -------
    bool, shape (count, 6)
    """
    across = np.zeros((len(parts.of), 3), np.int64)
    if model.points:
        n = 8 * model.points.n_free
        across[:n] = model.bonds.planes_crossed(model.points)[:n]
    across = sum_over_parts(model.comm, parts, np.ones(len(across), bool), across) > 0.0
    others = across.sum(axis=1)[:, None] - across
    return np.concatenate([across, others > 0], axis=1)


def describe_unsupported(parts: Parts, unsupported: tuple[UnsupportedPart, ...]) -> list[str]:
    """A line with the number of parts, and one for each of the first unsupported ones; none for a single part."""
    if parts.count == 1:
        return []
    held = parts.count - len(unsupported)
    lines = [f"the body is in {parts.count:,} parts that hang together, {held:,} of them held by supports"]
    lines += [f"  {part.text}: nothing holds {part.names()}" for part in unsupported[:NAMED]]
    return lines + ([f"  and {len(unsupported) - NAMED:,} parts more"] if len(unsupported) > NAMED else [])


def positions(model: Model) -> np.ndarray:
    points = [point_rows(model.unknowns.of_points(model.points.x))] if model.points else []
    return np.concatenate([*points, *([model.nodes.x[: model.nodes.n_owned]] if model.nodes else [])])


def rows_within(model: Model, parts: Parts, unsupported: tuple[UnsupportedPart, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Index in ``unsupported`` of each row, -1 elsewhere, and positions of the rows inside from their part's centre."""
    index = np.full(parts.count, -1)
    index[[part.part for part in unsupported]] = np.arange(len(unsupported))
    which = index[parts.of]
    centres = np.array([part.centre for part in unsupported])
    return which, positions(model)[which >= 0] - centres[which[which >= 0]]


def sum_over_parts(comm, parts: Parts, chosen: np.ndarray, numbers: np.ndarray) -> np.ndarray:
    """Sums of rows of numbers over the parts, (count, n_columns), terms rounded to a column's quantum. Collective."""
    top = largest(comm, np.abs(numbers[chosen]).max(axis=0, initial=0.0))
    rows = int(sum_integers(comm, np.array([len(numbers)]))[0])
    quanta = np.ldexp(1.0, np.frexp(np.maximum(top, 1e-300))[1] - (61 - rows.bit_length()))
    terms = np.rint(numbers[chosen] / quanta).astype(np.int64)
    sums = np.zeros((parts.count, numbers.shape[1]), np.int64)
    if parts.count == 1:
        sums[0] = terms.sum(axis=0)
    else:
        np.add.at(sums, parts.of[chosen], terms)
    return sum_integers(comm, sums) * quanta


def extents(model: Model, parts: Parts) -> tuple[np.ndarray, np.ndarray]:
    """How many points and nodes each part has, and where it ends. Collective.

    Returns
    -------
    counts : int64, shape (count, 2)
    reach : float64, shape (count, 6), dimension length
        Upper corners, and lower ones with the other sign.
    """
    x, n = positions(model), model.unknowns.n_points
    numbers = np.zeros((parts.count, 2), np.int64)
    np.add.at(numbers, (parts.of, (np.arange(len(x)) >= n).astype(int)), 1)
    reach = np.full((parts.count, 6), -np.inf)
    np.maximum.at(reach, parts.of, np.concatenate([x, -x], axis=1))
    return sum_integers(model.comm, numbers), largest(model.comm, reach)


def in_words(model: Model, counts: np.ndarray, reach: np.ndarray) -> str:
    """Size and place of one of `extents`, in the deck's units."""
    sizes = [
        f"{count:,} {name}{'' if count == 1 else 's'}"
        for count, name in zip(counts, ("point", "node"), strict=True)
        if count
    ]
    units = model.units
    lower, upper = (
        ", ".join(f"{c:.6g}" for c in corner * units.length + units.origin) for corner in (-reach[3:], reach[:3])
    )
    return f"{' and '.join(sizes)} from ({lower}) to ({upper})"
