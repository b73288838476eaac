"""Where a place of the body is: the cells that hold it, and the weights by which its displacement is interpolated."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from pdfem_mpi.kernels.dense import lengths, solve
from pdfem_mpi.kernels.hex8 import GAUSS_POINTS, shape_functions, shape_gradients

#: Newton's method inside a hexahedron converges in a handful of steps; this ends it where the place is far outside.
NEWTON_STEPS = 50


@dataclass(frozen=True)
class Weights:
    """A sum over displacements of nodes and of points.

    Attributes
    ----------
    nodes : int64, shape (n_nodes,)
        Numbers in the mesh.
    of_nodes : float64, shape (n_nodes, 3)
    cells : int64, shape (n_cells,)
        Cells with free points.
    of_points : float64, shape (n_cells, 8, 3)
    """

    nodes: np.ndarray
    of_nodes: np.ndarray
    cells: np.ndarray
    of_points: np.ndarray

    def along(self, direction, factor: float) -> Weights:
        """The same, each component times that of a direction and a factor."""
        times = factor * np.array(direction)
        return Weights(self.nodes, self.of_nodes * times, self.cells, self.of_points * times)

    def plus(self, other: Weights) -> Weights:
        """The sum of both."""
        pairs = ((getattr(self, name), getattr(other, name)) for name in ("nodes", "of_nodes", "cells", "of_points"))
        return Weights(*(np.concatenate(pair) for pair in pairs))


def weights_at(body: Any, point: np.ndarray) -> tuple[Weights, float]:
    """Weights of the displacement at a point, each component by itself, and the point's distance from the body.

    They are those of `measure.displacement`: shape functions of nodes, or the trilinear function through eight points;
    where cells with points meet their mean, and on mirror planes nothing of what is normal to them.

    Parameters
    ----------
    body
        With ``mesh`` in the deck's units, ``has_nodes``, ``units`` and ``mirrors``: the whole of it.
    point : float64, shape (3,), dimension length
    """
    holders, outside = locate(body, point)
    mesh, units = body.mesh, body.units
    place = (np.clip(point, mesh.lower, mesh.upper)[None] - units.origin) / units.length
    free = ~body.mirrors.normal_components(place, mesh.tolerance / units.length)[0]
    share = free / len(holders)
    nodes, of_nodes, cells, of_points = [], [], [], []
    for cell, coordinates in holders.items():
        weight = interpolation(body.has_nodes[cell], coordinates)[:, None] * share
        if body.has_nodes[cell]:
            nodes.append(mesh.cells[cell].astype(np.int64))
            of_nodes.append(weight)
        else:
            cells.append(cell)
            of_points.append(weight)
    return Weights(
        np.concatenate(nodes) if nodes else np.empty(0, np.int64),
        np.concatenate(of_nodes) if nodes else np.empty((0, 3)),
        np.array(cells, np.int64),
        np.array(of_points).reshape(-1, 8, 3),
    ), outside


def interpolation(by_nodes: bool, coordinates: np.ndarray) -> np.ndarray:
    """Weights of the eight nodes, or else of the eight points, of a cell at reference coordinates; shape (8,)."""
    rst = np.clip(coordinates, -1.0, 1.0)
    if by_nodes:
        return shape_functions(rst[None])[0]
    return np.prod((1.0 + 9.0 * (rst / 3.0) * GAUSS_POINTS) / 2.0, axis=1)


def locate(body: Any, point: np.ndarray) -> tuple[dict[int, np.ndarray], float]:
    """Cells that hold a point, or come closest to it.

    Parameters
    ----------
    body
        With ``mesh`` in the deck's units and ``has_nodes``.

    Returns
    -------
    holders : dict from cell to float64, shape (3,)
        Reference coordinates in the first such cell with nodes; without any, in all such peridynamic cells.
    outside : float, dimension length
        Distance of the point from them; 0 inside, up to round-off.
    """
    mesh = body.mesh
    cell = int(np.argmin(((mesh.centroids - point) ** 2).sum(axis=1)))
    near = np.flatnonzero(mesh.neighbours(np.arange(len(mesh.cells)) == cell))
    corners = mesh.nodes[mesh.cells[near]]
    local = _reference_coordinates(corners, point)
    nearest = (shape_functions(np.clip(local, -1.0, 1.0))[:, :, None] * corners).sum(axis=1)
    beyond = lengths(nearest - point)
    outside = float(beyond.min())
    chosen = np.flatnonzero(beyond <= outside + mesh.tolerance)
    chosen = [k for k in chosen if body.has_nodes[near[k]]][:1] or chosen
    return {int(near[k]): local[k] for k in chosen}, outside


def _reference_coordinates(corners: np.ndarray, point: np.ndarray) -> np.ndarray:
    """Solve ``x(r, s, t) = point`` by Newton's method in each cell; shapes (n, 8, 3) and (3,) to (n, 3)."""
    rst = np.zeros((len(corners), 3))
    for _ in range(NEWTON_STEPS):
        miss = point - (shape_functions(rst)[:, :, None] * corners).sum(axis=1)
        jacobian = (corners[:, :, :, None] * shape_gradients(rst)[:, :, None, :]).sum(axis=1)
        step = solve(jacobian, miss[:, :, None])[:, :, 0]
        rst = np.clip(rst + step, -3.0, 3.0)
        if np.abs(step).max() < 1e-13:
            break
    return rst
