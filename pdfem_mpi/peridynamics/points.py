"""The collocation points of a rank, cell by cell, and the table that kernels sum over bonds in."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from pdfem_mpi.body.share import Share
from pdfem_mpi.kernels.hex8 import gauss_positions, gauss_volumes
from pdfem_mpi.kernels.simd import W
from pdfem_mpi.parallel.halo import Halo, build_halo
from pdfem_mpi.peridynamics.clusters import cluster_layout
from pdfem_mpi.peridynamics.images import Images, MirroredHalo

if TYPE_CHECKING:
    from pdfem_mpi.peridynamics.gaps import Gaps


@dataclass(frozen=True)
class Depths:
    """How far cells lie from those of another rank.

    Attributes
    ----------
    neighbour : int64, shape (n_cells,)
        Of ghosts which of the neighbours owns them, by number; else -1, also for images.
    depth : float64, shape (n_cells, n_neighbours), dimension length
        Of owned cells from ghosts of each neighbour; of ghosts, in the column of their owner, from this rank's cells.
    """

    neighbour: np.ndarray
    depth: np.ndarray


@dataclass(frozen=True)
class Points:
    """Collocation points of the local cells: owned free cells, owned overlap cells, ghosts, mirror images.

    Attributes
    ----------
    n_free, n_owned : int
        Numbers of owned cells with free points, and of all owned cells with points.
    cell_number : int64, shape (n_cells,)
        Number of each local cell in the mesh; point ids are ``8 number + g``. An image has the number of its cell.
    material : int16, shape (n_cells,)
        Material of each local cell.
    x : float64, shape (n_cells * 24,), dimension length
        Positions in cluster layout ``[cluster][component][lane]``, two clusters a cell.
    volume : float64, shape (n_cells * 8,), dimension length^3
        Integration weights ``w``.
    halo : Halo or MirroredHalo
        Exchange of blocks of one cell whose rows are components of vectors (`images.halo_for` for others).
    images : Images or None
        None without mirror planes.
    n_numbers : int
        Cells of the whole mesh; needed with images.
    body : int32, shape (n_cells,), or None
        Body of each local cell, where there are several: no bonds between them.
    gaps : Gaps or None
        The surface of the body near the points, while bonds are made: none crosses it.
    depths : Depths or None
        Where cells lie towards other ranks, while bonds are made.
    """

    n_free: int
    n_owned: int
    cell_number: np.ndarray
    material: np.ndarray
    x: np.ndarray
    volume: np.ndarray
    halo: Halo | MirroredHalo
    images: Images | None = None
    n_numbers: int = 0
    body: np.ndarray | None = None
    gaps: Gaps | None = None
    depths: Depths | None = None

    @property
    def cell_key(self) -> np.ndarray:
        """What tells a cell and its images apart on all ranks: its number, which rises with each image; int64."""
        key = self.cell_number.copy()
        if self.images:
            key[len(key) - len(self.images.reflection) :] += self.n_numbers * self.images.reflection
        return key

    @property
    def n_clusters(self) -> int:
        """Local clusters, ghosts included."""
        return 2 * len(self.cell_number)


def sums_table(points: Points) -> tuple[np.ndarray, np.ndarray]:
    """A table with the positions in rows 3-5, for kernels that sum over bonds, and its flat view as integers."""
    T = np.zeros((points.n_clusters, 9, W))
    T[:, 3:6] = points.x.reshape(-1, 3, W)
    return T, T.view(np.int64).reshape(-1)


def make_points(share: Share, comm, weighted: bool = True) -> Points:
    """The points that a rank sees; where nothing is integrated, their weights may be left 0. Collective."""
    subdomain = share.subdomain
    owned = np.concatenate([subdomain.free, subdomain.overlap])
    cells = np.concatenate([owned, subdomain.ghosts])
    corners = share.nodes[share.mesh.cells[cells]]
    number = share.mesh.cell_id
    x, volume = gauss_positions(corners), gauss_volumes(corners) if weighted else np.zeros((len(cells), 8))
    halo = build_halo(comm, number[owned], number[subdomain.ghosts], subdomain.ghost_owner)
    images = None
    if share.mirrors:
        local = np.full(len(number), -1)
        local[cells] = np.arange(len(cells))
        sign, shift = (rows[subdomain.reflection - 1] for rows in share.reflections)
        images = Images(local[subdomain.images], subdomain.reflection, sign, shift)
        halo = MirroredHalo(halo, images)
        x = np.concatenate([x, images.sign[:, None] * x[images.source] + images.shift[:, None]])
        volume = np.concatenate([volume, volume[images.source]])
        cells = np.concatenate([cells, subdomain.images])
    return Points(
        n_free=len(subdomain.free),
        n_owned=len(owned),
        cell_number=number[cells],
        material=share.material[cells],
        x=cluster_layout(x),
        volume=volume.reshape(-1),
        halo=halo,
        images=images,
        n_numbers=share.counts.cells,
        body=share.body[cells] if share.counts.bodies > 1 else None,
    )
