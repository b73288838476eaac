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

import math
from dataclasses import dataclass

import numpy as np

from pdfem_mpi.kernels.components import join_rows, spread_smallest
from pdfem_mpi.kernels.simd import W
from pdfem_mpi.mesh.rigid_motions import rigid_motions
from pdfem_mpi.model.model import Model
from pdfem_mpi.parallel.comm import distinct, largest, sum_integers
from pdfem_mpi.peridynamics.clusters import point_rows
from pdfem_mpi.peridynamics.images import SCALAR, halo_for

#: A motion is free when the supports keep less than this fraction of what they keep of the best held one.
HELD = 1e-9
#: A rotation that moves a part less than this fraction of its size, as that of a point or a line, is none.
NO_ROTATION = 1e-9
#: Loads work on a free motion when this fraction of their absolute work is left over.
BALANCE_TOLERANCE = 1e-9
#: Places that move at least this fraction of the largest displacement belong to the region of a motion.
MOVING = 0.3
#: A motion is called a rotation from this fraction of its square on.
TURNING = 0.05
#: Parts that a message names, at most.
NAMED = 3

_NAMES = tuple(f"the {kind} {axis}" for kind in ("translation along", "rotation about") for axis in "xyz")
_PAIRS = np.tril_indices(6)
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
class Loose:
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
        return _motion_names(self.motions)


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
        parts = [*model.elements.shared, *([model.elements.general] if model.elements.general else [])]
        for part in parts:
            join_rows(part.connectivity + np.int64(n_points), parent)
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
    labels = distinct(model.comm, own)
    of = np.searchsorted(labels, own) if len(labels) > 1 else np.zeros(len(own), np.int64)
    return Parts(of, len(labels))


def find_loose(model: Model, parts: Parts, fixed: np.ndarray) -> tuple[Loose, ...]:
    """Parts that supports do not hold, with the motions left to them. Collective.

    Parameters
    ----------
    fixed : bool, shape (n_unknowns,)
    """
    x, held = _positions(model), model.unknowns.rows(fixed)
    ones = np.ones(len(x), bool)
    sums = _sums(model.comm, parts, ones, np.column_stack([np.ones(len(x)), x]))
    number, centre = sums[:, :1], sums[:, 1:] / sums[:, :1]
    y = x - centre[parts.of]
    products = y[:, :, None] * y[:, None, :]
    second = _sums(model.comm, parts, ones, products.reshape(-1, 9)).reshape(-1, 3, 3) / number[:, :, None]
    inertia = np.trace(second, axis1=1, axis2=2)[:, None, None] * np.eye(3) - second
    kept = np.zeros((len(x), 21))
    anywhere = held.any(axis=1)
    modes = _modes(y[anywhere]) * held[anywhere][:, None, :]
    for column, (a, b) in enumerate(zip(*_PAIRS, strict=True)):
        kept[anywhere, column] = (modes[:, a] * modes[:, b]).sum(axis=1)
    kept = _sums(model.comm, parts, anywhere, kept)
    if model.mirrors:
        size = np.trace(second, axis1=1, axis2=2)[:, None]
        kept[:, _DIAGONAL] += number * _kept_by_planes(model, parts) * np.where(np.arange(6) < 3, 1.0, size)
    texts = _texts(model, parts)
    found = []
    for part in range(parts.count):
        motions = _left_free(inertia[part], kept[part])
        if len(motions):
            found.append(Loose(part, centre[part], motions, texts[part]))
    return tuple(found)


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
    across = _sums(model.comm, parts, np.ones(len(across), bool), across) > 0.0
    others = across.sum(axis=1)[:, None] - across
    return np.concatenate([across, others > 0], axis=1)


def _left_free(inertia: np.ndarray, kept: np.ndarray) -> np.ndarray:
    """Motions of a part, (n_motions, 6), that are motions at all and that its supports do not keep."""
    values, axes = np.linalg.eigh(inertia)
    radius = math.sqrt(max(values[-1], 0.0))
    real = values > NO_ROTATION * max(values[-1], 1e-300)
    basis = np.zeros((3 + np.count_nonzero(real), 6))  # translations, and rotations that move the part as much
    basis[:3, :3] = np.eye(3)
    if radius > 0.0:
        basis[3:, 3:] = axes[:, real].T / np.sqrt(values[real])[:, None]
    gram = np.zeros((6, 6))
    gram[_PAIRS] = kept
    gram = np.tril(gram) + np.tril(gram, -1).T
    strength, vectors = np.linalg.eigh(basis @ gram @ basis.T)
    free = vectors[:, strength <= HELD * max(strength[-1], 0.0)].T @ basis
    return np.linalg.qr(free.T)[0].T if len(free) else free


