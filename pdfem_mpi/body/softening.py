"""How the bonds of a scene soften: the numbers of each material's law in this body, and what has none."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np

from pdfem_mpi.body.materials import bond_materials, bond_stretches, materials_of
from pdfem_mpi.body.softening_law import Shape, Teeth, brittle, make_teeth, strength_factor
from pdfem_mpi.body.traction_opening import curve_energy, dilatation_energy, fit_curve
from pdfem_mpi.deck.materials import Material
from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.deck.softening import DROP
from pdfem_mpi.deck.table import SceneError

#: Of the stretches of a bond's points, one to the next, where the deck does not say.
TOOTH_RATIO = 1.25
#: A final stretch this near to the first leaves no branch to follow.
LEAST_RATIO = 1.0 + 1e-9
#: Strengths of a body are sampled in strains a hundredth apart.
LEAST_HARDENING = 0.012
#: Digits to which a ratio is rounded that is found by iteration, so that the last bits of a processor do not decide.
DIGITS = 12
#: Where a body hardens: rounds in which the first stretch is found that gives it the strength, and how near they come.
ROUNDS, NEAR = 30, 1e-4


@dataclass(frozen=True)
class BondLaw:
    """How the bonds of a material end, in the deck's units.

    Attributes
    ----------
    first : float, dimension 1
        Stretch at which they soften, or break where they are brittle.
    final : float, dimension 1
        Stretch at which they are gone.
    teeth : Teeth
    energy : float, dimension force / length
        The fracture energy of the bulk.
    energy_of_bonds : float, dimension force / length
        Of it, that of the bonds; the rest is that of the dilatation beside them, 0 at a Poisson's ratio of 1/4.
    shape : Shape or None
        Of the branch, with what the lattice makes of the deck's; None where they are brittle.
    longest : float, dimension length
        The internal length beyond which they would be brittle; infinity where they are.
    strength : float, dimension force / length^2
        Of the body.
    planes : float, dimension 1
        Energy of planes of the lattice, over that of the bulk, that the branch makes up for; 1 where they are brittle.
    """

    first: float
    final: float
    teeth: Teeth
    energy: float
    energy_of_bonds: float
    shape: Shape | None
    longest: float
    strength: float
    planes: float = 1.0


def law_of(
    material: Material, internal_length: float, cutoff_ratio: float, tooth_ratio: float, planes: float = 1.0
) -> BondLaw | None:
    """The law of a material's bonds; None without failure.

    Where planes of the lattice take another energy than the bulk's formula has, cracks transmit as much less at every
    opening. So the forces of the branch are raised until planes have the deck's energy in the mean. The first stretch
    stays, because uniform bodies are as strong as they should be.

    Parameters
    ----------
    internal_length : float, dimension length
    cutoff_ratio : float
        ``r_c / l``.
    tooth_ratio : float
    planes : float, dimension 1
        `lattice_planes.energy_of_planes`.

    Raises
    ------
    ValueError
        The internal length is too large for the strength and the energy; its text is the rest of a sentence.
    """
    unit = material.energy_of_bonds(internal_length, cutoff_ratio)
    if not material.softens:
        stretch = material.stretch_at_failure(internal_length, cutoff_ratio)
        if stretch is None:
            return None
        strength = material.youngs_modulus * stretch
        whole = material.energy_at_failure(stretch, internal_length, cutoff_ratio)
        return BondLaw(stretch, stretch, brittle(stretch), whole, unit * stretch**2, None, np.inf, strength)
    strength, energy, shape = _properties(material, unit, internal_length, cutoff_ratio)
    first, lacks, unit = strength / material.youngs_modulus, material.lacking, unit * planes
    shape = shape.raised(1.0 / planes)
    longest = internal_length * energy / (unit * first**2 * _least_energy(shape, lacks, cutoff_ratio))
    ratio = _ratio(shape, energy / (unit * first**2), lacks, cutoff_ratio)
    if ratio > LEAST_RATIO and (shape.drop == 1.0 or lacks < 0.0):
        first, ratio = _hardening(shape, first, energy / unit, tooth_ratio, material.poissons_ratio, cutoff_ratio)
    if not (ratio > LEAST_RATIO and longest > internal_length):
        changes = ", or less, since the law changes with l" if planes != 1.0 or material.traction_opening else ""
        raise ValueError(
            f"is too long for a strength of {strength:.6g} with a fracture energy of {energy:.6g}: bonds that soften "
            f"need l <= {longest:.6g}{changes}. Use a smaller peridynamics.internal_length, finer cells where it "
            "follows them, or critical_stretch"
        )
    teeth = make_teeth(shape.branch(ratio), tooth_ratio, first)
    of_bonds = unit * teeth.energy if lacks else energy
    return BondLaw(first, ratio * first, teeth, energy, of_bonds, shape, longest, strength, planes)


def _ratio(shape: Shape, energy: float, lacks: float, cutoff_ratio: float) -> float:
    """The final over the first stretch for an energy over ``C mu l s_t^2``, with that of the dilatation in it.

    ``lacks`` is ``(lambda - mu) / mu``. Below `LEAST_RATIO` where there is none.
    """
    ratio = shape.ratio(energy)
    if not lacks:
        return ratio
    from scipy.optimize import brentq  # 10 MiB that other decks do without

    def excess(candidate):
        return shape.branch(candidate).energy + lacks * dilatation_energy(shape, candidate, cutoff_ratio) - energy

    low = 1.0 if shape.kink is None else 1.0 / shape.kink[0]
    if excess(low) >= 0.0:
        return 1.0
    high = max(ratio, low)
    while excess(high) < 0.0:
        high *= 1.5
    return float(f"{brentq(excess, low, high, xtol=1e-13, rtol=1e-13):.{DIGITS}g}")


def _least_energy(shape: Shape, lacks: float, cutoff_ratio: float) -> float:
    """`Shape.least_energy` with that of the dilatation in it."""
    if not lacks:
        return shape.least_energy
    least = 1.0 if shape.kink is None else 1.0 / shape.kink[0]
    return shape.least_energy + lacks * dilatation_energy(shape, least, cutoff_ratio)


def _properties(material: Material, unit: float, length: float, cutoff_ratio: float) -> tuple[float, float, Shape]:
    """Strength, fracture energy and shape of the branch."""
    curve = material.traction_opening
    if curve is not None:
        shape = fit_curve(curve, material.youngs_modulus, unit, length, cutoff_ratio)
        return curve[0][1], curve_energy(curve), shape
    kink = material.kink_stretch_ratio, material.kink_force_ratio
    shape = Shape(1.0 if material.softening == "line" else DROP, None if kink[0] is None else kink)
    return material.tensile_strength, material.fracture_energy, shape


@functools.cache
def _hardening(
    shape: Shape, wanted: float, energy: float, tooth_ratio: float, poissons_ratio: float, cutoff_ratio: float
) -> tuple[float, float]:
    """First stretch and ratio with which a body has the strength ``E wanted``, that hardens after its first bonds.

    Bodies do so without a drop, and with it where Poisson's ratio is small and the branch long. ``energy`` is over
    that of bonds that break at stretch 1.
    """
    lacks = (4.0 * poissons_ratio - 1.0) / (1.0 - 2.0 * poissons_ratio)
    first, ratio = wanted, _ratio(shape, energy / wanted**2, lacks, cutoff_ratio)
    for _ in range(ROUNDS):
        teeth = make_teeth(shape.branch(ratio), tooth_ratio)
        factor = strength_factor(teeth, poissons_ratio)
        if shape.drop < 1.0 and factor < 1.0 + LEAST_HARDENING:
            return wanted, _ratio(shape, energy / wanted**2, lacks, cutoff_ratio)
        before, first = first, wanted / (factor * float(teeth.limit[0]))
        ratio = _ratio(shape, energy / first**2, lacks, cutoff_ratio)
        if ratio <= LEAST_RATIO or abs(first - before) <= NEAR * first:
            break
    return first, ratio


def tooth_ratio_of(scene: Scene) -> float:
    """Of the deck, or the default."""
    return scene.stepping.tooth_ratio or TOOTH_RATIO


def laws_of_materials(scene: Scene, internal_length: float, cutoff_ratio: float, planes: float) -> dict[str, BondLaw]:
    """The law of each material that can fail, by name; see `law_of`.

    Raises
    ------
    SceneError
        With all materials whose bonds would be brittle.
    """
    laws, messages = {}, []
    for name, material in materials_of(scene).items():
        try:
            law = law_of(material, internal_length, cutoff_ratio, tooth_ratio_of(scene), planes)
        except ValueError as error:
            of = "" if len(scene.materials) == 0 else f" of {name}"
            messages.append(f"peridynamics.internal_length = {internal_length:.6g} {error}{of}.")
            continue
        if law is not None:
            laws[name] = law
    if messages:
        raise SceneError(messages)
    return laws


def laws_of_bonds(
    scene: Scene, internal_length: float, cutoff_ratio: float, planes: float
) -> tuple[list[BondLaw], np.ndarray]:
    """The different laws, and which of them holds between materials a and b: that of the side that ends first.

    Returns
    -------
    laws : list of BondLaw
    which : int64, shape (n_materials, n_materials)
        -1 where bonds do not break.

    Raises
    ------
    SceneError
        As `laws_of_materials`.
    """
    laws_of_materials(scene, internal_length, cutoff_ratio, planes)
    table = bond_materials(scene)
    laws: list[BondLaw] = []
    known: dict[Material, int] = {}
    which = np.full((len(table), len(table)), -1)
    for a, row in enumerate(table):
        for b, of_bond in enumerate(row):
            candidates = []
            for material in of_bond:
                if not material.can_fail:
                    continue
                if material not in known:
                    try:
                        law = law_of(material, internal_length, cutoff_ratio, tooth_ratio_of(scene), planes)
                    except ValueError as error:
                        text = f"peridynamics.internal_length = {internal_length:.6g} {error} across an interface."
                        raise SceneError([text]) from None
                    known[material] = len(laws)
                    laws.append(law)
                candidates.append(known[material])
            if candidates:
                which[a, b] = min(candidates, key=lambda k: (laws[k].teeth.limit[0], k))
    return laws, which


def first_stretches(scene: Scene, internal_length: float, cutoff_ratio: float, planes: float) -> np.ndarray:
    """Stretch at which the bonds between two materials go on or break, as `materials.bond_stretches`.

    Without a drop it is that of the first tooth, which lies a little above the one where the branch begins.
    """
    if not scene.softens:
        return bond_stretches(scene, internal_length, cutoff_ratio)
    laws, which = laws_of_bonds(scene, internal_length, cutoff_ratio, planes)
    return np.append([law.teeth.limit[0] for law in laws], np.inf)[which]
