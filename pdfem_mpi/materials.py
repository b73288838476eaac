"""Several materials in one scene: their order, their moduli, and what holds for the bonds between two of them.

Materials are counted in the order of the deck: 0 is the table ``[material]``, which is also the unit of stress, then
come the tables ``[materials.NAME]``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pdfem_mpi.scene import DEFAULT_MATERIAL, Material, Scene


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
        Young's modulus in the response constant of the bonds between two materials; symmetric.
    """

    names: tuple[str, ...]
    youngs_modulus: np.ndarray
    poissons_ratio: np.ndarray
    bond_modulus: np.ndarray


def materials_of(scene: Scene) -> dict[str, Material]:
    """The materials of a scene by name, the default one first."""
    return {DEFAULT_MATERIAL: scene.material} | scene.materials


def bond_materials(scene: Scene) -> tuple[tuple[Material, ...], ...]:
    """The material whose properties hold for the bonds between materials a and b (sec. 2.1, Fig. 6).

    That of the side with the smaller bulk modulus (of two equal ones, the first in the deck), with what the deck's
    table of the interface gives in the place of its own.

    Returns
    -------
    tuple of tuples of Material
        Entry [a][b] of a symmetric table, shape (n_materials, n_materials).
    """
    materials = materials_of(scene)
    given = {frozenset(interface.between): interface for interface in scene.interfaces}

    def holding(a: str, b: str) -> Material:
        order = sorted({a, b}, key=list(materials).index)
        softer = min((materials[name] for name in order), key=lambda material: material.bulk_modulus)
        interface = given.get(frozenset(order))
        if interface is None:
            return softer
        return softer.model_copy(update=interface.model_dump(exclude={"between"}, exclude_none=True))

    return tuple(tuple(holding(a, b) for b in materials) for a in materials)


def material_table(scene: Scene) -> MaterialTable:
    """The numbers of a scene's materials."""
    materials = materials_of(scene)
    unit = scene.material.youngs_modulus
    return MaterialTable(
        names=tuple(materials),
        youngs_modulus=np.array([material.youngs_modulus for material in materials.values()]) / unit,
        poissons_ratio=np.array([material.poissons_ratio for material in materials.values()]),
        bond_modulus=np.array([[m.youngs_modulus for m in row] for row in bond_materials(scene)]) / unit,
    )
