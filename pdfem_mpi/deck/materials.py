"""What the body is made of: deck tables ``[material]``, ``[materials.NAME]`` and ``[[interfaces]]``."""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Iterable, Sequence
from typing import Any, Literal

from pdfem_mpi.deck.opening import squared_dilatation
from pdfem_mpi.deck.softening import DROP, PAIR, can_fail, criterion_problems, curve_key, softens
from pdfem_mpi.deck.table import LONGEST_NAME, MOST_HINTS, Problem, Table, did_you_mean, key, show

DEFAULT_MATERIAL = "default"  # what regions and interfaces call the table [material]
MOST_CONTRAST = 1e5  # of Young's moduli: at 1e6 residuals of elements stop at 2e-6, above the tolerance in use
BOND_POISSONS_RATIO = 0.25  # that of bonds alone; another one asks for a volumetric part beside them
LEAST_BOND_RATIO, MOST_BOND_RATIO = 0.0, 0.49  # of materials with bonds
NEARLY_INCOMPRESSIBLE = 0.45  # above, solves take longer, and displacements are less exact


class Material(Table):
    """Isotropic elastic material (sec. 2.1); deck tables ``[material]`` and, for further ones, ``[materials.NAME]``.

    Attributes
    ----------
    youngs_modulus : float, > 0, dimension force / length^2
        Young's modulus.
    poissons_ratio : float, above -1 and below 0.5, dimension 1
        From 0 to 0.49 where the material has bonds (peridynamic regions, overlap), which alone have 1/4.
    critical_stretch : float or None, > 0, dimension 1
        ``s_0`` of eq. (4): bonds beyond it break.
    fracture_energy : float or None, > 0, dimension force / length
        ``G_c``, which gives ``s_0`` by the bonds that a plane cuts. At most one of the two; None (default): no failure.
    tensile_strength : float or None, > 0, dimension force / length^2
        ``f_t``, with a fracture energy: bonds soften from the stretch ``f_t / E`` on, so that both are the material's.
    softening : "drop", "line" or None
        The force falls to about half and from there on a straight line to 0; or on a line from its peak, for which the
        strength is above that of the bonds. None (default): "drop" where a strength is given.
    kink_stretch_ratio, kink_force_ratio : float or None, dimension 1
        With "drop": the line has a kink, at this fraction of the final stretch and this fraction of the peak force.
    traction_opening : pairs of floats or None, dimensions length and force / length^2
        What a crack transmits over its opening, from the strength at 0 to 0: in the place of strength, energy and kink.
    thermal_expansion : float or None, dimension 1 / temperature
        Strain of a free body per change of temperature; see the table ``[temperature]``.

    Examples
    --------
    >>> Material(youngs_modulus=1.0e7).bulk_modulus
    6666666.666666667
    """

    youngs_modulus: float = key(gt=0, dimension="force / length^2", remedy="Give Young's modulus, for example 1.0e7.")
    poissons_ratio: float = key(BOND_POISSONS_RATIO, gt=-1, lt=0.5, dimension="1")
    critical_stretch: float | None = key(None, gt=0, dimension="1")
    fracture_energy: float | None = key(None, gt=0, dimension="force / length")
    tensile_strength: float | None = key(None, gt=0, dimension="force / length^2")
    softening: Literal["drop", "line"] | None = key(None)
    kink_stretch_ratio: float | None = key(None, gt=0, lt=1, dimension="1")
    kink_force_ratio: float | None = key(None, gt=0, lt=DROP, dimension="1")
    traction_opening: tuple[PAIR, ...] | None = curve_key()
    thermal_expansion: float | None = key(None, dimension="1 / temperature")

    def problems(self) -> list[Problem]:
        """One criterion, whole."""
        return criterion_problems(self)

    @property
    def can_fail(self) -> bool:
        """Whether bonds of this material break."""
        return can_fail(self)

    @property
    def softens(self) -> bool:
        """Whether its bonds soften before they break."""
        return softens(self)

    def stretch_at_failure(self, internal_length: float, cutoff_ratio: float) -> float | None:
        """The critical stretch, given or from the fracture energy; None without failure.

        ``G_c = (pi / 2) c s_0^2 int_0^rc xi^4 exp(-(xi / l)^2) dxi = (27 sqrt(pi) / 16) k l s_0^2 share(r_c / l)``: the
        energy of all bonds that a plane through the bulk cuts (Silling's integral with the response of eq. 2), ``k``
        that of a Poisson's ratio of 1/4 and the same shear modulus. With another ratio the dilatation beside the plane
        adds ``9 (lambda - mu) l s_0^2 int C^2 dz`` (`deck.opening`).

        Parameters
        ----------
        internal_length : float, dimension length
        cutoff_ratio : float
            ``r_c / l``.
        """
        if self.fracture_energy is None:
            return self.critical_stretch
        return math.sqrt(self.fracture_energy / self.energy_at_failure(1.0, internal_length, cutoff_ratio))

    def energy_at_failure(self, critical_stretch: float, internal_length: float, cutoff_ratio: float) -> float:
        """The fracture energy of the bulk whose bonds break at a stretch; dimension force / length."""
        of_bonds = self.energy_of_bonds(internal_length, cutoff_ratio)
        return of_bonds * critical_stretch**2 * (1.0 + self.share_of_dilatation(cutoff_ratio))

    def energy_of_bonds(self, internal_length: float, cutoff_ratio: float) -> float:
        """That of the bonds alone, at a stretch of 1: ``4.843 mu l`` at a cutoff of 2.5; dimension force / length."""
        bulk = self.modulus_of_bonds / (3.0 * (1.0 - 2.0 * BOND_POISSONS_RATIO))
        return 27.0 * math.sqrt(math.pi) / 16.0 * bulk * internal_length * _share_within(cutoff_ratio)

    def share_of_dilatation(self, cutoff_ratio: float) -> float:
        """Fracture energy of the volumetric part over that of the bonds: 0 at 1/4, 0.1795 (lambda - mu) / mu at 2.5."""
        if self.poissons_ratio == BOND_POISSONS_RATIO:
            return 0.0
        of_bonds = 45.0 * math.sqrt(math.pi) / 16.0 * _share_within(cutoff_ratio)
        return 9.0 * squared_dilatation(cutoff_ratio) * self.lacking / of_bonds

    @property
    def lacking(self) -> float:
        """``(lambda - mu) / mu``: what bonds alone lack; 0 at a Poisson's ratio of 1/4."""
        return (4.0 * self.poissons_ratio - 1.0) / (1.0 - 2.0 * self.poissons_ratio)

    @property
    def modulus_of_bonds(self) -> float:
        """Young's modulus of the material of the same shear modulus with the Poisson's ratio of bonds, 1/4."""
        return self.youngs_modulus * ((1.0 + BOND_POISSONS_RATIO) / (1.0 + self.poissons_ratio))

    @property
    def bulk_modulus(self) -> float:
        """``k = E / (3 (1 - 2 nu))``, dimension force / length^2."""
        return self.youngs_modulus / (3.0 * (1.0 - 2.0 * self.poissons_ratio))


