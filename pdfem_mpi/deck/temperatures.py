"""A change of temperature, which strains what has a coefficient of expansion; deck table ``[temperature]``."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from pdfem_mpi.deck.formulas import formula_problems, names_in
from pdfem_mpi.deck.materials import Interface, Material, all_materials
from pdfem_mpi.deck.peridynamics import Peridynamics
from pdfem_mpi.deck.regions import can_have_bonds
from pdfem_mpi.deck.softening import CRITERION
from pdfem_mpi.deck.table import Problem, Table, key, show


class Temperature(Table):
    """The change of temperature at load factor 1; deck table ``[temperature]``.

    Attributes
    ----------
    change : float or None, dimension temperature
        The same everywhere.
    formula : str or None
        Of ``x``, ``y`` and ``z`` (see ``deck/formulas.py``), evaluated at the points of cells.
    file : str or None
        A .vtu file with temperatures at the nodes of the mesh; relative to the deck.
    field : str
        The file's array of point data.
    scale : float, > 0
        Multiplies the file's coordinates, as ``mesh.scale``.
    reference : float, dimension temperature
        Temperature at which nothing is strained; subtracted from the file's numbers.
    """

    change: float | None = key(None, dimension="temperature")
    formula: str | None = key(None, min_length=1)
    file: str | None = key(None, min_length=1)
    field: str = key("temperature", min_length=1)
    scale: float = key(1.0, gt=0)
    reference: float = key(0.0, dimension="temperature")

    def problems(self) -> list[Problem]:
        """One of change, formula and file."""
        given = [name for name in ("change", "formula", "file") if getattr(self, name) is not None]
        if len(given) != 1:
            has = " and ".join(given) or "none of them"
            return [Problem("", f"must have exactly one of change, formula and file, and has {has}. Keep one.")]
        if self.formula is not None:
            if problems := formula_problems("formula", self.formula):
                return problems
            if "f" in names_in(self.formula):
                text = f"= {show(self.formula)} has f, and the change grows with the load factor by itself. Remove f."
                return [Problem("formula", text)]
        if self.file is not None and not self.file.lower().endswith(".vtu"):
            return [Problem("file", f"= {show(self.file)} is not a .vtu file. Write the temperatures as one.")]
        if self.file is None and self.reference != 0.0:
            text = f"= {show(self.reference)} is subtracted from a file's temperatures, and there is no file."
            return [Problem("reference", f"{text} Remove it; change is a difference.")]
        return []


def check_temperature(
    temperature: Any,
    material: Material,
    materials: dict[str, Material],
    interfaces: Sequence[Interface],
    peridynamics: Peridynamics,
    regions: Any,
) -> list[Problem]:
    """Something that expands, in linear kinematics, of bonds that do not break."""
    if temperature is None:
        return []
    tables = all_materials(material, materials)
    problems = []
    if all(table.thermal_expansion is None for _, table in tables.values()):
        text = "strains nothing: no material has a coefficient of expansion. Give material.thermal_expansion."
        problems.append(Problem("temperature", text))
    bonds = any(can_have_bonds(region) for region in regions)
    if (peridynamics.kinematics or ("finite" if bonds else "linear")) == "finite":
        text = 'strains bodies in linear kinematics alone. Use peridynamics.kinematics = "linear", or remove it.'
        problems.append(Problem("temperature", text))
    across = [(f"interfaces.{index}", interface) for index, interface in enumerate(interfaces)]
    for where, table in (*tables.values(), *across):
        if bonds and table.can_fail:
            name = next(name for name in CRITERION if getattr(table, name) is not None)
            text = "breaks bonds by their whole stretch, which a temperature would be a part of. Remove one of the two."
            problems.append(Problem(f"{where}.{name}", text))
    return problems
