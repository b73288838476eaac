"""What is said of bonds that soften before they do: the numbers of their laws, and what makes these mislead."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from pdfem_mpi.body.lattice_planes import bond_sizes
from pdfem_mpi.body.materials import materials_of
from pdfem_mpi.body.share import Share
from pdfem_mpi.body.softening import laws_of_materials
from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.kernels.families import CUTOFF_GUARD

#: A process zone of fewer cells is not resolved.
FEW_CELLS = 3.0
#: Beyond this ratio of stretches a body whose bonds do not drop hardens by more than a third, and damages diffusely.
DIFFUSE = 5.0
#: Of the edges of cells that soften, largest over smallest, and of those of one cell: the energy of planes moves by 6 %
#: from cells of one internal length to those 1.3 times as long.
SPREAD, ASPECT = 1.3, 1.5


@dataclass(frozen=True)
class Softening:
    """How the bonds of one material soften, in the deck's units.

    Attributes
    ----------
    first_stretch, final_stretch : float, dimension 1
        ``s_t`` and ``s_c``.
    teeth : int
        Limits that a bond passes until it is gone.
    drop : float, dimension 1
        Force after the first limit, over that before it.
    kink : two floats or None, dimension 1
        Stretch over the final one, and force over that at the first limit.
    energy_of_planes : float, dimension 1
        Fracture energy of planes of the lattice over that of the bulk: what the forces of the branch make up for, with
        the final stretch, which does so alone without a drop.
    longest_internal_length : float, dimension length
        ``l_max``, beyond which the bonds would be brittle.
    process_zone : float, dimension length
        ``E G_c / f_t^2``; a ligament that is shorter has no longer one.
    process_zone_cells : float, dimension 1
        The same over the mean edge of the cells.
    """

    first_stretch: float
    final_stretch: float
    teeth: int
    drop: float
    kink: tuple[float, float] | None
    energy_of_planes: float
    longest_internal_length: float
    process_zone: float
    process_zone_cells: float


def softening_of(scene: Scene, share: Share) -> dict[str, Softening]:
    """The softening of each material that has one, by name; empty where bonds are brittle."""
    if not scene.softens or not share.cutoff:
        return {}
    laws = laws_of_materials(scene, *bond_sizes(scene, share))
    edge, found = share.average_edge(np.ones_like(share.has_points)), {}
    for name, law in laws.items():
        if law.shape is None:
            continue
        modulus = materials_of(scene)[name].youngs_modulus
        zone = modulus * law.energy / law.strength**2
        found[name] = Softening(
            law.first, law.final, len(law.teeth.limit), law.shape.drop, law.shape.kink, law.planes, law.longest, zone,
            zone / edge,
        )  # fmt: skip
    return found


def describe_softening(scene: Scene, found: dict[str, Softening]) -> Iterator[tuple[str, str]]:
    """Names and numbers of each law, as `pdfem check` prints them."""
    unit = f" {scene.units.length}" if scene.units.length else ""
    for name, law in found.items():
        drop = "" if law.drop == 1.0 else f", with a drop to {law.drop:.3g} of the force"
        kink = "" if law.kink is None else f" and a kink at {law.kink[0]:.3g} s_c to {law.kink[1]:.3g} of it"
        yield (
            "bonds soften" + (f", {name}" if len(found) > 1 else ""),
            f"from s_t = {law.first_stretch:.4g} to s_c = {law.final_stretch:.4g} (R = "
            f"{law.final_stretch / law.first_stretch:.4g}) in {law.teeth} teeth{drop}{kink}, by which planes of this "
            f"lattice have G_c in the mean ({law.energy_of_planes:.3g} of it without{_by_stretch(law)}); internal "
            "length up to "
            f"{law.longest_internal_length:.4g}{unit}; process zone {law.process_zone:.4g}{unit}, "
            f"{law.process_zone_cells:.3g} cells, or the ligament",
        )


def _by_stretch(law: Softening) -> str:
    """That forces stay as they are, where there is no drop."""
    return "; R alone makes up for it, and forces are those of the line" if law.drop == 1.0 else ""


def cells_that_differ(share: Share) -> Iterator[str]:
    """A note where what planes take is that of one kind of cells only."""
    cells, length = share.softening_cells, share.units.length
    if cells is None or (cells.spread <= SPREAD and cells.aspect <= ASPECT):
        return
    yield (
        f"note: cells whose bonds may soften differ (the largest edge is {cells.spread:.3g} times the smallest; a cell "
        f"is up to {cells.aspect:.3g} times as long as wide): the energy of planes that the law makes up for is that "
        f"of cubes of the median edge, {cells.edge * length:.4g}. Use cubes of one size where bonds may soften, and "
        "may_fail = false in regions elsewhere."
    )


def softening_warnings(scene: Scene, found: dict[str, Softening]) -> Iterator[str]:
    """Sentences about what makes a law mislead, and defaults that the user did not give."""
    for name, law in found.items():
        of = f" of {name}" if len(found) > 1 else ""
        if law.process_zone_cells < FEW_CELLS:
            yield (
                f"warning: the process zone{of} is {law.process_zone_cells:.2g} cells long, and below {FEW_CELLS:g} it "
                "is not resolved: strength and energy are then those of the lattice. Use finer cells."
            )
        ratio = law.final_stretch / law.first_stretch
        if law.drop == 1.0 and ratio > DIFFUSE:
            yield (
                f'warning: softening = "line"{of} with R = {ratio:.3g} above {DIFFUSE:g} lets the body harden after '
                'its first bonds soften, and damages it diffusely. Use softening = "drop".'
            )
    if not found:
        return
    settings = scene.peridynamics
    if settings.stiffness_noise:
        yield (
            f"note: bonds that soften have peridynamics.stiffness_noise = {settings.stiffness_noise:g} (seed "
            f"{settings.seed}), without which an exactly symmetric body softens on both sides of its plane alike."
        )


def near_elements(share: Share) -> str:
    """A warning that bonds may soften which reach into the overlap."""
    reach = share.cutoff / (1.0 + CUTOFF_GUARD) * share.units.length
    return (
        "warning: bonds may soften within a cutoff radius of finite elements, where they stretch further than others, "
        "and the body is then too weak. Give the peridynamic cells beside the elements a region with may_fail = false, "
        f"{reach:.4g} wide."
    )
