"""What the deck's probes read: weights of displacements for each of their columns."""

from __future__ import annotations

import numpy as np

from pdfem_mpi.body.discretization import Discretization
from pdfem_mpi.body.locating import Weights, weights_at
from pdfem_mpi.deck.mechanical_probes import PointProbe
from pdfem_mpi.deck.outputs import DisplacementProbe, OpeningProbe
from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.deck.table import AXES, SceneError, Vector

#: Displacements may be asked for so far outside of the body, in mean edges, and are read at its nearest place: straight
#: edges lie less below curved surfaces.
CHORD = 0.25


def place_probes(scene: Scene, whole: Discretization) -> dict[str, Weights]:
    """Weights by the names of columns. Collective, if the mesh is a part.

    Raises
    ------
    SceneError
        Points outside of the body, or an opening with nothing between its points.
    """
    found: dict[str, Weights] = {}
    messages: list[str] = []
    for index, probe in enumerate(scene.probes):
        if isinstance(probe, OpeningProbe):
            weights = _opening(whole, probe, f"probes.{index}", messages)
            found[f"{probe.name}.opening"] = weights
        elif isinstance(probe, DisplacementProbe | PointProbe):
            moves, remedy = isinstance(probe, DisplacementProbe), "inside of it or on its surface"
            allowed = CHORD * whole.mesh.mean_edge if moves else 0.0
            weights = _weights(whole, probe.point, f"probes.{index}.point", remedy, messages, allowed)
            for d, axis in enumerate(AXES if moves else ()):
                found[f"{probe.name}.u_{axis}"] = weights.along([float(d == e) for e in range(3)], 1.0)
    if messages:
        raise SceneError(messages)
    return found


def _opening(whole: Discretization, probe: OpeningProbe, where: str, messages: list[str]) -> Weights:
    """The displacement of the second point less that of the first, along a vector; ``messages`` get what is wrong."""
    wrong = len(messages)
    one, two = (
        _weights(whole, getattr(probe, name), f"{where}.{name}", "of its surface", messages) for name in ("one", "two")
    )
    if len(messages) == wrong and (len(np.intersect1d(one.cells, two.cells)) or _same_nodes(one, two)):
        messages.append(
            f"{where} measures an opening across nothing: both of its points lie in one cell. Give points on both "
            "sides of a notch or a crack."
        )
    return two.along(probe.unit, 1.0).plus(one.along(probe.unit, -1.0))


def _weights(
    whole: Discretization, point: Vector, where: str, remedy: str, messages: list[str], allowed: float = 0.0
) -> Weights:
    """Weights at a point; ``messages`` get it if it lies farther outside of the body than is allowed.

    Collective, if the mesh is a part.
    """
    weights, outside = weights_at(whole, np.array(point))
    if outside > max(whole.mesh.tolerance, allowed):
        text = f"{where} = {list(point)} lies outside of the body, {outside:.3g} away from it."
        messages.append(f"{text} Give a point {remedy}.")
    return weights


def _same_nodes(one: Weights, two: Weights) -> bool:
    """Whether two places are interpolated from the nodes of one cell."""
    return len(one.nodes) > 0 and np.array_equal(one.nodes, two.nodes)