def unbalanced(model: Model, parts: Parts, loose: tuple[Loose, ...], external: np.ndarray) -> list[str]:
    """A sentence for each loose part whose loads work on a motion that nothing holds. Collective.

    Parameters
    ----------
    external : float64, shape (n_unknowns,), dimension force
        0 on fixed unknowns.
    """
    messages, units = [], model.units
    for part, row, motion in _out_of_balance(model, parts, loose, external):
        total = np.where(np.abs(row[:6]) > BALANCE_TOLERANCE * row[6:], row[:6], 0.0)
        net = ", ".join(f"{f:.6g}" for f in total[:3] * units.force)
        moment = ", ".join(f"{m:.6g}" for m in total[3:] * units.force * units.length)
        messages.append(
            f"loads are not in balance on a part of the body that hangs together with no other, {part.text}: they sum "
            f"to a force of ({net}) and a moment of ({moment}) about its middle, and no support holds "
            f"{_motion_names(part.motions[[motion]])}. Support that part, balance its loads, or let the "
            "crack end inside the body."
        )
    left = len(messages) - NAMED
    return messages[:NAMED] + ([f"and {left} parts more of this kind."] if left > 0 else [])


def without_equilibrium(model: Model, fixed: np.ndarray, external: np.ndarray) -> tuple[np.ndarray, list[Loose]]:
    """Unknowns of the parts that hang together now and whose loads nothing balances, and those parts. Collective.

    Parameters
    ----------
    fixed : bool, shape (n_unknowns,)
    external : float64, shape (n_unknowns,), dimension force
        0 on fixed unknowns.

    Returns
    -------
    bool, shape (n_unknowns,)
    list of Loose
    """
    parts = find_parts(model)
    wrong = [part for part, _, _ in _out_of_balance(model, parts, find_loose(model, parts, fixed), external)]
    rows = np.isin(parts.of, [part.part for part in wrong])
    rows = np.repeat(rows[:, None], 3, axis=1)
    return model.unknowns.join(rows), wrong


def _out_of_balance(model: Model, parts: Parts, loose: tuple[Loose, ...], external: np.ndarray):
    """Loose parts with unbalanced loads; their forces, moments and the sums of magnitudes; their worst motion.

    Returns
    -------
    list of (Loose, float64 of shape (12,), int)
    """
    if not loose:
        return []
    which, y = _within(model, parts, loose)
    force = model.unknowns.rows(external)
    modes = _modes(y)
    terms = modes * force[which >= 0][:, None]
    table = np.zeros((len(which), 12))
    table[which >= 0] = np.concatenate([terms.sum(axis=2), np.abs(terms).sum(axis=2)], axis=1)
    sums = _sums(model.comm, Parts(np.maximum(which, 0), len(loose)), which >= 0, table)
    found = []
    for part, row in zip(loose, sums, strict=True):
        work = np.abs(part.motions @ row[:6])
        gross = np.abs(part.motions) @ row[6:]
        if (work > BALANCE_TOLERANCE * gross.max()).any():
            found.append((part, row, int(np.argmax(work))))
    return found


def settle(model: Model, parts: Parts, loose: tuple[Loose, ...], volume: np.ndarray, u: np.ndarray) -> None:
    """Take its free motions out of each loose part: their means over the part's volume vanish. Collective.

    Parameters
    ----------
    volume, u : float64, shape (n_unknowns,), dimensions length^3 and length
        ``u`` is overwritten.
    """
    if not loose:
        return
    which, y = _within(model, parts, loose)
    inside = which >= 0
    weight, rows = model.unknowns.rows(volume)[inside, :1], model.unknowns.rows(u)
    modes = _modes(y)
    table = np.zeros((len(which), 27))
    for column, (a, b) in enumerate(zip(*_PAIRS, strict=True)):
        table[inside, column] = weight[:, 0] * (modes[:, a] * modes[:, b]).sum(axis=1)
    table[inside, 21:] = weight * (modes * rows[inside][:, None]).sum(axis=2)
    sums = _sums(model.comm, Parts(np.maximum(which, 0), len(loose)), inside, table)
    motion = np.zeros((len(loose), 6))
    for k, part in enumerate(loose):
        gram = np.zeros((6, 6))
        gram[_PAIRS] = sums[k, :21]
        gram = np.tril(gram) + np.tril(gram, -1).T
        amounts = np.linalg.solve(part.motions @ gram @ part.motions.T, part.motions @ sums[k, 21:])
        motion[k] = amounts @ part.motions
    for mode in range(6):
        rows[inside] -= motion[which[inside], mode, None] * modes[:, mode]
    u[:] = model.unknowns.join(rows)


def describe_loose(parts: Parts, loose: tuple[Loose, ...]) -> list[str]:
    """A line that tells how many parts there are, and one for each of the first loose ones; none for a single part."""
    if parts.count == 1:
        return []
    held = parts.count - len(loose)
    lines = [f"the body is in {parts.count:,} parts that hang together, {held:,} of them held by supports"]
    lines += [f"  {part.text}: nothing holds {part.names()}" for part in loose[:NAMED]]
    return lines + ([f"  and {len(loose) - NAMED:,} parts more"] if len(loose) > NAMED else [])


