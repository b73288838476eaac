"""Rigid motions of the unknowns, which of them supports leave free, and what they are called."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from pdfem_mpi.kernels.dense import eigen, orthonormal_rows, product
from pdfem_mpi.mesh.rigid_motions import rigid_motions, write_rigid_motion
from pdfem_mpi.model.model import Model
from pdfem_mpi.parallel.comm import sum_integers
from pdfem_mpi.parallel.sums import exact_dots
from pdfem_mpi.peridynamics.clusters import by_component

#: A motion is free when the supports keep less than this fraction of what they keep of the best held one.
FREE = 1e-9
#: A rotation that moves a part less than this fraction of its size, as that of a point or a line, is none.
NO_ROTATION = 1e-9
MOTION_NAMES = tuple(f"the {kind} {axis}" for kind in ("translation along", "rotation about") for axis in "xyz")
PAIRS = np.tril_indices(6)


def symmetric(lower: np.ndarray) -> np.ndarray:
    """The symmetric matrix, (6, 6), whose lower triangle is given row by row, (21,), as `PAIRS` runs."""
    matrix = np.zeros((6, 6))
    matrix[PAIRS] = lower
    return np.tril(matrix) + np.tril(matrix, -1).T


def left_free(inertia: np.ndarray, kept: np.ndarray) -> np.ndarray:
    """Motions of a part, (n_motions, 6), that are motions at all and that its supports do not keep."""
    values, axes = eigen(inertia)
    radius = math.sqrt(max(values[-1], 0.0))
    real = values > NO_ROTATION * max(values[-1], 1e-300)
    basis = np.zeros((3 + np.count_nonzero(real), 6))  # translations, and rotations that move the part as much
    basis[:3, :3] = np.eye(3)
    if radius > 0.0:
        basis[3:, 3:] = axes[:, real].T / np.sqrt(values[real])[:, None]
    gram = symmetric(kept)
    strength, vectors = eigen(product(product(basis, gram), basis.T))
    free = product(vectors[:, strength <= FREE * max(strength[-1], 0.0)].T, basis)
    return orthonormal_rows(free)


def motion_names(motions: np.ndarray) -> str:
    """Names of orthonormal motions: all that are free as they are, then the largest of the rest, rotations first."""
    if len(motions) == 6:
        return "it"
    alone = (motions**2).sum(axis=0) > 1.0 - 1e-6
    names = [name for name, free in zip(MOTION_NAMES, alone, strict=True) if free]
    if len(names) < len(motions):
        # a rotation about an axis beside the centre has a translation in it
        weight = np.where(alone, 0.0, (motions**2).sum(axis=0))
        ranked = sorted(range(6), key=lambda k: (weight[k] < 1e-12, k < 3, -weight[k]))
        names += [MOTION_NAMES[k] for k in ranked[: len(motions) - len(names)]]
    return ", ".join(names[:-1]) + (" and " if len(names) > 1 else "") + names[-1]


def modes_at(y: np.ndarray) -> np.ndarray:
    """The rigid motions at positions (n, 3) with places first, shape (n, 6, 3)."""
    return np.ascontiguousarray(rigid_motions(y).swapaxes(0, 1))


def rigid_modes(model: Model, u: np.ndarray | None = None) -> Iterator[np.ndarray]:
    """Yield three translations and three rotations about the origin of the body displaced by ``u``; (n_unknowns,)."""
    unknowns, places = model.unknowns, []
    if model.points:
        places.append((lambda v: by_component(unknowns.of_points(v)), by_component(unknowns.of_points(model.points.x))))
    if model.nodes:
        places.append((unknowns.of_nodes, model.nodes.x[: model.nodes.n_owned]))
    if u is not None:
        places = [(part, x + part(u)) for part, x in places]
    for k in range(6):
        mode = np.zeros(model.n_unknowns)
        for part, x in places:
            write_rigid_motion(x, k, part(mode))
        yield mode


def free_motions(model: Model, fixed: np.ndarray, tied: bool = True) -> np.ndarray:
    """Combinations of the rigid modes that move neither fixed unknowns nor mirror planes, (n_modes, 6). Collective.

    Nor do they move springs or, unless ``tied`` is False, one place of a tie against another.
    """
    kept, ties = model.mirrors.kept_motions, model.ties if tied else None
    held = fixed.copy()
    if model.springs:
        held[model.springs.index] = True
    if not sum_integers(model.comm, np.array([np.count_nonzero(held) + (len(ties.index) if ties else 0)]))[0]:
        return np.eye(6)[kept]
    on_supports = [mode[held] for mode in rigid_modes(model)]
    if ties:
        apart = ties.apart(model.comm, rigid_modes(model))
        on_supports = [np.concatenate(pair) for pair in zip(on_supports, apart, strict=True)]
    whole = exact_dots(model.comm, ((mode, mode) for mode in rigid_modes(model)))
    scale = 1.0 / np.sqrt(np.maximum(whole, 1e-300))
    pairs = ((a, b) for i, a in enumerate(on_supports) for b in on_supports[: i + 1])
    gram = symmetric(exact_dots(model.comm, pairs))
    values, vectors = eigen((scale[:, None] * gram * scale)[np.ix_(kept, kept)])
    free = np.zeros((np.count_nonzero(values <= FREE * values.max(initial=0.0)), 6))
    free[:, kept] = vectors[:, values <= FREE * values.max(initial=0.0)].T
    return free * scale


def rigid_gram(model: Model, weight: np.ndarray) -> np.ndarray:
    """Products ``sum weight a b`` of the rigid modes, shape (6, 6); ``weight``, shape (n_unknowns,). Collective."""
    modes = list(rigid_modes(model))
    pairs = ((weight * a, b) for i, a in enumerate(modes) for b in modes[: i + 1])
    return symmetric(exact_dots(model.comm, pairs))


def combine(model: Model, motion: np.ndarray) -> np.ndarray:
    """A combination of the rigid modes, summed in their order, shape (n_unknowns,)."""
    result = np.zeros(model.n_unknowns)
    for amount, mode in zip(motion, rigid_modes(model), strict=True):
        if amount:
            result += amount * mode
    return result


def name_motion(motion: np.ndarray) -> str:
    """The motion by name: a rotation wherever it has a part in it, since a lever arm looks like a translation."""
    translation, rotation = np.abs(motion).reshape(2, 3)
    if rotation.max() > 1e-6 * translation.max():
        return MOTION_NAMES[3 + int(np.argmax(rotation))]
    return MOTION_NAMES[int(np.argmax(translation))]
