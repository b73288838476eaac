"""The strain that a change of temperature gives every cell at its eight points."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from pdfem_mpi.body.materials import materials_of
from pdfem_mpi.body.share import Share
from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.deck.table import SceneError, show
from pdfem_mpi.deck.temperatures import Temperature
from pdfem_mpi.kernels.hex8 import SHAPE_AT_GAUSS, gauss_positions
from pdfem_mpi.mesh.nodal_fields import read_nodal_field
from pdfem_mpi.model.formula_values import evaluate
from pdfem_mpi.parallel.comm import agree, sum_integers
from pdfem_mpi.parallel.slabs import gather_rows, scatter_slabs


def thermal_strains(scene: Scene, share: Share) -> Callable[[np.ndarray], np.ndarray] | None:
    """What gives ``alpha dT`` at load factor 1 at the eight points of cells; None without a temperature. Collective.

    Returns
    -------
    callable
        From places of cells in the share, shape (n,), to float64, shape (n, 8).

    Raises
    ------
    SceneError
        On all ranks: a file of temperatures that does not fit.
    """
    table = scene.temperature
    if table is None:
        return None
    expansion = np.array([material.thermal_expansion or 0.0 for material in materials_of(scene).values()])
    nodal = _nodal_changes(table, share) if table.file is not None else None

    def of(cells: np.ndarray) -> np.ndarray:
        corners = share.mesh.cells[cells]
        change = np.full((len(cells), 8), table.change or 0.0)
        if table.formula is not None:
            x, y, z = np.moveaxis(gauss_positions(share.mesh.nodes[corners]), -1, 0)
            change += evaluate(table.formula, {"x": x, "y": y, "z": z})
        for a in range(8 if nodal is not None else 0):
            change += SHAPE_AT_GAUSS[:, a] * nodal[corners[:, a]][:, None]
        return expansion[share.material[cells]][:, None] * change

    if table.formula is not None:
        _refuse_infinite(table.formula, of(np.flatnonzero(share.is_owned)), share)
    return of


def _refuse_infinite(formula: str, strains: np.ndarray, share: Share) -> None:
    """A formula must have a value everywhere. Collective."""
    count = int(sum_integers(share.comm, np.array([np.count_nonzero(~np.isfinite(strains))]))[0])
    if count:
        raise SceneError(
            [f"temperature.formula = {show(formula)} is not finite at {count} points. Change it, or leave them out."]
        )


def _nodal_changes(table: Temperature, share: Share) -> np.ndarray:
    """Changes of temperature at the nodes of the share, float64, shape (n_nodes,). Collective."""
    comm, mesh, n_nodes = share.comm, share.mesh, share.counts.mesh_nodes
    own = share.with_elements_everywhere().subdomain.owned_nodes
    nodes = gather_rows(comm, mesh.node_id[own], mesh.nodes[own], n_nodes)
    messages, values = [], None
    if comm.rank == 0:
        try:
            values = read_nodal_field(nodes, mesh.tolerance, "temperature.file", table.file, table.field, table.scale)
        except SceneError as error:
            messages = error.messages
    if messages := agree(comm, messages):
        raise SceneError(messages)
    read = lambda first, last: values[first:last] - table.reference  # noqa: E731
    return scatter_slabs(comm, mesh.node_id, n_nodes, read, np.empty(0))
