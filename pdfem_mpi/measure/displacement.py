"""The displacement at any place of the body, by the functions of the cells that hold it."""

from __future__ import annotations

import numpy as np

from pdfem_mpi.kernels.hex8 import GAUSS_POINTS, shape_functions, shape_gradients
from pdfem_mpi.measure.fields import Fields
from pdfem_mpi.measure.geometry import Geometry

#: Newton's method inside a hexahedron converges in a handful of steps; this ends it where the place is far outside.
NEWTON_STEPS = 50


def displacement_at(geometry: Geometry, fields: Fields, point) -> np.ndarray:
    """Displacement at a point of the body, by the shape functions of its cell.

    In a cell with elements or overlap the nodes are interpolated, in a peridynamic cell the trilinear function
    through its eight points; where peridynamic cells meet, their mean. Outside the body the nearest of its points is
    taken. On a mirror plane the mean includes the mirror image: nothing moves out of it.

    Returns
    -------
    float64, shape (3,), dimension length
    """
    point = np.asarray(point, float)
    return interpolate(geometry, fields, locate(geometry, point)[0], point)


def locate(geometry: Geometry, point: np.ndarray) -> tuple[dict[int, np.ndarray], float]:
    """Cells that hold a point, or come closest to it.

    Returns
    -------
    holders : dict from cell to float64, shape (3,)
        Reference coordinates in the first such cell with nodes; without any, in all such peridynamic cells.
    outside : float, dimension length
        Distance of the point from them; 0 inside, up to round-off.
    """
    mesh = geometry.mesh
    cell = int(np.argmin(((mesh.centroids - point) ** 2).sum(axis=1)))
    near = np.flatnonzero(mesh.neighbours(np.arange(len(mesh.cells)) == cell))
    corners = mesh.nodes[mesh.cells[near]]
    local = _reference_coordinates(corners, point)
    nearest = (shape_functions(np.clip(local, -1.0, 1.0))[:, :, None] * corners).sum(axis=1)
    beyond = np.linalg.norm(nearest - point, axis=1)
    outside = float(beyond.min())
    chosen = np.flatnonzero(beyond <= outside + mesh.tolerance)
    chosen = [k for k in chosen if geometry.has_nodes[near[k]]][:1] or chosen
    return {int(near[k]): local[k] for k in chosen}, outside


def interpolate(geometry: Geometry, fields: Fields, holders: dict[int, np.ndarray], point) -> np.ndarray:
    """Mean over the holders of their own interpolation, and their mirror images', at the nearest of their points."""
    total = np.zeros(3)
    for cell, coordinates in holders.items():
        rst = np.clip(coordinates, -1.0, 1.0)
        if geometry.has_nodes[cell]:
            values = fields.u_nodes[geometry.node_row[geometry.mesh.cells[cell]]]
            shape = shape_functions(rst[None])[0]
        else:
            values = fields.u_points.reshape(-1, 8, 3)[geometry.point_row[cell]]
            shape = np.prod((1.0 + 9.0 * (rst / 3.0) * GAUSS_POINTS) / 2.0, axis=1)
        total += (shape[:, None] * values).sum(axis=0)
    units, mesh = geometry.units, geometry.mesh
    place = (np.clip(point, mesh.lower, mesh.upper)[None] - units.origin) / units.length
    total[geometry.mirrors.normal_components(place, mesh.tolerance / units.length)[0]] = 0.0
    return total / len(holders)


def _reference_coordinates(corners: np.ndarray, point: np.ndarray) -> np.ndarray:
    """Solve ``x(r, s, t) = point`` by Newton's method in each cell; shapes (n, 8, 3) and (3,) to (n, 3)."""
    rst = np.zeros((len(corners), 3))
    for _ in range(NEWTON_STEPS):
        miss = point - (shape_functions(rst)[:, :, None] * corners).sum(axis=1)
        jacobian = (corners[:, :, :, None] * shape_gradients(rst)[:, :, None, :]).sum(axis=1)
        step = np.linalg.solve(jacobian, miss[:, :, None])[:, :, 0]
        rst = np.clip(rst + step, -3.0, 3.0)
        if np.abs(step).max() < 1e-13:
            break
    return rst
