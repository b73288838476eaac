"""Body forces of cells, as forces on nodes and on the points of free cells."""

from __future__ import annotations

import numpy as np

from pdfem_mpi.body.share import Share
from pdfem_mpi.deck.loads import BodyForce
from pdfem_mpi.kernels.hex8 import SHAPE_AT_GAUSS, gauss_volumes
from pdfem_mpi.kernels.simd import W
from pdfem_mpi.model.model import Model
from pdfem_mpi.peridynamics.clusters import cluster_layout

#: Cells whose volumes are told together: takes 2 kB each.
BATCH = 2**13


def density(share: Share, load: BodyForce, cells: np.ndarray) -> np.ndarray:
    """Body force per volume on the chosen cells, (3,), model units. Collective."""
    units = share.units
    if load.density is not None:
        return units.numbers(np.array(load.density) * (units.length / units.stress))
    volumes = gauss_volumes(share.nodes[share.mesh.cells[cells[share.is_owned[cells]]]])
    return units.numbers(np.array(load.total) / units.force / share.exact_sums([volumes])[0])


def lump_on_nodes(share: Share, on_cells: np.ndarray, on_nodes: np.ndarray) -> None:
    """Add the body force of elements and overlap cells to their nodes (26)."""
    cells = np.flatnonzero(share.has_nodes & (on_cells != 0).any(axis=1))
    corners, volumes = share.mesh.cells[cells], np.empty((len(cells), 8))
    for start in range(0, len(cells), BATCH):
        some = slice(start, start + BATCH)
        volumes[some] = gauss_volumes(share.nodes[corners[some]])
    for a in range(8):
        part = np.zeros(len(cells))
        for p in range(8):
            part += SHAPE_AT_GAUSS[p, a] * volumes[:, p]
        np.add.at(on_nodes, corners[:, a], part[:, None] * on_cells[cells])


def point_forces(share: Share, model: Model, on_cells: np.ndarray) -> np.ndarray:
    """Body force times volume of the free points, flat in cluster layout."""
    if not model.points or not on_cells.any():
        return np.zeros(3 * model.unknowns.n_points)
    density = _pick_points(share, model, on_cells)
    return density * np.repeat(model.points.volume[: model.unknowns.n_points].reshape(-1, 1, W), 3, axis=1).reshape(-1)


def _pick_points(share: Share, model: Model, on_cells: np.ndarray) -> np.ndarray:
    """Values of the free cells, repeated for their points, flat in cluster layout."""
    if not model.points:
        return np.empty(0)
    return cluster_layout(np.repeat(on_cells[share.subdomain.free][:, None, :], 8, axis=1))