def describe_motion(model: Model, motion: np.ndarray) -> str:
    """Where a motion takes place and what it is like, as part of a sentence. Collective.

    Parameters
    ----------
    motion : float64, shape (n_unknowns,), dimension length
        Of any size, such as a search direction that met no stiffness.
    """
    rows, x = model.unknowns.rows(motion), _positions(model)
    length = np.abs(rows).max(axis=1, initial=0.0)
    peak = float(largest(model.comm, np.array([length.max(initial=0.0)]))[0])
    if not 0.0 < peak < math.inf:
        return "no displacement"
    inside = length >= MOVING * peak
    region = Parts(np.zeros(len(x), np.int64), 1)
    sums = _sums(model.comm, region, inside, np.column_stack([np.ones(len(x)), x]))[0]
    modes = _modes(x - sums[1:] / sums[0])
    table = np.zeros((len(x), 27))
    for column, (a, b) in enumerate(zip(*_PAIRS, strict=True)):
        table[:, column] = (modes[:, a] * modes[:, b]).sum(axis=1)
    table[:, 21:] = (modes * (rows / peak)[:, None]).sum(axis=2)
    fit = _sums(model.comm, region, inside, table)[0]
    gram = np.zeros((6, 6))
    gram[_PAIRS] = fit[:21]
    gram = np.tril(gram) + np.tril(gram, -1).T
    amounts = np.linalg.lstsq(gram, fit[21:], rcond=NO_ROTATION)[0]
    shares = amounts**2 * np.diag(gram)
    if shares[3:].sum() > TURNING * shares.sum():  # about an axis beside the region it looks like a translation
        shares[:3] = 0.0
    text = _texts(model, Parts(np.where(inside, 0, 1), 2))[0]
    return f"{text} move, mostly by {_NAMES[int(np.argmax(shares))]}"


def _motion_names(motions: np.ndarray) -> str:
    """Names of orthonormal motions: all that are free as they are, then the largest of the rest, rotations first."""
    if len(motions) == 6:
        return "it"
    alone = (motions**2).sum(axis=0) > 1.0 - 1e-6
    names = [name for name, free in zip(_NAMES, alone, strict=True) if free]
    if len(names) < len(motions):
        # a rotation about an axis beside the centre has a translation in it
        weight = np.where(alone, 0.0, (motions**2).sum(axis=0))
        ranked = sorted(range(6), key=lambda k: (weight[k] < 1e-12, k < 3, -weight[k]))
        names += [_NAMES[k] for k in ranked[: len(motions) - len(names)]]
    return ", ".join(names[:-1]) + (" and " if len(names) > 1 else "") + names[-1]


def _positions(model: Model) -> np.ndarray:
    parts = [point_rows(model.unknowns.of_points(model.points.x))] if model.points else []
    return np.concatenate([*parts, *([model.nodes.x[: model.nodes.n_owned]] if model.nodes else [])])


def _modes(y: np.ndarray) -> np.ndarray:
    """The rigid motions at positions (n, 3) with places first, shape (n, 6, 3)."""
    return np.ascontiguousarray(rigid_motions(y).swapaxes(0, 1))


def _within(model: Model, parts: Parts, loose: tuple[Loose, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Index in ``loose`` of each row, -1 elsewhere, and positions of the rows inside from their part's centre."""
    index = np.full(parts.count, -1)
    index[[part.part for part in loose]] = np.arange(len(loose))
    which = index[parts.of]
    centres = np.array([part.centre for part in loose])
    return which, _positions(model)[which >= 0] - centres[which[which >= 0]]


def _sums(comm, parts: Parts, chosen: np.ndarray, numbers: np.ndarray) -> np.ndarray:
    """Sums of rows of numbers over the parts, (count, n_columns), terms rounded to a column's quantum. Collective."""
    top = largest(comm, np.abs(numbers[chosen]).max(axis=0, initial=0.0))
    rows = int(sum_integers(comm, np.array([len(numbers)]))[0])
    quanta = 2.0 ** (np.frexp(np.maximum(top, 1e-300))[1] - (61 - rows.bit_length()))
    terms = np.rint(numbers[chosen] / quanta).astype(np.int64)
    sums = np.zeros((parts.count, numbers.shape[1]), np.int64)
    if parts.count == 1:
        sums[0] = terms.sum(axis=0)
    else:
        np.add.at(sums, parts.of[chosen], terms)
    return sum_integers(comm, sums) * quanta


def _texts(model: Model, parts: Parts) -> list[str]:
    """Size and place of each part. Collective."""
    x, n = _positions(model), model.unknowns.n_points
    numbers = np.zeros((parts.count, 2), np.int64)
    np.add.at(numbers, (parts.of, (np.arange(len(x)) >= n).astype(int)), 1)
    numbers = sum_integers(model.comm, numbers)
    reach = np.full((parts.count, 6), -np.inf)
    np.maximum.at(reach, parts.of, np.concatenate([x, -x], axis=1))
    reach = largest(model.comm, reach)
    texts, units = [], model.units
    for (n_points, n_nodes), row in zip(numbers, reach, strict=True):
        counts = [
            f"{count:,} {name}{'' if count == 1 else 's'}"
            for count, name in ((n_points, "point"), (n_nodes, "node"))
            if count
        ]
        lower, upper = (
            ", ".join(f"{c:.6g}" for c in corner * units.length + units.origin) for corner in (-row[3:], row[:3])
        )
        texts.append(f"{' and '.join(counts)} from ({lower}) to ({upper})")
    return texts
