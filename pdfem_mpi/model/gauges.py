"""Numbers that are linear in the displacements, such as an opening: the same bits on any number of ranks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pdfem_mpi.body.locating import Weights
from pdfem_mpi.body.share import Share
from pdfem_mpi.kernels.hex8 import SHAPE_AT_GAUSS, gauss_volumes
from pdfem_mpi.model.model import Model
from pdfem_mpi.parallel.sums import exact_dots
from pdfem_mpi.peridynamics.clusters import cluster_layout


@dataclass(frozen=True)
class Gauge:
    """A sum of weighted unknowns.

    Attributes
    ----------
    index : int64, shape (n,)
        Unknowns of this rank.
    weight : float64, shape (n,)
    """

    index: np.ndarray
    weight: np.ndarray

    def read(self, comm, u: np.ndarray) -> float:
        """The sum over all ranks, rounded once. Collective."""
        return float(exact_dots(comm, [(u[self.index], self.weight)])[0])


def gauge_of(share: Share, model: Model, weights: Weights) -> Gauge:
    """This rank's part of a sum over nodes and points."""
    total, unknowns, subdomain = np.zeros(model.n_unknowns), model.unknowns, share.subdomain
    if model.points:
        rows = np.zeros((len(subdomain.free), 8, 3))
        here, place = _places(share.mesh.cell_id[subdomain.free], weights.cells)
        np.add.at(rows, place, weights.of_points[here])
        unknowns.of_points(total)[:] = cluster_layout(rows)
    if model.nodes:
        here, place = _places(share.mesh.node_id[subdomain.owned_nodes], weights.nodes)
        np.add.at(unknowns.of_nodes(total), place, weights.of_nodes[here])
    index = np.flatnonzero(total)
    return Gauge(index, total[index])


def means_over(share: Share, model: Model, cells: np.ndarray) -> tuple[Gauge, Gauge, Gauge]:
    """Means of the displacements along x, y and z over the volume of chosen cells. Collective.

    Parameters
    ----------
    cells : int64
        Cells of the share, rising.
    """
    mesh, unknowns, subdomain = share.mesh, model.unknowns, share.subdomain
    volumes = gauss_volumes(share.nodes[mesh.cells[cells]])
    (whole,) = share.exact_sums([volumes[share.is_owned[cells]].reshape(-1)]).tolist()
    on_nodes, on_points = np.zeros(len(share.nodes)), np.zeros((len(mesh.cells), 8))
    by_nodes = share.has_nodes[cells]
    for p in range(8):
        terms = volumes[by_nodes, p, None] * SHAPE_AT_GAUSS[p] / whole
        np.add.at(on_nodes, mesh.cells[cells[by_nodes]], terms)
    on_points[cells[~by_nodes]] = volumes[~by_nodes] / whole
    total = np.zeros(unknowns.size)
    if model.points:
        unknowns.of_points(total)[:] = cluster_layout(np.repeat(on_points[subdomain.free][:, :, None], 3, axis=2))
    if model.nodes:
        unknowns.of_nodes(total)[:] = on_nodes[subdomain.owned_nodes, None]
    along = unknowns.components()
    places = [np.flatnonzero((along == d) & (total != 0.0)) for d in range(3)]
    return tuple(Gauge(place, total[place]) for place in places)


def _places(own: np.ndarray, wanted: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Which of the wanted numbers are among one's own, bool, and where these stand."""
    order = np.argsort(own, kind="stable")
    place = np.minimum(np.searchsorted(own, wanted, sorter=order), max(len(own) - 1, 0))
    here = own[order[place]] == wanted if len(own) else np.zeros(len(wanted), bool)
    return here, order[place[here]] if len(own) else np.empty(0, np.int64)
