"""Where a place of the body is: the cells that hold it, and the weights by which its displacement is interpolated."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

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


class Holder(NamedTuple):
    """A cell that holds a point, or comes closest to it.

    Attributes
    ----------
    outside : float, dimension length
        Distance of the point from the cell; 0 inside, up to round-off.
    cell : int
        Number in the whole mesh.
    coordinates : float64, shape (3,), dimension 1
        Reference coordinates of the point, wherever they lead to outside.
    nodes : int64, shape (8,), or None
        Numbers in the whole mesh of the nodes that carry the displacement; None: the eight points do.
    """

    outside: float
    cell: int
    coordinates: np.ndarray
    nodes: np.ndarray | None


def weights_at(body: Any, point: np.ndarray) -> tuple[Weights, float]:
    """Weights of the displacement at a point, each component by itself, and the point's distance from the body.

    They are those of `measure.displacement`: shape functions of nodes, or the trilinear function through eight points;
    where cells with points meet their mean, and on mirror planes nothing of what is normal to them. Collective, if the
    mesh is a part.

    Parameters
    ----------
    body
        With ``mesh`` in the deck's units, ``has_nodes``, ``units`` and ``mirrors``.
    point : float64, shape (3,), dimension length
    """
    holders, outside = locate(body, point)
    mesh, units = body.mesh, body.units
    place = (np.clip(point, mesh.lower, mesh.upper)[None] - units.origin) / units.length
    free = ~body.mirrors.normal_components(place, mesh.tolerance / units.length)[0]
    share = free / len(holders)
    nodes, of_nodes, cells, of_points = [], [], [], []
    for holder in holders:
        weight = interpolation(holder)[:, None] * share
        if holder.nodes is not None:
            nodes.append(holder.nodes)
            of_nodes.append(weight)
        else:
            cells.append(holder.cell)
            of_points.append(weight)
    return Weights(
        np.concatenate(nodes) if nodes else np.empty(0, np.int64),
        np.concatenate(of_nodes) if nodes else np.empty((0, 3)),
        np.array(cells, np.int64),
        np.array(of_points).reshape(-1, 8, 3),
    ), outside


def interpolation(holder: Holder) -> np.ndarray:
    """Weights of the eight nodes, or else of the eight points, of a cell at a point; shape (8,)."""
    rst = np.clip(holder.coordinates, -1.0, 1.0)
    if holder.nodes is not None:
        return shape_functions(rst[None])[0]
    return np.prod((1.0 + 9.0 * (rst / 3.0) * GAUSS_POINTS) / 2.0, axis=1)


def locate(body: Any, point: np.ndarray) -> tuple[list[Holder], float]:
    """Cells that hold a point, or come closest to it. Collective, if the mesh is a part.

    The cells around that of the nearest middle come first: where this one holds the point, others that do share a node
    with it. Beside small cells, or where cells are long and oblique, another may hold it; then all are looked at whose
    boxes come as close as the closest found.

    Parameters
    ----------
    body
        With ``mesh`` in the deck's units and ``has_nodes``.
    point : float64, shape (3,), dimension length

    Returns
    -------
    holders : list of Holder
        The first such cell with nodes; without any, all such peridynamic cells.
    outside : float, dimension length
        Distance of the point from them; 0 inside, up to round-off.
    """
    mesh = body.mesh
    everywhere, tolerance = mesh.everywhere, mesh.tolerance
    square, place = mesh.boxes.nearest(point)
    nearest = min(everywhere.gathered([(square, int(mesh.cell_id[place]))]))[1]
    mine = mesh.cell_id[place] == nearest and everywhere.of_own(np.array([place]))[0]
    found = everywhere.gathered(_look_at(body, mesh.boxes.around(place), point) if mine else [])
    if not any(holder.cell == nearest and holder.outside <= tolerance for holder in found):
        close = mesh.boxes.within(point, point, max(_least(found), tolerance))
        close = close[everywhere.of_own(close) & ~np.isin(mesh.cell_id[close], [holder.cell for holder in found])]
        found += sorted(everywhere.gathered(_look_at(body, close, point, apart=True)), key=lambda holder: holder.cell)
    outside = _least(found)
    found = [holder for holder in found if holder.outside <= outside + tolerance]
    return [holder for holder in found if holder.nodes is not None][:1] or found, outside


def _least(found: list[Holder]) -> float:
    return min(holder.outside for holder in found)


def _look_at(body: Any, cells: np.ndarray, point: np.ndarray, apart: bool = False) -> list[Holder]:
    """How far a point is from some cells, places in the mesh; ``apart`` as of `_reference_coordinates`."""
    if not len(cells):
        return []
    mesh = body.mesh
    corners = mesh.nodes[mesh.cells[cells]]
    local = _reference_coordinates(corners, point, apart)
    nearest = (shape_functions(np.clip(local, -1.0, 1.0))[:, :, None] * corners).sum(axis=1)
    outside = np.nan_to_num(lengths(nearest - point), nan=np.inf).tolist()
    nodes = [mesh.node_id[mesh.cells[cell]] if body.has_nodes[cell] else None for cell in cells]
    return list(map(Holder, outside, mesh.cell_id[cells].tolist(), local, nodes))


def _reference_coordinates(corners: np.ndarray, point: np.ndarray, apart: bool) -> np.ndarray:
    """Solve ``x(r, s, t) = point`` by Newton's method in each cell; shapes (n, 8, 3) and (3,) to (n, 3).

    All cells go on until the last has come to its end, or, ``apart``, each until its own: then the same bits in
    whatever company it is.
    """
    rst, at_rest = np.zeros((len(corners), 3)), np.zeros(len(corners), bool)
    for _ in range(NEWTON_STEPS):
        miss = point - (shape_functions(rst)[:, :, None] * corners).sum(axis=1)
        jacobian = (corners[:, :, :, None] * shape_gradients(rst)[:, :, None, :]).sum(axis=1)
        step = solve(jacobian, miss[:, :, None])[:, :, 0]
        if apart:
            step[at_rest] = 0.0
        rst = np.clip(rst + step, -3.0, 3.0)
        at_rest = np.abs(step).max(axis=1) < 1e-13
        if at_rest.all():
            break
    return rst
