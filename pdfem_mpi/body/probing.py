"""What the deck's probes read: weights of displacements for each of their columns."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pdfem_mpi.body.discretization import Discretization
from pdfem_mpi.body.locating import Weights, weights_at
from pdfem_mpi.deck.outputs import DisplacementProbe, OpeningProbe
from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.deck.table import AXES, SceneError
from pdfem_mpi.parallel.comm import broadcast


def place_probes(scene: Scene, whole: Discretization) -> dict[str, Weights]:
    """Weights by the names of columns. Collective, if the mesh is a part.

    Raises
    ------
    SceneError
        Points of an opening outside of the body, or nothing between them.
    """
    found: dict[str, Weights] = {}
    messages: list[str] = []
    for index, probe in enumerate(scene.probes):
        if isinstance(probe, OpeningProbe):
            weights = _opening(whole, probe, f"probes.{index}", messages)
            found[f"{probe.name}.opening"] = weights
        elif isinstance(probe, DisplacementProbe):
            weights, _ = _weights_at(whole, np.array(probe.point))
            for d, axis in enumerate(AXES):
                found[f"{probe.name}.u_{axis}"] = weights.along([float(d == e) for e in range(3)], 1.0)
    if messages:
        raise SceneError(messages)
    return found


def _opening(whole: Discretization, probe: OpeningProbe, where: str, messages: list[str]) -> Weights:
    """The displacement of the second point less that of the first, along a vector; ``messages`` get what is wrong."""
    found, wrong = [], len(messages)
    for name in ("one", "two"):
        weights, outside = _weights_at(whole, np.array(getattr(probe, name)))
        found.append(weights)
        if outside > whole.mesh.tolerance:
            messages.append(
                f"{where}.{name} = {list(getattr(probe, name))} lies outside of the body, {outside:.3g} away from it. "
                "Give a point of its surface."
            )
    one, two = found
    if len(messages) == wrong and (len(np.intersect1d(one.cells, two.cells)) or _same_nodes(one, two)):
        messages.append(
            f"{where} measures an opening across nothing: both of its points lie in one cell. Give points on both "
            "sides of a notch or a crack."
        )
    return two.along(probe.unit, 1.0).plus(one.along(probe.unit, -1.0))


def _weights_at(body: Discretization, point: np.ndarray) -> tuple[Weights, float]:
    """As `weights_at`, by numbers in the whole mesh. Collective, if the mesh is a part.

    The rank of the cell whose middle is nearest sees the cells around it.
    """
    mesh, everywhere = body.mesh, body.mesh.everywhere
    if everywhere.own is None:
        return weights_at(body, point)
    own = np.flatnonzero(everywhere.own)
    square = ((mesh.centroids[own] - point) ** 2).sum(axis=1)
    first = int(np.argmin(square))
    nearest = everywhere.gathered([(float(square[first]), int(mesh.cell_id[own[first]]))])
    rank, found = nearest.index(min(nearest)), None
    if rank == everywhere.comm.rank:
        weights, outside = weights_at(body, point)
        found = replace(weights, nodes=mesh.node_id[weights.nodes], cells=mesh.cell_id[weights.cells]), outside
    return broadcast(everywhere.comm, found, rank)


def _same_nodes(one: Weights, two: Weights) -> bool:
    """Whether two places are interpolated from the nodes of one cell."""
    return len(one.nodes) > 0 and np.array_equal(one.nodes, two.nodes)
