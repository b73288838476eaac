"""A region of bonds that a run finds by itself: deck table ``[adaptive]``, for regions with ``model = "auto"``."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal

from pdfem_mpi.deck.materials import BOND_POISSONS_RATIO, Material, all_materials
from pdfem_mpi.deck.meshes import Mesh
from pdfem_mpi.deck.peridynamics import Coupling, Peridynamics
from pdfem_mpi.deck.regions import Region
from pdfem_mpi.deck.table import FieldMissing, Problem, Table, key, show

AUTO = "auto"
#: The region that ``regions = "auto"`` stands for.
WHOLE_BODY = {"name": "body", "model": AUTO}
#: Regions that can be told apart in one byte, each with three kinds of cells.
MOST_REGIONS = 80
#: Stretches foretold by elements are right to 8.5 % with "virial", and to 16.5 % with the paper's correction.
THRESHOLDS = {"virial": 0.8}
OTHER_THRESHOLD = 0.75


class Adaptive(Table):
    """Where bonds are needed and when there must be more of them; deck table ``[adaptive]``.

    Attributes
    ----------
    threshold : float or None, above 0 and below 1, dimension 1
        A place may break next from this fraction of its critical stretch on, as the displacements of elements foretell
        it. None (default): 0.8 with ``surface_correction = "virial"``, else 0.75.
    reach : float, >= 1, dimension 1
        Bonds that may fail must surround such places, and all broken bonds, this far; in internal lengths.
    growth : float, dimension 1
        Where they do not, everything this near is turned into bonds; above ``reach``, in internal lengths. 0: the
        region stays as it was found at first, and the run ends where that does not do.
    buffer_layers : int, 1 to 10
        Layers of cells around them whose bonds may not fail.
    max_bonds : float, > 0, dimension 1
        A region with more of them ends the run.
    widening_check : bool or "peak"
        At the first break, solve once more with a region that is three times as wide, and report what that changes.
        "peak": again at each load of a next break that is 1 % above all those before.
    pilot : str or None
        Run folder of the same body on coarser cells: what is near its broken bonds is turned from the beginning.
    pilot_distance : float or None, > 0, dimension length
        How near. None (default): ``reach`` and one, in internal lengths of that run.
    """

    threshold: float | None = key(None, gt=0, lt=1, dimension="1")
    reach: float = key(1.5, ge=1, le=1000, dimension="1")
    growth: float = key(4.0, ge=0, le=1000, dimension="1")
    buffer_layers: int = key(2, ge=1, le=10)
    max_bonds: float = key(1.0e9, gt=0, dimension="1")
    widening_check: bool | Literal["peak"] = key(True)
    pilot: str | None = key(None, min_length=1)
    pilot_distance: float | None = key(None, gt=0, dimension="length")

    def problems(self) -> list[Problem]:
        """Growth beyond the reach, a distance from something."""
        problems = []
        if 0.0 < self.growth <= self.reach:
            text = f"= {show(self.growth)} is not above reach = {show(self.reach)}: switches would be many. Use"
            problems.append(Problem("growth", f"{text} about {4.0 * self.reach:g}, or 0 for a region that stays."))
        if self.pilot_distance is not None and self.pilot is None:
            text = f"= {show(self.pilot_distance)} is from the broken bonds of a pilot run. Give pilot, or remove it."
            problems.append(Problem("pilot_distance", text))
        return problems

    def threshold_with(self, surface_correction: str) -> float:
        """The threshold, by default that of the correction."""
        if self.threshold is not None:
            return self.threshold
        return THRESHOLDS.get(surface_correction, OTHER_THRESHOLD)


def with_auto(data: Any) -> Any:
    """The tables of a scene, ``regions = "auto"`` written out, and the table that automatic regions go by."""
    if not isinstance(data, dict):
        return data
    if data.get("regions") == AUTO:
        data = data | {"regions": (dict(WHOLE_BODY),)}
    regions = data.get("regions")
    if data.get("adaptive") is None and isinstance(regions, tuple | list) and any(map(_is_auto, regions)):
        data = data | {"adaptive": {}}
    return data


def _is_auto(region: Any) -> bool:
    return (region.get("model") if isinstance(region, dict) else getattr(region, "model", None)) == AUTO


def check_auto_regions(regions: Sequence[Region], adaptive: Adaptive | None) -> list[Problem]:
    """Which regions go together, and with the table."""
    models = [region.model for region in regions]
    if AUTO not in models:
        problems = [
            Problem(f"regions.{k}.always_elements", f'= true, and model = "{region.model}" says so or not. Remove it.')
            for k, region in enumerate(regions)
            if region.always_elements
        ]
        if adaptive is not None:
            text = 'is of regions with model = "auto", and there is none. Remove it, or set regions = "auto".'
            problems.append(Problem("adaptive", text))
        return problems
    problems = [
        Problem(
            f"regions.{k}.model",
            '= "peridynamics" beside regions with "auto", which find where bonds are needed. Use "auto" or '
            '"finite_elements".',
        )
        for k, model in enumerate(models)
        if model == "peridynamics"
    ]
    if all(region.always_elements or region.model != AUTO for region in regions):
        problems.append(Problem("regions", 'leave no cell to "auto": all are always elements. Leave some.'))
    if len(regions) > MOST_REGIONS:
        problems.append(
            Problem("regions", f'are {len(regions)}, and at most {MOST_REGIONS} go with "auto". Join some of them.')
        )
    return problems


def check_auto_settings(
    regions: Sequence[Region],
    peridynamics: Peridynamics,
    coupling: Coupling,
    mesh: Mesh,
    stepping: Any,
    solver: Any,
    temperature: Any,
) -> list[Problem]:
    """What does not go with a region that is found: each by its name, with what to do."""
    if not _has_auto(regions):
        return []
    times = getattr(stepping, "times", None)
    wrong = [
        (peridynamics.surface_correction == "fitted", "peridynamics.surface_correction", '= "fitted"',
         "it would be fitted anew at every switch", 'Use "virial"'),
        (coupling.kind != "paper", "coupling.kind", f"= {show(coupling.kind)}",
         "it is wrong by per cents around a small region", 'Use "paper"'),
        (peridynamics.kinematics != "linear", "peridynamics.kinematics",
         '= "finite"' if peridynamics.kinematics else 'is "finite" where it is not given, and that',
         "it has no criterion for what breaks next", 'Set it to "linear"'),
        (stepping.kind == "ramp", "stepping.kind", '= "ramp"', "it has velocities, which no element knows of",
         'Use "events" or "steps"'),
        (times is not None, "stepping.times", f"= {show(times)}",
         "a region that was found on the way there is not looked for on the way back", "Remove them"),
        (solver.kind != "cg", "solver.kind", f"= {show(solver.kind)}", "it cannot begin from an interpolated field",
         'Use "cg"'),
        (getattr(mesh, "doubled_nodes", "refuse") != "refuse", "mesh.doubled_nodes", '= "crack"',
         "it is a crack that the displacements of elements jump at", "Use [[cracks]]"),
        (temperature is not None, "temperature", "", "bonds that break have no thermal strain", "Remove it"),
    ]  # fmt: skip
    return [
        Problem(where, f'{value} does not go with regions of model = "auto": {why}. {remedy}.'.lstrip())
        for is_wrong, where, value, why, remedy in wrong
        if is_wrong
    ]


def check_auto_materials(
    regions: Sequence[Region], material: Material, materials: dict[str, Material]
) -> list[Problem]:
    """Cells can be turned where elements and bonds have the same Poisson's ratio."""
    if not _has_auto(regions):
        return []
    tables = all_materials(material, materials)
    problems = []
    for name in dict.fromkeys(region.material for region in regions if region.model == AUTO):
        if name not in tables or tables[name][1].poissons_ratio == BOND_POISSONS_RATIO:
            continue
        where, table = tables[name]
        text = f'= {show(table.poissons_ratio)} is not {BOND_POISSONS_RATIO:g}, and cells of model = "auto" are turned '
        remedy = "where elements and bonds alone have the same. Use 0.25, or draw the regions yourself."
        problems.append(Problem(f"{where}.poissons_ratio", text + remedy))
    return problems


def check_auto_references(
    regions: Sequence[Region], loads: Sequence[Any], supports: Sequence[Any], ties: Sequence[Any]
) -> list[Problem]:
    """Supported and loaded cells stay elements: a support must not take all of a region."""
    auto = {region.name for region in regions if region.model == AUTO and not region.always_elements}
    return [
        Problem(
            f"{table}.{k}.region",
            f'= {show(entry.region)} has model = "auto": what is held or loaded stays elements, and none of it could '
            "be turned. Choose by face, box or set.",
        )
        for table, entries in (("supports", supports), ("loads", loads), ("ties", ties))
        for k, entry in enumerate(entries)
        if getattr(entry, "region", None) in auto and getattr(entry, "kind", None) != "body_force"
    ]


def _has_auto(regions: Sequence[Region]) -> bool:
    models = [getattr(region, "model", None) for region in regions]
    if AUTO not in models and None in models:
        raise FieldMissing("model")  # a partial scene does not tell
    return AUTO in models
