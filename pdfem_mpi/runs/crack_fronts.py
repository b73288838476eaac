"""How long the cells are that a crack's front would cross: by less of a step than that no whole layer of bonds is cut.

A longer crack cuts more bonds only where it passes points. These stand twice in a cell, at unlike distances, so that
the new area and the bonds in it agree for steps of whole cells alone.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from pdfem_mpi.body.share import Share
from pdfem_mpi.deck.mechanical_probes import EnergyReleaseProbe
from pdfem_mpi.deck.peridynamics import polygon_normal
from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.mesh.hexmesh import EDGES
from pdfem_mpi.parallel.comm import largest

#: Lengths are equal up to this, relative.
EQUAL = 1e-6


def default_extension(scene: Scene, share: Share, probe: EnergyReleaseProbe) -> float:
    """By how much a crack is made longer whose probe does not say, dimension length, the deck's. Collective.

    The extent along the direction of growth of the cells at the front; the edge, where all edges of the mesh are equal.
    """
    mesh = share.mesh
    longest, _, _ = _lengths_at_front(scene, share, probe)
    edges_differ = mesh.largest_edge - mesh.smallest_edge > EQUAL * mesh.mean_edge
    return longest if edges_differ and longest > 0.0 else mesh.mean_edge


def doubtful_extensions(scene: Scene, share: Share) -> Iterator[str]:
    """Warnings about extensions that are no whole number of cells. Collective."""
    for index, probe in enumerate(scene.probes):
        if not isinstance(probe, EnergyReleaseProbe) or probe.extension is None:
            continue
        longest, edge, shortest = _lengths_at_front(scene, share, probe)
        if not longest > 0.0:
            continue
        unit = f" {scene.units.length}" if scene.units.length else ""
        where = f"warning: probes.{index}.extension = {probe.extension:.6g}{unit}"
        cells = probe.extension / edge
        along_edges = max(longest - edge, edge - shortest) <= EQUAL * edge
        if cells < 1.0 - EQUAL:
            yield (
                f"{where} is less than a cell at the front is long in that direction, {edge:.6g}{unit}: the longer "
                "crack cuts no whole layer of bonds more, and the rate may be far too small or 0. Use "
                f"{edge:.6g}{unit}, or leave the key out."
            )
        elif along_edges and abs(cells - round(cells)) > EQUAL * cells:
            yield (
                f"{where} is {cells:.4g} cells at the front, which are {edge:.6g}{unit} long in that direction: the "
                f"longer crack cuts another number of layers of bonds, and the rate is off. Use {edge:.6g}{unit} or a "
                "multiple of it, or leave the key out."
            )


def _lengths_at_front(scene: Scene, share: Share, probe: EnergyReleaseProbe) -> tuple[float, float, float]:
    """Of the cells with bonds that the front would enter, along its direction; the deck's units. Collective.

    Returns
    -------
    longest : float
        Extent of a cell; minus infinity where the front is not in such cells.
    edge, shortest : float
        Of the edge of each cell that goes farthest along the direction, the longest and the shortest.
    """
    corners = np.array(scene.cracks[probe.crack].polygon)
    way = np.array(probe.direction) / math.hypot(*probe.direction)
    normal = np.array(polygon_normal(scene.cracks[probe.crack].polygon)[0])
    mesh = share.mesh
    cells, size = mesh.cells[share.has_points], mesh.tolerance
    along, off = ((mesh.nodes * axis).sum(axis=1)[cells] for axis in (way, normal))
    front, plane = (corners * way).sum(axis=1).max(), (corners[0] * normal).sum()
    enters = (along.min(axis=1) <= front + size) & (along.max(axis=1) > front + size)
    enters &= (off.min(axis=1) <= plane + size) & (off.max(axis=1) >= plane - size)
    along = along[enters]
    edges = np.stack([np.abs(along[:, a] - along[:, b]) for a, b in EDGES]).max(axis=0)
    extent = along.max(axis=1) - along.min(axis=1)
    found = [values.max(initial=-math.inf) for values in (extent, edges, -edges)]
    longest, edge, shortest = largest(share.comm, np.array(found)).tolist()
    return longest, edge, -shortest
