"""Regions whose bonds may break and that can still not part, because bonds that never do hold them together.

Bonds with an end in cells with ``may_fail = false`` never break. Where they reach the same points of a band from both
of its sides, the band hangs together by them whatever the load: its load rises without end after all other bonds broke.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from pdfem_mpi.body.near_places import NearPlaces
from pdfem_mpi.body.share import Share
from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.kernels.families import CUTOFF_GUARD
from pdfem_mpi.kernels.hex8 import gauss_positions
from pdfem_mpi.parallel.comm import largest, sum_integers
from pdfem_mpi.peridynamics.critical_stretches import UNBREAKABLE, critical_stretches, point_classes

#: Part of the cutoff radius beyond which bonds are too weak to hold a body: at 2.5 cells a bar with a band of 4 cells,
#: whose points have one bond of 0.97 to the far side, parted at its peak as one with 6 cells; one with 3 cells did not.
STRONG = 0.9
#: Cells that are looked at together, until a point far from all others is found: wide regions end after a few.
CELLS = 512
#: Points are as far from others up to this, relative.
ALIKE = 1e-6


def describe_sealed_regions(scene: Scene, share: Share) -> Iterator[str]:
    """A warning for each region that bonds beside it hold together for ever. Collective."""
    if share.found or not scene.can_fail or all(region.may_fail is not False for region in scene.regions):
        return
    width = 2.0 * share.cutoff / (1.0 + CUTOFF_GUARD) * share.units.length
    unit = f" {scene.units.length}" if scene.units.length else ""
    for index in sealed_regions(scene, share):
        yield (
            f"warning: regions.{index}, {scene.regions[index].name}, cannot part: bonds to cells with may_fail = false "
            "never break, and its points have some on both of its sides, so that peaks would be far too high. Make it "
            f"wider than twice the cutoff radius, {width:.6g}{unit}, or let the cells on one side fail."
        )


def sealed_regions(scene: Scene, share: Share) -> list[int]:
    """Regions that may fail and whose middle has strong bonds that never break, to both sides; rising. Collective."""
    breaks = np.diagonal(critical_stretches(scene, share)) < UNBREAKABLE
    free = share.is_peridynamic & ~share.is_overlap & breaks[point_classes(scene, share)]
    never = share.has_points & np.array([region.may_fail is False for region in scene.regions])[share.region]
    owned = [np.flatnonzero(free & share.is_owned & (share.region == k)) for k in range(len(scene.regions))]
    depth = np.array([_depth(share, cells, never) for cells in owned])
    deepest = largest(share.comm, depth)
    suspects = np.flatnonzero(np.isfinite(deepest))
    if not len(suspects):
        return []
    first = np.full(len(owned), -math.inf)  # the same point on any number of ranks
    for k in suspects:
        far = np.flatnonzero(_distances(share, owned[k], never) >= (1.0 - ALIKE) * deepest[k])
        first[k] = -(8.0 * share.mesh.cell_id[owned[k]][far // 8] + far % 8).min(initial=math.inf)
    chosen, wide = -largest(share.comm, first), free & np.isinf(deepest)[share.region]
    held, escapes = np.zeros((2, len(owned)), np.int64)
    for k in suspects:
        cell = owned[k][share.mesh.cell_id[owned[k]] == chosen[k] // 8]
        held[k] = any(_is_between(share, c, int(chosen[k] % 8), never) for c in cell)
        escapes[k] = np.isfinite(_distances(share, owned[k], wide)).any()  # into a wider region beside it
    held, escapes = sum_integers(share.comm, np.stack([held, escapes]))
    return np.flatnonzero((held > 0) & (escapes == 0)).tolist()


def _depth(share: Share, own: np.ndarray, never: np.ndarray) -> float:
    """The largest of `_distances`; infinity as soon as one is, minus infinity without cells."""
    near, most = _near(share, own, never), -math.inf
    for k in range(0, len(own), CELLS):
        most = max(most, float(near.distances(_points(share, own[k : k + CELLS])).max()))
        if math.isinf(most):
            break
    return most


def _distances(share: Share, own: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Of the points of some cells to the nearest of other cells', infinite where no strong bond is as long."""
    return _near(share, own, others).distances(_points(share, own))


def _is_between(share: Share, cell: int, point: int, others: np.ndarray) -> bool:
    """Whether a point has others within reach of strong bonds on the side away from the nearest."""
    way = _points(share, np.flatnonzero(others)) - _points(share, np.array([cell]))[point]
    square = (way * way).sum(axis=1)
    nearest = way[square.argmin()]
    return bool(((way * nearest).sum(axis=1) < 0.0)[square <= _reach(share) ** 2].any())


def _near(share: Share, own: np.ndarray, others: np.ndarray) -> NearPlaces:
    """The points of other cells, bool (n_cells,), that may be within reach of some cells."""
    cells, reach = share.mesh.cells, _reach(share)
    touched = np.zeros(len(share.nodes), bool)
    touched[cells[own]] = True
    around = share.nodes[touched]
    lower, upper = around.min(axis=0, initial=math.inf) - reach, around.max(axis=0, initial=-math.inf) + reach
    chosen = np.flatnonzero(others)
    corners = share.nodes[cells[chosen]]
    meets = (corners.max(axis=1) >= lower).all(axis=1) & (corners.min(axis=1) <= upper).all(axis=1)
    return NearPlaces(_points(share, chosen[meets]), reach)


def _points(share: Share, cells: np.ndarray) -> np.ndarray:
    """Places of the points of some cells; float64, shape (8 n, 3)."""
    return gauss_positions(share.nodes[share.mesh.cells[cells]]).reshape(-1, 3)


def _reach(share: Share) -> float:
    return STRONG * share.cutoff
