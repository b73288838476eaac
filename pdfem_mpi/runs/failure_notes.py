"""What a run says of the failure it is about to follow: the numbers of its criterion, and what makes them mislead.

The strength, the fracture energy and the internal length of a material hang together, and bodies of few cells have
another fracture energy than the bulk; ``summary.json`` has them all, and the sentences are about those that a deck
leaves to its cells.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from pdfem_mpi.body.lattice_planes import bond_sizes
from pdfem_mpi.body.materials import materials_of
from pdfem_mpi.body.near_places import NearPlaces
from pdfem_mpi.body.share import Share
from pdfem_mpi.body.softening import laws_of_materials
from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.kernels.families import CUTOFF_GUARD
from pdfem_mpi.kernels.hex8 import gauss_positions
from pdfem_mpi.model.model import Model
from pdfem_mpi.parallel.comm import sum_integers
from pdfem_mpi.peridynamics.critical_stretches import UNBREAKABLE, critical_stretches, lets_overlap_fail, point_classes
from pdfem_mpi.peridynamics.failure import Failure
from pdfem_mpi.runs.softening_notes import (
    Softening,
    cells_that_differ,
    describe_softening,
    near_elements,
    softening_of,
    softening_warnings,
)

#: Depth of an overlap, in internal lengths, below which bonds into it stretch noticeably further than others: 0.9 times
#: as far at depth 1, 1.3 at 2/3, 2.0 at 1/2, 3.9 at 1/3 (docs/failure.md).
SHALLOW = 1.0 - 1e-9


@dataclass(frozen=True)
class Criterion:
    """When the bonds of one material break, in the deck's units.

    Attributes
    ----------
    critical_stretch : float, dimension 1
    strength : float, dimension force / length^2
        Young's modulus times the critical stretch: at this stress bonds along it break in a bar.
    fracture_energy_bulk : float, dimension force / length
        Of all bonds that a plane inside a body without ends cuts, without surface correction.
    fracture_energy_own_bonds : tuple of three floats or None, dimension force / length
        Of those that planes normal to x, y and z cut in this body before cracks, mean over the planes' places, with
        the bulk's share of the dilatation beside them; None where no cell of the material may fail.
    softening : Softening or None
        Where bonds soften from ``critical_stretch`` on.
    """

    critical_stretch: float
    strength: float
    fracture_energy_bulk: float
    fracture_energy_own_bonds: tuple[float, float, float] | None
    softening: Softening | None = None


def criteria(scene: Scene, share: Share, model: Model) -> dict[str, Criterion]:
    """The criterion of each material that can fail, by name; empty where no bond can."""
    if model.own_energy is None:
        return {}
    units = share.units
    laws, softening = laws_of_materials(scene, *bond_sizes(scene, share)), softening_of(scene, share)
    found = {}
    for name, own in zip(materials_of(scene), model.own_energy, strict=True):
        law = laws.get(name)
        if law is None:
            continue
        square = law.first**2 if law.shape is None else law.teeth.energy
        whole = law.energy / law.energy_of_bonds
        energies = own * square * whole * units.stress * units.length
        found[name] = Criterion(
            critical_stretch=float(law.first),
            strength=float(law.strength),
            fracture_energy_bulk=law.energy,
            fracture_energy_own_bonds=None if np.isnan(energies).any() else tuple(energies.tolist()),
            softening=softening.get(name),
        )
    return found


def failure_summary(
    scene: Scene, share: Share, failure: Failure | None, found: dict[str, Criterion]
) -> dict[str, Any] | None:
    """What ``summary.json`` says of the criterion; None where no bond can break."""
    if failure is None:
        return None
    length, cutoff = share.units.length, share.cutoff / (1.0 + CUTOFF_GUARD)
    return {
        "internal_length": length,
        "internal_length_given": scene.peridynamics.internal_length is not None,
        "cutoff_radius": cutoff * length,
        "materials": {name: asdict(criterion) for name, criterion in found.items()},
    }


def describe_criterion(
    scene: Scene, share: Share, failure: Failure | None, found: dict[str, Criterion]
) -> Iterator[str]:
    """Sentences about what a user should know before bonds break. Collective."""
    if failure is None:
        return
    if failure.nearest:
        yield (
            'note: bonds that may break have peridynamics.surface_correction = "fitted", with which bodies carried '
            'some 15 % more than with "virial" and some 20 % more than finer ones (docs/failure.md). Use '
            '"virial" for peaks.'
        )
    if scene.peridynamics.internal_length is None:
        yield from _lengths(scene, share.units.length, found)
    yield from _overlap_that_fails(scene, share)
    softening = {name: criterion.softening for name, criterion in found.items() if criterion.softening}
    if not softening:
        yield from _shallow_overlap(scene, share)
        return
    for name, text in describe_softening(scene, softening):
        own = found[next(iter(softening))] if len(softening) == 1 else None
        yield f"{name}: {text}{_own(scene, own)}"
    if share.counts.overlap_cells and _reaches_into_overlap(scene, share):
        yield near_elements(share)
    yield from cells_that_differ(share)
    yield from softening_warnings(scene, softening)


def _lengths(scene: Scene, length: float, found: dict[str, Criterion]) -> Iterator[str]:
    """The length follows the cells: one sentence for each material."""
    for name, criterion in found.items():
        if criterion.fracture_energy_own_bonds is None:
            continue
        if criterion.softening:  # strength and energy hold at any length
            continue
        given = materials_of(scene)[name].critical_stretch is not None
        force, unit = scene.units.force, scene.units.length
        per_length = f" {force}/{unit}" if force and unit else ""
        per_area = f" {force}/{unit}^2" if force and unit else ""
        own = ", ".join(f"{energy:.4g}" for energy in criterion.fracture_energy_own_bonds)
        of = f" of {name}" if len(found) > 1 else ""
        changes = "G_c" if given else "strength E s_0"
        yield (
            f"note: peridynamics.internal_length is not given and follows the cells, l = {length:.6g}"
            f"{f' {unit}' if unit else ''}, so that finer cells change the {changes}{of}; here E s_0 = "
            f"{criterion.strength:.4g}{per_area}, G_c = {criterion.fracture_energy_bulk:.4g}{per_length} in the bulk, "
            f"and planes across x, y, z cut bonds of {own}{per_length} in this body: give peridynamics.internal_length "
            f"= {length:.6g} to keep the material."
        )


def _overlap_that_fails(scene: Scene, share: Share) -> Iterator[str]:
    """Decks that let bonds break where no crack can open."""
    for index, region in enumerate(scene.regions):
        if lets_overlap_fail(region) and index in share.overlap_regions:
            yield (
                f"warning: regions.{index}.may_fail = true lets bonds between two points of the overlap break, in "
                f"{region.name}. Both follow element nodes, so that no crack opens there, and they may be the first "
                "to break at a load far too low. Leave the key out."
            )


def _shallow_overlap(scene: Scene, share: Share) -> Iterator[str]:
    """Bonds from free points into an overlap shallower than the internal length, if any may break."""
    if not share.counts.overlap_cells:
        return
    edge = share.average_edge(np.ones_like(share.has_points)) / share.units.length
    depth = scene.coupling.overlap * edge
    if depth >= SHALLOW or not _reaches_into_overlap(scene, share):
        return
    unit = share.units.length
    yield (
        f"note: bonds may break that reach into the overlap, which is {depth * unit:.4g} deep and shallower than the "
        f"internal length {unit:.6g}: they stretch further than others, twice as far in an overlap half as deep. Use "
        f"coupling.overlap = {math.ceil(SHALLOW / edge)}, or a band of peridynamics with may_fail = false as wide as "
        "the cutoff radius beside the elements."
    )


def _own(scene: Scene, criterion: Criterion | None) -> str:
    """The fracture energy of the bulk, and of the bonds that planes cut in this body."""
    if criterion is None or criterion.fracture_energy_own_bonds is None:
        return ""
    unit = f" {scene.units.force}/{scene.units.length}" if scene.units.force and scene.units.length else ""
    own = ", ".join(f"{energy:.4g}" for energy in criterion.fracture_energy_own_bonds)
    return f"; G_c = {criterion.fracture_energy_bulk:.4g}{unit} in the bulk, and planes across x, y, z cut {own} here"


def _reaches_into_overlap(scene: Scene, share: Share) -> bool:
    """Whether a bond that may break joins a free point to one of the overlap. Collective."""
    return bool(sum_integers(share.comm, np.array([_reaches_here(scene, share)]))[0])


def _reaches_here(scene: Scene, share: Share) -> bool:
    """The same of the overlap cells of this rank."""
    classes, stretch = point_classes(scene, share), critical_stretches(scene, share)
    follows = share.is_overlap & share.is_owned
    corners = share.nodes[share.mesh.cells]
    for theirs in np.unique(classes[follows]):
        open_to = np.flatnonzero(stretch[theirs] < UNBREAKABLE)
        free = np.isin(classes, open_to) & share.has_points & ~share.is_overlap
        if not free.any():
            continue
        near = NearPlaces(gauss_positions(corners[free]).reshape(-1, 3), share.cutoff)
        points = gauss_positions(corners[follows & (classes == theirs)]).reshape(-1, 3)
        if near.counts(points).any():
            return True
    return False
