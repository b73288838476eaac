"""What a body carries through a plane: the force and the moment of one side on the other.

The unknowns (points and nodes) are parted by the plane at rest. The forces within one side add up to nothing, so the
sum of all internal forces on one side is what the other side does to it: no stress is integrated, and where the body
is in equilibrium it is what supports and loads do on that side, to the residual.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pdfem_mpi.kernels.dense import lengths, product
from pdfem_mpi.model.model import Model
from pdfem_mpi.model.motions import rigid_modes
from pdfem_mpi.model.parts import positions
from pdfem_mpi.parallel.comm import sum_integers
from pdfem_mpi.parallel.sums import exact_dots
from pdfem_mpi.peridynamics.clusters import point_rows


@dataclass(frozen=True)
class Cut:
    """A plane through the body, model units.

    Attributes
    ----------
    point, normal : float64, shape (3,)
        A point of the plane, about which moments count, and the direction of the side that acts.
    """

    point: np.ndarray
    normal: np.ndarray


def sides(model: Model, cut: Cut, tolerance: float) -> np.ndarray:
    """Unknowns on the side that the normal points away from, those on the plane included; bool, shape (n_unknowns,)."""
    height = product(positions(model) - cut.point, cut.normal / lengths(cut.normal))
    return model.unknowns.join(np.repeat((height <= tolerance)[:, None], 3, axis=1))


def meets_body(model: Model, below: np.ndarray) -> bool:
    """Whether both sides have unknowns. Collective."""
    count = sum_integers(model.comm, np.array([np.count_nonzero(below), np.count_nonzero(~below)]))
    return bool((count > 0).all())


def resultant(
    model: Model, cut: Cut, below: np.ndarray, internal: np.ndarray, u: np.ndarray, near: np.ndarray
) -> np.ndarray:
    """Force and moment of the upper side on the lower one, float64, shape (6,), model units. Collective.

    Between mirror planes a component counts where one of the sides knows it: a plane takes forces normal to it, and
    moments about the axes within it, from the side that reaches it. NaN where both sides reach one.

    Parameters
    ----------
    below : bool, shape (n_unknowns,)
        From `sides`.
    internal : float64, shape (n_unknowns,), dimension force
        Internal forces on the unknowns at the displacements ``u``.
    near : bool, shape (n_points + n_nodes, 3)
        From `near_mirrors`.
    """
    moved = u if model.finite else None

    def pairs():
        for side in (below, ~below):
            force = np.where(side, internal, 0.0)
            for mode in rigid_modes(model, moved):
                yield force, mode

    results = exact_dots(model.comm, pairs()).reshape(2, 6)
    results[:, 3:] -= np.cross(cut.point, results[:, :3])  # rigid modes turn about the origin
    unknown = [_taken_by_mirrors(model, side, near) for side in (below, ~below)]
    return np.where(unknown[0], np.where(unknown[1], np.nan, -results[1]), results[0])


def near_mirrors(model: Model, cutoff: float, tolerance: float) -> np.ndarray:
    """Which unknowns feel mirror planes normal to x, y, z; bool, shape (n_points + n_nodes, 3). Collective.

    Points do as far as bonds reach, nodes on the plane itself and, in the overlap, where points of their cells do.
    """
    unknowns, x = model.unknowns, positions(model)
    near = np.zeros((len(x), 3), bool)
    near[: unknowns.n_points] = _within(model, x[: unknowns.n_points], cutoff)
    if model.nodes:
        near[unknowns.n_points :] = _within(model, x[unknowns.n_points :], tolerance)
        of_overlap = np.zeros((len(model.nodes.number), 3), np.int64)
        if model.overlap:
            cells = slice(24 * model.points.n_free, 24 * model.points.n_owned)
            felt = _within(model, point_rows(model.points.x[cells]), cutoff).reshape(-1, 8, 3).any(axis=1)
            np.add.at(of_overlap, model.overlap.connectivity.reshape(-1), np.repeat(felt, 8, axis=0))
        model.nodes.halo.scatter_reverse(of_overlap)
        near[unknowns.n_points :] |= of_overlap[: model.nodes.n_owned] > 0
    return near


def _within(model: Model, x: np.ndarray, distance: float) -> np.ndarray:
    """Places, (n, 3), that are as near to a mirror plane normal to x, y, z; bool, shape (n, 3)."""
    near = np.zeros(x.shape, bool)
    for d, planes in enumerate(model.mirrors.planes):
        for plane in planes:
            near[:, d] |= np.abs(x[:, d] - plane) <= distance
    return near


def _taken_by_mirrors(model: Model, side: np.ndarray, near: np.ndarray) -> np.ndarray:
    """Components of force and moment on a side that mirror planes take part in; bool, shape (6,). Collective."""
    inside = model.unknowns.rows(side)[:, 0]
    across = sum_integers(model.comm, np.count_nonzero(near[inside], axis=0)) > 0
    turned = [any(across[e] for e in range(3) if e != d) for d in range(3)]
    return np.concatenate([across, turned])
