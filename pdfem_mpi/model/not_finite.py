"""Displacements and forces that are not finite, and the point or node where they are."""

from __future__ import annotations

import numpy as np

from pdfem_mpi.model.bounds import LARGEST
from pdfem_mpi.model.model import Model
from pdfem_mpi.parallel.comm import agree
from pdfem_mpi.peridynamics.clusters import point_rows


class NotFinite(Exception):
    """A displacement or a force is not finite; the sentence names its point or node. Raised on all ranks alike."""


def describe_not_finite(model: Model, u: np.ndarray, force: np.ndarray) -> str:
    """A sentence that names the first point or node whose displacement, or else force, is not finite. Collective.

    Parameters
    ----------
    u, force : float64, shape (n_unknowns,)
        Displacements, and the residual force on them.
    """
    for what, values in (("displacement", u), ("force", force)):
        if places := agree(model.comm, _places_not_finite(model, values)):
            return f"the {what} of {places[0]} is not finite."
    return "a sum over the unknowns is not finite."


def _places_not_finite(model: Model, values: np.ndarray) -> list[str]:
    """This rank's first point and first node with such a value."""
    places = []

    def first_of(rows):
        return np.flatnonzero(~(np.abs(rows) < LARGEST).all(axis=1))[:1]

    if model.points:
        x, cell = point_rows(model.points.x), model.points.cell_number
        of_points = point_rows(model.unknowns.of_points(values))
        places += [("point", 8 * cell[i // 8] + i % 8, x[i]) for i in first_of(of_points)]
    if model.nodes:
        number, x = model.nodes.number, model.nodes.x
        places += [("node", number[i], x[i]) for i in first_of(model.unknowns.of_nodes(values))]
    units = model.units
    return [
        f"{kind} {number} at ({', '.join(f'{c:.6g}' for c in x * units.length + units.origin)})"
        for kind, number, x in places
    ]
