"""When bonds break or soften: keys that ``[material]``, ``[materials.NAME]`` and ``[[interfaces]]`` share.

A deck gives one of four criteria: a critical stretch; a fracture energy, which gives the critical stretch; a tensile
strength with a fracture energy, by which bonds soften; or what a crack transmits over its opening, which gives both.
"""

from __future__ import annotations

import itertools
from typing import Any

from pydantic import BaseModel

from pdfem_mpi.deck.table import Problem, key, show

#: Keys that say when bonds break or soften. An interface that has one of them replaces all of its material's.
CRITERION = (
    "critical_stretch", "fracture_energy", "tensile_strength", "softening", "kink_stretch_ratio", "kink_force_ratio",
    "traction_opening",
)  # fmt: skip
#: A point of a curve: opening and traction.
PAIR = tuple[float, float]
#: Keys of the shape of softening, which say nothing without a strength and an energy.
SHAPE = ("softening", "kink_stretch_ratio", "kink_force_ratio")
#: Force at once after the drop, over that before it: from 0.54 on the bulk hardens after its first bonds soften, up to
#: 1/2 it does not, and the strength of the material is that of its bonds.
DROP = 0.5
#: What decks that soften have where they do not say otherwise, by table: wider batches and fewer sweeps between them
#: move no peak, and an exactly symmetric body would soften on both sides of its plane alike.
EVENTS_DEFAULTS = {"eta": 1.0e-2, "inner_iterations": 4}
NOISE_DEFAULT = {"stiffness_noise": 0.005}


def softens(table: BaseModel) -> bool:
    """Whether the bonds of a material or an interface soften before they break."""
    return table.tensile_strength is not None or table.traction_opening is not None


def can_fail(table: BaseModel) -> bool:
    """Whether a material or an interface says when bonds break."""
    return table.critical_stretch is not None or table.fracture_energy is not None or softens(table)


def criterion_problems(table: BaseModel) -> list[Problem]:
    """What is wrong between the keys of one criterion."""
    if table.traction_opening is not None:
        return _curve_problems(table)
    problems = []
    if table.tensile_strength is not None:
        if table.critical_stretch is not None:
            problems.append(
                Problem(
                    "critical_stretch",
                    "and tensile_strength are both given: a critical stretch is brittle, a strength with a fracture "
                    "energy softens. Keep one.",
                )
            )
        elif table.fracture_energy is None:
            problems.append(
                Problem(
                    "tensile_strength",
                    f"= {show(table.tensile_strength)} needs fracture_energy beside it: bonds that soften need both. "
                    "Give fracture_energy, or critical_stretch instead of both.",
                )
            )
    elif table.critical_stretch is not None and table.fracture_energy is not None:
        problems.append(
            Problem("critical_stretch", "and fracture_energy are both given, and each gives the other. Keep one.")
        )
    return problems + _shape_problems(table)


def _shape_problems(table: BaseModel) -> list[Problem]:
    """Keys of a shape belong to bonds that soften, and the two of a kink to each other and to the drop."""
    given = [name for name in SHAPE if getattr(table, name) is not None]
    if table.tensile_strength is None:
        return [
            Problem(name, f"= {show(getattr(table, name))} shapes bonds that soften, and these break at once. Give "
                    "tensile_strength and fracture_energy, or remove it.")
            for name in given
        ]  # fmt: skip
    kinks = [name for name in given if name != "softening"]
    if kinks and table.softening == "line":
        return [
            Problem(kinks[0], 'belongs to softening = "drop", and softening = "line" has no kink. Remove one of them.')
        ]
    if len(kinks) == 1:
        other = next(name for name in SHAPE[1:] if name != kinks[0])
        return [Problem(kinks[0], f"is given without {other}, and a kink needs both. Give both, or none.")]
    return []


def _curve_problems(table: BaseModel) -> list[Problem]:
    """A traction-opening curve says all, begins at opening 0 and falls to 0."""
    also = [name for name in CRITERION if name != "traction_opening" and getattr(table, name) is not None]
    if also:
        return [Problem(also[0], "and traction_opening are both given, and the curve says all of it. Keep one.")]
    curve, reason = table.traction_opening, ""
    if len(curve) < 2:
        reason = "needs two points or more"
    elif curve[0][0] != 0.0 or not curve[0][1] > 0.0:
        reason = "must begin with opening 0 and the tensile strength"
    elif not all(a[0] < b[0] for a, b in itertools.pairwise(curve)):
        reason = "must have rising openings"
    elif curve[-1][1] != 0.0 or not all(a[1] >= b[1] for a, b in itertools.pairwise(curve)):
        reason = "must have tractions that fall to 0"
    if not reason:
        return []
    return [
        Problem(
            "traction_opening", f"= {show(curve)} {reason}. Use for example [[0.0, 2.6], [0.036, 0.6], [0.2, 0.0]]."
        )
    ]


def with_defaults(data: Any) -> Any:
    """The tables of a scene, with the defaults of bonds that soften where its deck does not say otherwise."""
    if not isinstance(data, dict) or not _any_softens(data):
        return data
    data = dict(data)
    if _get(data.get("stepping"), "kind") == "events":
        data["stepping"] = _filled(data["stepping"], EVENTS_DEFAULTS)
    data["peridynamics"] = _filled(data.get("peridynamics", {}), NOISE_DEFAULT)
    return data


def _any_softens(data: dict[str, Any]) -> bool:
    named, interfaces = data.get("materials", {}), data.get("interfaces", ())
    tables = [data.get("material"), *(named.values() if isinstance(named, dict) else ())]
    tables += interfaces if isinstance(interfaces, tuple | list) else ()
    return any(_get(table, name) is not None for table in tables for name in ("tensile_strength", "traction_opening"))


def _get(table: Any, name: str) -> Any:
    return table.get(name) if isinstance(table, dict) else getattr(table, name, None)


def _filled(table: Any, defaults: dict[str, Any]) -> Any:
    """A table, raw or made already, with defaults for what it was not given."""
    if isinstance(table, dict):
        return defaults | table
    if not isinstance(table, BaseModel):
        return table  # wrong, and told so by its own check
    return table.model_copy(
        update={name: value for name, value in defaults.items() if name not in table.model_fields_set}
    )


def curve_key() -> Any:
    """The key ``traction_opening``."""
    return key(None, remedy="Give pairs of opening and traction, from [0.0, f_t] to [w_c, 0.0].")
