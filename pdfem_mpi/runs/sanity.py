"""Sentences about what is allowed, and yet may not be meant: units, limits, strains, supports that break loose."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from pdfem_mpi.body.materials import materials_of
from pdfem_mpi.body.share import Share
from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.kernels.dense import lengths
from pdfem_mpi.model.forces import Forces
from pdfem_mpi.parallel.comm import largest, sum_integers
from pdfem_mpi.peridynamics.clusters import point_rows
from pdfem_mpi.runs.crack_fronts import doubtful_extensions
from pdfem_mpi.runs.failure_notes import Criterion
from pdfem_mpi.runs.sealed_regions import describe_sealed_regions
from pdfem_mpi.runs.simulation import Simulation

#: Pascals in one unit of stress, for the units of force and length that are known.
PASCALS = {
    ("N", "m"): 1.0, ("kN", "m"): 1e3, ("MN", "m"): 1e6, ("N", "mm"): 1e6, ("kN", "mm"): 1e9, ("N", "cm"): 1e4,
    ("lbf", "in"): 6894.757, ("lb", "in"): 6894.757, ("kip", "in"): 6894757.0, ("lbf", "ft"): 47.88026,
}  # fmt: skip
#: Young's moduli between rubber's and a little above diamond's, in pascals.
SOFTEST, STIFFEST = 1e6, 1.2e12
#: Critical stretches beyond these are told.
LEAST_STRETCH, MOST_STRETCH = 1e-6, 0.1
#: Changes of displacement over distance from which on linear kinematics is told.
LINEAR = 0.02
#: Load factors of the first break that are far from 1.
EARLY, LATE = 0.01, 100.0
#: Pairs of the points of a cell that are neighbours along its edges.
_PAIRS = np.array([(0, 1), (2, 3), (4, 5), (6, 7), (0, 2), (1, 3), (4, 6), (5, 7), (0, 4), (1, 5), (2, 6), (3, 7)])


def doubts(scene: Scene, share: Share, limits: dict[str, Criterion]) -> Iterator[str]:
    """What may not be meant, before anything is solved. Collective."""
    yield from doubtful_moduli(scene)
    yield from doubtful_limits(scene, limits)
    yield from supports_that_may_break_loose(scene, share)
    yield from describe_sealed_regions(scene, share)
    yield from doubtful_extensions(scene, share)


def doubtful_moduli(scene: Scene) -> Iterator[str]:
    """Young's moduli that no solid has, in the deck's units."""
    force, length = scene.units.force, scene.units.length
    pascals = PASCALS.get((force, length))
    if pascals is None:
        return
    for name, material in materials_of(scene).items():
        modulus = material.youngs_modulus * pascals
        if not SOFTEST <= modulus <= STIFFEST:
            where = "material" if name == "default" else f"materials.{name}"
            side = "below that of rubber" if modulus < SOFTEST else "above that of diamond"
            yield (
                f"warning: {where}.youngs_modulus = {material.youngs_modulus:.6g} {force}/{length}^2 is {modulus:.3g} "
                f"Pa, {side}. Check the units: steel has {2.1e11 / pascals:.4g} {force}/{length}^2."
            )


def doubtful_limits(scene: Scene, limits: dict[str, Criterion]) -> Iterator[str]:
    """Critical stretches that no solid has, and those too large for linear kinematics."""
    for name, criterion in limits.items():
        stretch, given = criterion.critical_stretch, materials_of(scene)[name].critical_stretch is not None
        where = ("material" if name == "default" else f"materials.{name}") + (
            ".critical_stretch" if given else ".fracture_energy"
        )
        if not LEAST_STRETCH <= stretch <= MOST_STRETCH:
            side = "few solids stretch as far" if stretch > MOST_STRETCH else "rounding is not far below"
            yield (
                f"warning: {where} lets bonds break at a stretch of {100.0 * stretch:.3g} %: {side}. Check its value "
                "and its units (a stretch has none: 0.01 is 1 %)."
            )
        elif stretch > LINEAR and scene.kinematics == "linear":
            yield (
                f"warning: {where} lets bonds stretch by {100.0 * stretch:.3g} %, and peridynamics.kinematics = "
                f'"linear" is for strains below {100.0 * LINEAR:g} %. Use "finite".'
            )


def supports_that_may_break_loose(scene: Scene, share: Share) -> Iterator[str]:
    """Supports and loads on cells whose bonds may break. Collective."""
    if not scene.can_fail:
        return
    breaking = np.array([region.model == "peridynamics" and region.may_fail is not False for region in scene.regions])
    breaks = breaking[share.region] & ~share.has_nodes
    found = []
    for table in ("supports", "loads"):
        for index, entry in enumerate(getattr(scene, table)):
            if getattr(entry, "kind", "body_force") != "body_force":
                continue
            chosen = getattr(share.selections, table)[index]
            here = 0 if chosen is None else np.count_nonzero(breaks[chosen.cells])
            if sum_integers(share.comm, np.array([here]))[0]:
                found.append(f"{table}.{index}")
    if found:
        shown = ", ".join(found[:5]) + (", ..." if len(found) > 5 else "")
        yield (
            f"note: {shown} {'act' if len(found) > 1 else 'acts'} on cells whose bonds may break, and may tear them "
            "off. Put a region with may_fail = false there, a cutoff radius wider than what is held."
        )


def look_back(simulation: Simulation, first_break: float | None) -> Iterator[str]:
    """What may not be meant, after the last step. Collective.

    Parameters
    ----------
    first_break : float or None
        Load factor; None where nothing broke.
    """
    yield from describe_first_break(first_break)
    if first_break is None:
        body = simulation.share
        edge = body.quality.shortest_edge / body.units.length
        yield from describe_small_strains(simulation.scene, simulation.forces, edge)


def describe_first_break(load_factor: float | None) -> Iterator[str]:
    """A first break at a load far from that of the deck."""
    if load_factor is not None and not EARLY <= abs(load_factor) <= LATE:
        yield (
            f"note: the first bond broke at load factor {load_factor:.3g}, far from 1: loads, units or the limit of "
            "the material may be others than were meant."
        )


def describe_small_strains(scene: Scene, forces: Forces, shortest_edge: float) -> Iterator[str]:
    """Strains too large for linear kinematics, at the last evaluation. Collective.

    Parameters
    ----------
    shortest_edge : float
        Of the cells, model units.
    """
    if scene.kinematics != "linear":
        return
    gradient = largest_gradient(forces, shortest_edge)
    if gradient > LINEAR:
        yield (
            f"warning: neighbouring places move apart by up to {100.0 * gradient:.3g} % of their distance, and linear "
            f'kinematics is for strains and turns below {100.0 * LINEAR:g} %. Use peridynamics.kinematics = "finite".'
        )


def largest_gradient(forces: Forces, shortest_edge: float) -> float:
    """Largest change of displacement over distance within a cell, about. Collective."""
    model, found = forces.model, 0.0
    if model.points:
        u = forces.point_displacements().reshape(-1, 8, 3)
        x = point_rows(model.points.x).reshape(-1, 8, 3)[: len(u)]
        for a, b in _PAIRS:
            moved, apart = (lengths(table[:, b] - table[:, a]) for table in (u, x))
            found = max(found, float((moved / apart).max(initial=0.0)))
    if model.elements:
        found = max(found, float(forces.met[1]) / shortest_edge)
    return float(largest(model.comm, np.array([found]))[0])
