"""Which part of the body is described how: deck table ``[[regions]]``."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal

from pdfem_mpi.deck.materials import (
    DEFAULT_MATERIAL,
    LEAST_BOND_RATIO,
    MOST_BOND_RATIO,
    Interface,
    Material,
    all_materials,
    unknown_names,
)
from pdfem_mpi.deck.meshes import corner_problems
from pdfem_mpi.deck.table import FieldMissing, Problem, Table, Vector, key, show

MOST_REGIONS = 255  # classes of bonds are stored in one byte a cluster


class Region(Table):
    """Cells described by one model; deck tables ``[[regions]]``.

    Attributes
    ----------
    name : str
        Loads, supports and probes refer to the region by it.
    model : "finite_elements", "peridynamics" or "auto"
        Elements; bonds that can break; or elements, and bonds where the run finds that they are needed (`[adaptive]`).
    material : str
        Name of a table [materials.NAME]; "default" (the default) is the table [material].
    lower, upper : three floats or None, dimension length
        The cells whose centroid lies in this closed box; None (default) sets no limit on that side.
    centre : three floats or None, dimension length
        Of a ball, or a point of a cylinder's axis.
    radius : float or None, > 0, dimension length
        Both or none: only the cells whose centroid lies in this closed ball. Regions with a radius take their cells
        out of those without.
    axis : "x", "y", "z" or None
        With a radius: a cylinder about this axis instead of a ball.
    may_fail : bool or None
        False: bonds with an end in this region never break. None (default): they may, but for those between two points
        of the overlap, which follow element nodes. True: these too, which a run warns of.
    always_elements : bool
        With "auto": the cells of this region are never turned into bonds.
    set : str or None
        Or the cells of a named set of the mesh file.
    """

    name: str = key(min_length=1, remedy="Give the region a name that loads and supports can refer to.")
    model: Literal["finite_elements", "peridynamics", "auto"] = key(remedy="Give the model that describes its cells.")
    material: str = key(DEFAULT_MATERIAL)
    lower: Vector | None = key(None, dimension="length")
    upper: Vector | None = key(None, dimension="length")
    centre: Vector | None = key(None, dimension="length")
    radius: float | None = key(None, gt=0, dimension="length")
    axis: Literal["x", "y", "z"] | None = key(None)
    may_fail: bool | None = key(None)
    always_elements: bool = key(False)
    set: str | None = key(None)

    def problems(self) -> list[Problem]:
        """Corners in order, a whole ball or cylinder, and one way to choose cells."""
        problems = corner_problems(self.lower, self.upper)
        if self.set is not None and (self.lower, self.upper, self.centre, self.radius) != (None,) * 4:
            problems.append(
                Problem("set", f"= {show(self.set)} chooses cells, and so do lower, upper or radius. Keep one of them.")
            )
        if (self.centre is None) != (self.radius is None):
            given, other = ("centre", "radius") if self.radius is None else ("radius", "centre")
            problems.append(Problem(given, f"= {show(getattr(self, given))} needs a {other}. Add it."))
        if self.axis is not None and self.radius is None:
            problems.append(Problem("axis", f'= "{self.axis}" is that of a cylinder. Add centre and radius.'))
        return problems


def can_have_bonds(region: Region) -> bool:
    """Whether some of a region's cells may be described by bonds."""
    return region.model == "peridynamics" or (region.model == "auto" and not region.always_elements)


def has_model(regions: Sequence[Region], model: str) -> bool:
    """Whether some region may have cells of this model; those with "auto" may have both."""
    models = [getattr(region, "model", None) for region in regions]
    found = model in models or "auto" in models
    if not found and (None in models or not models):
        raise FieldMissing("model")  # a partial scene does not tell
    return found


def check_poissons_ratio(
    material: Material, materials: dict[str, Material], regions: Sequence[Region]
) -> list[Problem]:
    bonded = {
        getattr(region, "material", None)
        for region in regions
        if getattr(region, "model", None) in ("peridynamics", "auto")
    }
    return [
        Problem(
            f"{where}.poissons_ratio",
            f"= {show(table.poissons_ratio)} is out of range for bonds, which bear {LEAST_BOND_RATIO:g} to "
            f"{MOST_BOND_RATIO:g}. Use a number in it, or describe every region of this material by finite_elements.",
        )
        for name, (where, table) in all_materials(material, materials).items()
        if name in bonded and not LEAST_BOND_RATIO <= table.poissons_ratio <= MOST_BOND_RATIO
    ]


def check_region_materials(
    material: Material, materials: dict[str, Material], regions: Sequence[Region]
) -> list[Problem]:
    """Every region has a material, and every material a region."""
    if not regions:
        return []
    tables = all_materials(material, materials)
    problems = unknown_names([(f"regions.{k}.material", region.material) for k, region in enumerate(regions)], tables)
    if problems:  # a misspelt name may be the missing use of another
        return problems
    used = {region.material for region in regions}
    for name, (where, _) in tables.items():
        if name not in used:
            remedy = (
                f'Give a region material = "{name}", or remove the table.'
                if name != DEFAULT_MATERIAL
                else "Let a region without the key material use it: write the values of another material there."
            )
            problems.append(Problem(where, f"is the material of no region. {remedy}"))
    return problems


def check_interfaces(
    material: Material, materials: dict[str, Material], regions: Sequence[Region], interfaces: Sequence[Interface]
) -> list[Problem]:
    if not interfaces:
        return []
    if not has_model(regions, "peridynamics"):
        return [Problem("interfaces", "are of bonds, and no region has any. Remove them.")]
    tables = all_materials(material, materials)
    first: dict[frozenset[str], int] = {}
    problems = []
    for index, interface in enumerate(interfaces):
        where = f"interfaces.{index}.between"
        problems += unknown_names([(where, name) for name in interface.between], tables)
        pair = frozenset(interface.between)
        if pair in first:
            problems.append(
                Problem(where, f"= {show(interface.between)} is there already as interfaces.{first[pair]}. Keep one.")
            )
        first.setdefault(pair, index)
    return problems


def check_region_names(regions: Sequence[Region]) -> list[Problem]:
    problems = repeated_names("regions", regions)
    if len(regions) > MOST_REGIONS:
        text = f"are {len(regions)}, and at most {MOST_REGIONS} can be told apart. Join some of them."
        problems.append(Problem("regions", text))
    return problems


def repeated_names(table: str, items: Sequence[Any]) -> list[Problem]:
    first: dict[str, int] = {}
    problems = []
    for index, item in enumerate(items):
        name = getattr(item, "name", None)
        if name is None:
            continue
        if name in first:
            problems.append(
                Problem(
                    f"{table}.{index}.name",
                    f"= {show(name)} is the name of {table}.{first[name]} already. Choose another name.",
                )
            )
        first.setdefault(name, index)
    return problems
