"""How large loads are: the resultant of those forces that push one way."""

from __future__ import annotations

import math

import numpy as np

from pdfem_mpi.kernels.hex8 import SHAPE_AT_GAUSS
from pdfem_mpi.model.model import Model
from pdfem_mpi.parallel.sums import exact_dots


def one_way(model: Model, external: np.ndarray) -> float:
    """Resultant of the forces along the axes, or of those against them: the larger. Collective.

    A traction pulls at the points beneath a face by more than it is, and pushes at those behind them. Such cells are
    taken by their corners: what their points have by linear extrapolation is what the corners of the face have.
    """
    sides = [_on_corners(model, external, d) for d in range(3)]
    ways = (np.maximum(sign * forces, 0.0) for forces in sides for sign in (1.0, -1.0))
    sums = exact_dots(model.comm, ((way, np.ones_like(way)) for way in ways)).reshape(3, 2).T
    return max(math.sqrt(x * x + y * y + z * z) for x, y, z in sums.tolist())


def _on_corners(model: Model, external: np.ndarray, d: int) -> np.ndarray:
    """The forces along an axis, where a cell's points have both signs at its corners."""
    forces = model.unknowns.along(external, d)
    of_cells = forces[: model.unknowns.n_points].reshape(-1, 8)
    both = (of_cells.min(axis=1) < 0.0) & (of_cells.max(axis=1) > 0.0)
    corners = np.zeros((np.count_nonzero(both), 8))
    for p in range(8):
        corners += of_cells[both, p, None] * SHAPE_AT_GAUSS[p]
    of_cells[both] = corners
    return forces
