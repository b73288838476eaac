"""The cells of the mesh that a load or a support of a deck speaks of."""

from __future__ import annotations

import numpy as np

from pdfem_mpi.body.discretization import Discretization
from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.deck.table import SceneError
from pdfem_mpi.mesh import named_sets
from pdfem_mpi.mesh.layers import cells_near_face


def select_cells(discretization: Discretization, entry, where: str, scene: Scene) -> np.ndarray:
    """Cells a load or support speaks of; bool, shape (n_cells,)."""
    mesh = discretization.mesh
    if entry.region is not None:
        names = [region.name for region in scene.regions]
        chosen = discretization.region == names.index(entry.region)
    elif entry.face is not None:
        chosen = cells_near_face(mesh, entry.face, entry.layers)
    elif entry.set is not None:
        chosen = named_sets.cells_of(mesh, entry, where)
    else:
        chosen = mesh.cells_in_box(entry.lower, entry.upper)
    if not chosen.any() and entry.set is None:
        raise SceneError(
            [f"{where} selects no cell of the mesh, whose cells are {mesh.largest_edge:.6g} wide. Widen its box."]
        )
    return chosen
