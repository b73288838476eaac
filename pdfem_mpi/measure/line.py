"""Displacements along a straight line."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pdfem_mpi.body.locating import locate
from pdfem_mpi.deck.outputs import LineProbe
from pdfem_mpi.kernels.dense import lengths
from pdfem_mpi.measure.displacement import interpolate
from pdfem_mpi.measure.fields import Fields
from pdfem_mpi.measure.geometry import Geometry


@dataclass(frozen=True)
class Line:
    """Displacements along a straight line.

    Attributes
    ----------
    distance : float64, shape (n,), dimension length
        From the start.
    position : float64, shape (n, 3), dimension length
    displacement : float64, shape (n, 3), dimension length
        NaN outside of the body.
    kind : str, shape (n,)
        "finite elements" (also in their overlap), "peridynamics", or "" outside of the body.
    """

    distance: np.ndarray
    position: np.ndarray
    displacement: np.ndarray
    kind: np.ndarray


def measure_line(geometry: Geometry, fields: Fields, probe: LineProbe) -> Line:
    """Sample the displacement along a line."""
    distance, position = positions_along(probe)
    displacement, kind = np.full((probe.n, 3), np.nan), np.full(probe.n, "", object)
    for k, point in enumerate(position):
        holders, outside = locate(geometry, point)
        if outside <= geometry.mesh.tolerance:
            displacement[k] = interpolate(geometry, fields, holders, point)
            bonds = geometry.is_peridynamic[holders[0].cell]
            kind[k] = "peridynamics" if bonds else "finite elements"
    return Line(distance, position, displacement, kind.astype(str))


def positions_along(probe: LineProbe) -> tuple[np.ndarray, np.ndarray]:
    """Distances from the start, shape (n,), and positions, shape (n, 3), of a line's samples."""
    start, stop = np.array(probe.start), np.array(probe.stop)
    t = np.arange(probe.n) / (probe.n - 1)
    position = start + t[:, None] * (stop - start)
    position[-1] = stop
    return t * float(lengths(stop - start)), position
