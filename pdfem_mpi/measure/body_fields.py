"""Displacements and damage of the whole body on its cells, so that both descriptions are seen as one surface."""

from __future__ import annotations

import numpy as np

from pdfem_mpi.kernels.dense import product
from pdfem_mpi.kernels.hex8 import GAUSS_POINTS, REFERENCE_NODES
from pdfem_mpi.measure.fields import Fields
from pdfem_mpi.measure.geometry import Geometry

#: From values at the eight Gauss points of a cell to those of the trilinear field at its corners.
CORNERS_FROM_GAUSS = np.prod(1.0 + 3.0 * REFERENCE_NODES[:, None] * GAUSS_POINTS[None], axis=2) / 8.0


def corner_displacements(geometry: Geometry, fields: Fields) -> np.ndarray:
    """Displacements of all nodes of the mesh, float64, shape (n_mesh_nodes, 3), dimension length.

    Nodes of elements have their own. The others are corners of peridynamic cells alone: each cell extends the
    displacements of its points to its corners, and a node has the mean over its cells. Across a crack this is the mean
    of both faces, so that the cells beside it are drawn out.
    """
    mesh = geometry.mesh
    found = np.zeros((len(mesh.nodes), 3))
    if fields.u_points is not None:
        corners = mesh.cells[geometry.has_points]
        values = product(CORNERS_FROM_GAUSS, fields.u_points.reshape(-1, 8, 3).swapaxes(0, 1)).swapaxes(0, 1)
        count = np.maximum(np.bincount(corners.ravel(), minlength=len(found)), 1)
        for d in range(3):
            total = np.bincount(corners.ravel(), weights=values[:, :, d].ravel(), minlength=len(found))
            found[:, d] = total / count
    if fields.u_nodes is not None:
        found[geometry.node_row >= 0] = fields.u_nodes
    return found


def cell_damage(geometry: Geometry, damage: np.ndarray) -> np.ndarray:
    """Mean damage of the eight points of each cell, float64, shape (n_cells,); 0 where a cell has none."""
    found = np.zeros(len(geometry.mesh.cells))
    found[geometry.has_points] = damage.reshape(-1, 8).mean(axis=1)
    return found


def cell_fields(geometry: Geometry, fields: Fields) -> dict[str, np.ndarray]:
    """Other fields of points and elements, on all cells: means over the points of a cell; NaN where there are none.

    Cells of the overlap have those of their points.
    """
    found = {}
    for name in dict.fromkeys([*fields.of_points, *fields.of_cells]):
        on_points, on_cells = fields.of_points.get(name), fields.of_cells.get(name)
        width = (on_cells if on_points is None else on_points).shape[1:]
        values = np.full((len(geometry.mesh.cells), *width), np.nan)
        if on_cells is not None:
            values[geometry.has_nodes] = on_cells
        if on_points is not None:
            values[geometry.has_points] = on_points.reshape(-1, 8, *width).mean(axis=1)
        found[name] = values
    return found
