"""Numbers that are linear in the displacements, such as an opening: the same bits on any number of ranks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pdfem_mpi.body.discretization import Discretization
from pdfem_mpi.body.locating import Weights, weights_at
from pdfem_mpi.deck.outputs import OpeningProbe
from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.deck.table import SceneError
from pdfem_mpi.model.model import Model
from pdfem_mpi.parallel.sums import exact_dots
from pdfem_mpi.peridynamics.clusters import cluster_layout

#: Two points of an opening in one cell, or nearer to each other than this part of a cell's edge, have nothing between.
APART = 1e-6


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


def gauge_of(discretization: Discretization, model: Model, weights: Weights) -> Gauge:
    """This rank's part of a sum over nodes and points."""
    total, unknowns, subdomain = np.zeros(model.n_unknowns), model.unknowns, model.subdomain
    if model.points:
        rows = np.zeros((len(subdomain.free), 8, 3))
        here, place = _places(subdomain.free, weights.cells)
        np.add.at(rows, place, weights.of_points[here])
        unknowns.of_points(total)[:] = cluster_layout(rows)
    if model.nodes:
        here, place = _places(subdomain.owned_nodes, weights.nodes)
        np.add.at(unknowns.of_nodes(total), place, weights.of_nodes[here])
    index = np.flatnonzero(total)
    return Gauge(index, total[index])


def _places(own: np.ndarray, wanted: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Which of the wanted numbers are among one's own, bool, and where these stand."""
    order = np.argsort(own, kind="stable")
    place = np.minimum(np.searchsorted(own, wanted, sorter=order), max(len(own) - 1, 0))
    here = own[order[place]] == wanted if len(own) else np.zeros(len(wanted), bool)
    return here, order[place[here]] if len(own) else np.empty(0, np.int64)


def opening_of(scene: Scene, discretization: Discretization, name: str) -> Weights:
    """Weights of the opening of a probe: the displacement of its second point less that of its first, along a vector.

    Raises
    ------
    SceneError
        Points outside of the body, or nothing between them.
    """
    index, probe = next((k, p) for k, p in enumerate(scene.probes) if isinstance(p, OpeningProbe) and p.name == name)
    messages, found = [], []
    for key in ("one", "two"):
        weights, outside = weights_at(discretization, np.array(getattr(probe, key)))
        found.append(weights)
        if outside > discretization.mesh.tolerance:
            messages.append(
                f"probes.{index}.{key} = {list(getattr(probe, key))} lies outside of the body, {outside:.3g} away from "
                "it. Give a point of its surface."
            )
    if not messages and len(np.intersect1d(found[0].cells, found[1].cells)) + _common_cell(*found):
        messages.append(
            f"probes.{index} measures an opening across nothing: both of its points lie in one cell. Give points on "
            "both sides of a notch or a crack."
        )
    if messages:
        raise SceneError(messages)
    return found[1].along(probe.unit, 1.0).plus(found[0].along(probe.unit, -1.0))


def _common_cell(one: Weights, two: Weights) -> bool:
    """Whether two places are interpolated from the nodes of one cell."""
    return len(one.nodes) > 0 and np.array_equal(one.nodes, two.nodes)
