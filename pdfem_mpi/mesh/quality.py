"""How good the cells of a mesh are, and the refusal of those that no element can live on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pdfem_mpi.deck.table import SceneError
from pdfem_mpi.kernels.hex8 import gauss_volumes
from pdfem_mpi.mesh.hexmesh import HexMesh
from pdfem_mpi.parallel.comm import report_progress

#: The three neighbours of each local node (VTK order), so that a cube's are a right-handed triple.
CORNERS = np.array([(1, 3, 4), (2, 0, 5), (3, 1, 6), (0, 2, 7), (7, 5, 0), (4, 6, 1), (5, 7, 2), (6, 4, 3)])
#: Volumes of Gauss points and lengths below this fraction of the longest edge's are round-off of nothing at all.
FLAT = 1e-15
#: Cells measured together.
BATCH = 2**12
#: Bad cells that a message lists.
LISTED = 3


@dataclass(frozen=True)
class Quality:
    """Extremes over all cells of a mesh.

    Attributes
    ----------
    shortest_edge, longest_edge : float, dimension length
    smallest_scaled_jacobian : float, dimension 1
        Of all corners: the volume of the three edges there over the product of their lengths; 1 in a box.
    smallest_gauss_volume : float, dimension length^3
        Smallest weight of a Gauss point.
    """

    shortest_edge: float
    longest_edge: float
    smallest_scaled_jacobian: float
    smallest_gauss_volume: float


def measure(mesh: HexMesh, number: np.ndarray | None = None) -> Quality:
    """Measure all cells.

    Parameters
    ----------
    number : int64, shape (n_cells,), optional
        What messages call each cell; its place in the mesh, if not given.

    Raises
    ------
    SceneError
        Cells that are wound clockwise, turned inside out or flat: a Gauss volume is not positive, or an edge has no
        length. Where only a corner's Jacobian is not positive, see `folded_cells`.
    """
    shortest, longest, jacobian, volume = np.inf, 0.0, np.inf, np.inf
    bad, mirrored = [np.empty(0, np.int64)], [np.empty(0, np.int64)]
    for start in range(0, len(mesh.cells), BATCH):
        corners = mesh.nodes[mesh.cells[start : start + BATCH]]
        edges = corners[:, CORNERS] - corners[:, :, None]
        length = np.sqrt((edges**2).sum(axis=-1))
        scaled = _scaled_jacobians(edges, length)
        volumes = gauss_volumes(corners)
        clockwise = (scaled < 0.0).all(axis=1) & (volumes < 0.0).all(axis=1)
        mirrored.append(start + np.flatnonzero(clockwise))
        longest_edge = length.max(axis=(1, 2))
        flat = (volumes <= FLAT * longest_edge[:, None] ** 3).any(axis=1)
        flat |= length.min(axis=(1, 2)) <= FLAT * longest_edge
        bad.append(start + np.flatnonzero(flat & ~clockwise))
        shortest, longest = min(shortest, length.min()), max(longest, length.max())
        jacobian, volume = min(jacobian, scaled.min()), min(volume, volumes.min())
        report_progress()
    messages = []
    for cells, what, remedy in (
        (
            np.concatenate(mirrored),
            "wound clockwise (all their Jacobians are negative)",
            "Exchange the first and the last four nodes of each, or mirror the geometry before it is meshed.",
        ),
        (
            np.concatenate(bad),
            "flat or inside out (the Jacobian of a Gauss point is not positive)",
            "Use another spacing, or correct the order of their nodes.",
        ),
    ):
        if len(cells):
            places = ", ".join(
                f"{cell if number is None else number[cell]} at ({', '.join(f'{c:.6g}' for c in mesh.centroids[cell])})"
                for cell in cells[:LISTED]
            )
            messages.append(
                f"mesh has {len(cells)} of {len(mesh.cells)} cells that are {what}, the first {places}. {remedy}"
            )
    if messages:
        raise SceneError(messages)
    return Quality(float(shortest), float(longest), float(jacobian), float(volume))


def folded_cells(mesh: HexMesh) -> np.ndarray:
    """Cells with a corner whose Jacobian is not positive; int64, ascending.

    Where the Jacobians of their Gauss points are positive all the same, as `measure` demands, finite elements live on
    them: the integral knows nothing of the corner.
    """
    found = [np.empty(0, np.int64)]
    for start in range(0, len(mesh.cells), BATCH):
        corners = mesh.nodes[mesh.cells[start : start + BATCH]]
        edges = corners[:, CORNERS] - corners[:, :, None]
        scaled = _scaled_jacobians(edges, np.sqrt((edges**2).sum(axis=-1)))
        found.append(start + np.flatnonzero((scaled <= 0.0).any(axis=1)))
    return np.concatenate(found)


def _scaled_jacobians(edges: np.ndarray, length: np.ndarray) -> np.ndarray:
    """Volume of the three edges at each corner over the product of their lengths, (n, 8); 0 where an edge has none."""
    triple = (np.cross(edges[:, :, 0], edges[:, :, 1]) * edges[:, :, 2]).sum(axis=-1)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.nan_to_num(triple / length.prod(axis=-1), nan=0.0)
