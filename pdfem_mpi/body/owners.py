"""Which rank of a run would have each cell, for a picture of it."""

from __future__ import annotations

import numpy as np

from pdfem_mpi.body.discretization import discretize
from pdfem_mpi.body.found_region import Turning, turn
from pdfem_mpi.body.partitioning import partition
from pdfem_mpi.deck.scene import Scene


def owners_of_cells(scene: Scene, ranks: int, turned: np.ndarray | None = None) -> np.ndarray:
    """Ranks of all cells in the order of the mesh, as a run on so many would have them; int32, shape (n_cells,).

    Parameters
    ----------
    turned : int64, optional
        Cells that are turned into bonds, where the run finds them.
    """
    whole = discretize(scene)
    if turned is not None:
        whole = turn(scene, whole, Turning(turned, np.empty(0, np.int64))).whole
    return partition(whole, ranks)
