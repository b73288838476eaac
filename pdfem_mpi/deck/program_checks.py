"""What a load program needs of the other tables of a deck."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from pdfem_mpi.deck.loads import Support
from pdfem_mpi.deck.materials import Interface, Material, all_materials
from pdfem_mpi.deck.peridynamics import Peridynamics
from pdfem_mpi.deck.programs import Solver
from pdfem_mpi.deck.regions import Region, can_have_bonds, has_model
from pdfem_mpi.deck.softening import CRITERION
from pdfem_mpi.deck.table import MOST_HINTS, Problem, did_you_mean, show


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
    bonded = [region for region in regions if can_have_bonds(region)]
    if not bonded:  # all are always elements, which the check of automatic regions refuses
        return []
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
    stepping: Any,
) -> list[Problem]:
    """Teeth belong to bonds that soften."""
    tables = (material, *materials.values(), *interfaces)
    if stepping.tooth_ratio is None or any(table.softens for table in tables):
        return []
    text = "is of bonds that soften, and none does. Give material.tensile_strength, or remove it."
    return [Problem("stepping.tooth_ratio", f"= {show(stepping.tooth_ratio)} {text}")]


def check_events_over_time(stepping: Any, peridynamics: Peridynamics, loads: Sequence[Any]) -> list[Problem]:
    """Loads that come and go from break to break: bodies that answer in proportion to them."""
    if stepping.kind != "events" or stepping.times is None:
        return []
    problems = []
    if peridynamics.kinematics != "linear":
        text = 'scales states with the load, which finite kinematics do not. Use peridynamics.kinematics = "linear".'
        problems.append(Problem("stepping.times", text))
    for index, load in enumerate(loads):
        if load.constant:
            text = 'stays while stepping.times scale states with the load. Remove it, or use stepping.kind = "steps".'
            problems.append(Problem(f"loads.{index}.constant", f"= true {text}"))
    return problems


def check_stepping_solver(stepping: Any, solver: Solver) -> list[Problem]:
    needed = {"ramp": "adr", "events": "cg"}.get(stepping.kind, solver.kind)
    if solver.kind == needed:
        return []
    return [
        Problem(
            "solver.kind",
            f"= {show(solver.kind)} does not go with stepping.kind = {show(stepping.kind)}, which "
            + ("is relaxation" if needed == "adr" else "needs a solver for equilibrium")
            + f'. Use "{needed}".',
        )
    ]


def check_opening(stepping: Any, probes: Sequence[Any]) -> list[Problem]:
    """The opening that is controlled is that of a probe."""
    wanted = getattr(stepping, "opening", None)
    names = [getattr(probe, "name", None) for probe in probes if getattr(probe, "kind", None) == "opening"]
    if wanted is None or wanted in names or None in names:
        return []
    known = f" Those are {', '.join(names[:MOST_HINTS])}." if names else " There is none: add it to [[probes]]."
    hint = did_you_mean(wanted, names) or known
    return [Problem("stepping.opening", f'= {show(wanted)} is not the name of a probe of kind "opening".{hint}')]


def check_formulas(stepping: Any, supports: Sequence[Any]) -> list[Problem]:
    """What does not grow with the load factor alone is for programs that find equilibrium at given ones."""
    if stepping.kind == "steps":
        return []
    return [
        Problem(
            f"supports.{index}",
            f'follows the load factor f by a formula, and stepping.kind = "{stepping.kind}" scales states with it. '
            'Leave f out, or use stepping.kind = "steps".',
        )
        for index, support in enumerate(supports)
        if support.follows_factor
    ]


def check_something_loads(stepping: Any, loads: Sequence[Any], supports: Sequence[Support]) -> list[Problem]:
    """Failure needs a load: a force, or a support that moves."""
    amounts = [
        component
        for load in loads
        if not getattr(load, "constant", False)
        for vector in (getattr(load, "total", None), getattr(load, "density", None), getattr(load, "traction", None))
        for component in vector or (getattr(load, "pressure", None),)
    ] + [component for support in supports for component in support.amounts]
    if stepping.kind == "steps" or any(amounts):
        return []
    return [
        Problem(
            "stepping.kind",
            f"= {show(stepping.kind)} raises the load until bonds break, and nothing loads the body. "
            "Add a table [[loads]], or a support that moves.",
        )
    ]
