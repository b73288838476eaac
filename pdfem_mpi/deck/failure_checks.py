"""Checks between tables about bonds that break or soften, and the load programs that follow them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from pdfem_mpi.deck.materials import BOND_POISSONS_RATIO, Interface, Material, all_materials
from pdfem_mpi.deck.peridynamics import Peridynamics
from pdfem_mpi.deck.regions import Region, has_model
from pdfem_mpi.deck.softening import CRITERION, OWN_RATIO
from pdfem_mpi.deck.table import Problem, show


def check_failure(
    material: Material,
    materials: dict[str, Material],
    interfaces: Sequence[Interface],
    regions: Sequence[Region],
    stepping: Any,
) -> list[Problem]:
    """Failure needs bonds that may break, and a program that breaks them needs failure."""
    tables = all_materials(material, materials)
    if not has_model(regions, "peridynamics"):
        problems = [
            Problem(
                f"{where}.{next(name for name in CRITERION if getattr(table, name) is not None)}",
                "breaks bonds, and no region has any. Remove it, or describe a region by peridynamics.",
            )
            for where, table in tables.values()
            if table.can_fail
        ]
        return problems or _needs_failure(stepping, "finite elements do not break. Describe a region by peridynamics.")
    bonded = [region for region in regions if region.model == "peridynamics"]
    breakable = any(tables[region.material][1].can_fail for region in bonded if region.material in tables)
    if not breakable and not any(interface.can_fail for interface in interfaces):
        return _needs_failure(
            stepping, "nothing says when bonds break. Give material.critical_stretch or material.fracture_energy."
        )
    if all(region.may_fail is False for region in bonded):
        return [
            Problem("regions", "with peridynamics all have may_fail = false: no bond can break. Let one of them fail.")
        ]
    return []


def _needs_failure(stepping: Any, reason: str) -> list[Problem]:
    if stepping.kind == "steps":
        return []
    return [Problem("stepping.kind", f"= {show(stepping.kind)} follows failure, and {reason}")]


def check_softening(
    material: Material,
    materials: dict[str, Material],
    interfaces: Sequence[Interface],
    regions: Sequence[Region],
    peridynamics: Peridynamics,
    stepping: Any,
) -> list[Problem]:
    """Teeth belong to bonds that soften, and these to stiffnesses that push back where they are pressed."""
    tables = (material, *materials.values(), *interfaces)
    if not any(table.softens for table in tables):
        if stepping.tooth_ratio is None:
            return []
        text = "is of bonds that soften, and none does. Give material.tensile_strength, or remove it."
        return [Problem("stepping.tooth_ratio", f"= {show(stepping.tooth_ratio)} {text}")]
    if peridynamics.surface_correction == "fitted" and peridynamics.signs == "free":
        return [
            Problem(
                "peridynamics.signs",
                '= "free" lets bonds push where they are stretched, and such a bond cannot soften. Use "bounded", or '
                'surface_correction = "virial".',
            )
        ]
    named = all_materials(material, materials)
    used = {region.material for region in regions if region.model == "peridynamics" and region.material in named}
    ratios = [(where, table.poissons_ratio) for name, (where, table) in named.items() if name in used]
    return [
        Problem(f"{where}.poissons_ratio", f"= {show(ratio)} {OWN_RATIO}")
        for where, ratio in ratios
        if ratio != BOND_POISSONS_RATIO
    ]
