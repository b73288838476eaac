"""Several materials in one scene: their order, their moduli, and what holds for the bonds between two of them.

Materials are counted in the order of the deck: 0 is the table ``[material]``, which is also the unit of stress, then
come the tables ``[materials.NAME]``.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pdfem_mpi.body.model_units import ModelUnits
from pdfem_mpi.deck.materials import DEFAULT_MATERIAL, Material
from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.deck.softening import CRITERION


@dataclass(frozen=True)
class MaterialTable:
    """Numbers of the materials of a scene, in model units.

    Attributes
    ----------
    names : tuple of str
    youngs_modulus : float64, shape (n_materials,), dimension stress
        1 for the default material.
    poissons_ratio : float64, shape (n_materials,), dimension 1
    bond_modulus : float64, shape (n_materials, n_materials), dimension stress
        Young's modulus, at a Poisson's ratio of 1/4 and the same shear modulus, in the response constant of the bonds
        between two materials; symmetric.
    """

    names: tuple[str, ...]
    youngs_modulus: np.ndarray
    poissons_ratio: np.ndarray
    bond_modulus: np.ndarray

    @property
    def own_bond_modulus(self) -> np.ndarray:
        """``bond_modulus`` within each material, which is its Young's modulus at a Poisson's ratio of 1/4."""
        return np.diag(self.bond_modulus)

    def rounded(self, units: ModelUnits) -> MaterialTable:
        """The same without digits that hang on the deck's units, if these are rounded."""
        moduli = {name: units.numbers(getattr(self, name)) for name in ("youngs_modulus", "bond_modulus")}
        return replace(self, **moduli)


def materials_of(scene: Scene) -> dict[str, Material]:
    """The materials of a scene by name, the default one first."""
    return {DEFAULT_MATERIAL: scene.material} | scene.materials


def bond_materials(scene: Scene) -> tuple[tuple[tuple[Material, ...], ...], ...]:
    """The materials whose properties hold for the bonds between materials a and b (sec. 2.1, Fig. 6).

    That of the side with the smaller shear modulus, with what the deck's table of the interface gives in the place of
    its own. Two sides of equal shear modulus both hold: they have one response, and the weaker decides when it ends.

    Returns
    -------
    tuple of tuples of tuples of Material
        Entry [a][b], one or two materials, of a symmetric table of shape (n_materials, n_materials).
    """
    materials = materials_of(scene)
    given = {frozenset(interface.between): interface for interface in scene.interfaces}

    def holding(a: str, b: str) -> tuple[Material, ...]:
        sides = [materials[name] for name in materials if name in (a, b)]
        softest = min(side.modulus_of_bonds for side in sides)
        interface = given.get(frozenset((a, b)))
        own = {} if interface is None else interface.model_dump(exclude={"between"}, exclude_none=True)
        if interface is not None and interface.can_fail:
            own = dict.fromkeys(CRITERION) | own
        copies = [side.model_copy(update=own) for side in sides if side.modulus_of_bonds == softest]
        # a modulus of the interface makes two of sides with one shear modulus and two Poisson's ratios
        softest = min(side.modulus_of_bonds for side in copies)
        return tuple(side for side in copies if side.modulus_of_bonds == softest)

    return tuple(tuple(holding(a, b) for b in materials) for a in materials)


def material_table(scene: Scene) -> MaterialTable:
    """The numbers of a scene's materials."""
    materials = materials_of(scene)
    unit = scene.material.youngs_modulus
    return MaterialTable(
        names=tuple(materials),
        youngs_modulus=np.array([material.youngs_modulus for material in materials.values()]) / unit,
        poissons_ratio=np.array([material.poissons_ratio for material in materials.values()]),
        bond_modulus=np.array([[sides[0].modulus_of_bonds for sides in row] for row in bond_materials(scene)]) / unit,
    )


def bond_stretches(
    scene: Scene, internal_length: float, cutoff_ratio: float, units: ModelUnits | None = None
) -> np.ndarray:
    """Critical stretch of the bonds between two materials; infinity if they do not break.

    Parameters
    ----------
    internal_length : float, dimension length
        In the deck's unit.
    cutoff_ratio : float
        ``r_c / l``.
    units : ModelUnits, optional
        Which round what comes from a fracture energy: its last digits hang on the deck's units.

    Returns
    -------
    float64, shape (n_materials, n_materials), dimension 1
    """

    def stretch(material: Material) -> float | None:
        s = material.stretch_at_failure(internal_length, cutoff_ratio)
        return float(units.numbers(s)) if units and s and material.fracture_energy is not None else s

    def weakest(of_bond: tuple[Material, ...]) -> float:
        return min((s for s in map(stretch, of_bond) if s is not None), default=np.inf)

    return np.array([[weakest(of_bond) for of_bond in row] for row in bond_materials(scene)])
