"""The strain that a change of temperature gives every cell at its eight points."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from pdfem_mpi.body.discretization import Discretization
from pdfem_mpi.body.materials import materials_of
from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.deck.table import SceneError
from pdfem_mpi.kernels.hex8 import SHAPE_AT_GAUSS
from pdfem_mpi.mesh.nodal_fields import read_nodal_field
from pdfem_mpi.parallel.comm import agree, broadcast


def thermal_strains(scene: Scene, discretization: Discretization, comm) -> Callable[[np.ndarray], np.ndarray] | None:
    """What gives ``alpha dT`` at load factor 1 at the eight points of cells; None without a temperature. Collective.

    Returns
    -------
    callable
        From numbers of cells of the mesh, shape (n,), to float64, shape (n, 8).

    Raises
    ------
    SceneError
        On all ranks: a file of temperatures that does not fit.
    """
    table = scene.temperature
    if table is None:
        return None
    expansion = np.array([material.thermal_expansion or 0.0 for material in materials_of(scene).values()])
    mesh, nodal = discretization.mesh, None
    if table.file is not None:
        messages = []
        if comm.rank == 0:
            try:
                nodal = read_nodal_field(mesh, "temperature.file", table.file, table.field, table.scale)
                nodal = nodal - table.reference
            except SceneError as error:
                messages = error.messages
        if messages := agree(comm, messages):
            raise SceneError(messages)
        nodal = broadcast(comm, nodal)

    def of(cells: np.ndarray) -> np.ndarray:
        change = np.full((len(cells), 8), 0.0 if table.change is None else table.change)
        for a in range(8 if nodal is not None else 0):
            change += SHAPE_AT_GAUSS[:, a] * nodal[mesh.cells[cells, a]][:, None]
        return expansion[discretization.material[cells]][:, None] * change

    return of