def _share_within(cutoff_ratio: float) -> float:
    """Share of the bonds' fracture energy that a cutoff radius of so many internal lengths keeps."""
    a = min(cutoff_ratio, 30.0)  # the share is 1 from 6 on, and powers of large ratios are not finite
    return math.erf(a) - 2.0 / math.sqrt(math.pi) * math.exp(-a * a) * (2.0 / 3.0 * a**3 + a)


class Interface(Table):
    """What holds for the bonds between two materials (sec. 2.1, Fig. 6); deck tables ``[[interfaces]]``.

    What is not given here is that of the material with the smaller shear modulus, Poisson's ratio included.

    Attributes
    ----------
    between : two texts
        Names of the materials, in any order; "default" is the table [material].
    youngs_modulus : float or None, > 0, dimension force / length^2
        Of the bonds across.
    critical_stretch : float or None, > 0, dimension 1
        At which they break.
    fracture_energy : float or None, > 0, dimension force / length
        Which gives their critical stretch.
    tensile_strength, softening, kink_stretch_ratio, kink_force_ratio, traction_opening
        As of a material; what is given of these and the two above replaces all of the material's.
    """

    between: tuple[str, ...] = key(remedy='Name the two materials, for example ["default", "steel"].')
    youngs_modulus: float | None = key(None, gt=0, dimension="force / length^2")
    critical_stretch: float | None = key(None, gt=0, dimension="1")
    fracture_energy: float | None = key(None, gt=0, dimension="force / length")
    tensile_strength: float | None = key(None, gt=0, dimension="force / length^2")
    softening: Literal["drop", "line"] | None = key(None)
    kink_stretch_ratio: float | None = key(None, gt=0, lt=1, dimension="1")
    kink_force_ratio: float | None = key(None, gt=0, lt=DROP, dimension="1")
    traction_opening: tuple[PAIR, ...] | None = curve_key()

    def problems(self) -> list[Problem]:
        """Two different names, and something given."""
        problems = criterion_problems(self)
        if len(self.between) != 2 or self.between[0] == self.between[1]:
            problems.append(
                Problem("between", f"= {show(self.between)} must name two different materials. Correct it.")
            )
        if self.youngs_modulus is None and not self.can_fail:
            problems.append(
                Problem("", "changes nothing. Give youngs_modulus, critical_stretch or fracture_energy, or remove it.")
            )
        return problems

    @property
    def can_fail(self) -> bool:
        """Whether it says when bonds break."""
        return can_fail(self)

    @property
    def softens(self) -> bool:
        """Whether bonds across it soften before they break."""
        return softens(self)


