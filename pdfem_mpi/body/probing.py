"""What the deck's probes read: weights of displacements for each of their columns."""

from __future__ import annotations

import numpy as np

from pdfem_mpi.body.discretization import Discretization
from pdfem_mpi.body.locating import Weights, weights_at
from pdfem_mpi.deck.outputs import DisplacementProbe, OpeningProbe
from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.deck.table import AXES, SceneError


def place_probes(scene: Scene, whole: Discretization) -> dict[str, Weights]:
    """Weights by the names of columns.

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
            weights, _ = weights_at(whole, np.array(probe.point))
            for d, axis in enumerate(AXES):
                found[f"{probe.name}.u_{axis}"] = weights.along([float(d == e) for e in range(3)], 1.0)
    if messages:
        raise SceneError(messages)
    return found


def _opening(whole: Discretization, probe: OpeningProbe, where: str, messages: list[str]) -> Weights:
    """The displacement of the second point less that of the first, along a vector; ``messages`` get what is wrong."""
    found, wrong = [], len(messages)
    for name in ("one", "two"):
        weights, outside = weights_at(whole, np.array(getattr(probe, name)))
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


def _same_nodes(one: Weights, two: Weights) -> bool:
    """Whether two places are interpolated from the nodes of one cell."""
    return len(one.nodes) > 0 and np.array_equal(one.nodes, two.nodes)
