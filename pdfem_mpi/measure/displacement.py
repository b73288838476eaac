"""The displacement at any place of the body, by the functions of the cells that hold it."""

from __future__ import annotations

import numpy as np

from pdfem_mpi.body.locating import Holder, interpolation, locate
from pdfem_mpi.measure.fields import Fields
from pdfem_mpi.measure.geometry import Geometry


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


def interpolate(geometry: Geometry, fields: Fields, holders: list[Holder], point) -> np.ndarray:
    """Mean over the holders of their own interpolation, and their mirror images', at the nearest of their points."""
    total = np.zeros(3)
    for holder in holders:
        shape = interpolation(holder)
        if holder.nodes is not None:
            values = fields.u_nodes[geometry.node_row[holder.nodes]]
        else:
            values = fields.u_points.reshape(-1, 8, 3)[geometry.point_row[holder.cell]]
        total += (shape[:, None] * values).sum(axis=0)
    units, mesh = geometry.units, geometry.mesh
    place = (np.clip(point, mesh.lower, mesh.upper)[None] - units.origin) / units.length
    total[geometry.mirrors.normal_components(place, mesh.tolerance / units.length)[0]] = 0.0
    return total / len(holders)