def all_materials(material: Material, materials: dict[str, Material]) -> dict[str, tuple[str, Material]]:
    """Key in the deck and table of every material, by name."""
    return {DEFAULT_MATERIAL: ("material", material)} | {
        name: (f"materials.{name}", table) for name, table in materials.items()
    }


def check_material_names(materials: dict[str, Material]) -> list[Problem]:
    problems = []
    for name in materials:
        if name == DEFAULT_MATERIAL:
            problems.append(Problem(f"materials.{name}", "is the name of the table [material]. Choose another name."))
        elif len(name) > LONGEST_NAME:
            text = f"is longer than {LONGEST_NAME} characters. Shorten it."
            problems.append(Problem(f"materials.{show(name)}", text))
        elif not re.fullmatch(r"[A-Za-z0-9_-]+", name):
            problems.append(Problem(f"materials.{show(name)}", "is not a name. Use letters, digits, - and _ only."))
    return problems


def check_contrast(
    material: Material, materials: dict[str, Material], interfaces: Sequence[Interface]
) -> list[Problem]:
    """Residuals of all materials are weighed together, and stop at the round-off of the stiffest."""
    moduli = {where: table.youngs_modulus for where, table in all_materials(material, materials).values()}
    moduli |= {f"interfaces.{k}": i.youngs_modulus for k, i in enumerate(interfaces) if i.youngs_modulus is not None}
    stiffest, softest = max(moduli, key=moduli.get), min(moduli, key=moduli.get)
    contrast = moduli[stiffest] / moduli[softest]
    if contrast <= MOST_CONTRAST * (1.0 + 1e-9):
        return []
    return [
        Problem(
            f"{softest}.youngs_modulus",
            f"= {show(moduli[softest])} is {contrast:.3g} times below {stiffest}.youngs_modulus = "
            f"{show(moduli[stiffest])}: round-off of the stiff would hide the soft. Keep them within "
            f"{MOST_CONTRAST:g}; leave out what carries nothing, and support what does not give.",
        )
    ]


def unknown_names(uses: Iterable[tuple[str, str]], tables: dict[str, Any]) -> list[Problem]:
    problems = []
    for where, name in uses:
        if name not in tables:
            hint = did_you_mean(name, tables) if len(problems) < MOST_HINTS else ""
            remedy = hint or f" The materials are {', '.join(itertools.islice(tables, MOST_HINTS))}."
            problems.append(Problem(where, f"has {show(name)}, which is not the name of a material.{remedy}"))
    return problems
