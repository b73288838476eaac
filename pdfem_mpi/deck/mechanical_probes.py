"""Probes of strain and stress: at a point, over a set of cells, and what a plane through the body carries."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal

from pydantic import SkipValidation

from pdfem_mpi.deck.field_names import MECHANICAL_FIELDS, field_problems, is_list_of_names
from pdfem_mpi.deck.loads import Selection, unknown_regions
from pdfem_mpi.deck.regions import Region
from pdfem_mpi.deck.table import Problem, Table, Vector, key, show

#: What a point and a line can tell.
PLACE_FIELDS = ("displacement", *MECHANICAL_FIELDS)


def names_problems(names: Any, known: Sequence[str]) -> list[Problem]:
    """What is wrong with a probe's list of fields."""
    if not is_list_of_names(names) or not names:
        return [Problem("fields", f'= {show(names)} is not a list of names. Use a list like ["{known[-1]}"].')]
    return field_problems("fields", names, known)


class PointProbe(Table):
    """Fields at a named point; a ``[[probes]]`` table with ``kind = "point"``.

    Attributes
    ----------
    name : str
    point : three floats, dimension length
        In the cell that holds it: of elements by the functions through its Gauss points, of bonds the cell's mean.
    fields : names
        Of the displacement and the mechanical fields.
    """

    kind: Literal["point"]
    name: str = key(min_length=1, remedy="Give the probe a name; results are listed under it.")
    point: Vector = key(dimension="length", remedy="Give the point, for example [5.0, 0.0, 0.0].")
    fields: SkipValidation[tuple[str, ...]] = key(("displacement", "strain", "stress"))

    def problems(self) -> list[Problem]:
        """Names of fields."""
        return names_problems(self.fields, PLACE_FIELDS)


class SetProbe(Selection):
    """Means and extremes over a set of cells; a ``[[probes]]`` table with ``kind = "set"``.

    Attributes
    ----------
    name : str
    region, face, set, layers, lower, upper
        Where, as for a body force.
    fields : names
        Of the mechanical fields.
    """

    kind: Literal["set"]
    name: str = key(min_length=1, remedy="Give the probe a name; results are listed under it.")
    fields: SkipValidation[tuple[str, ...]] = key(("stress",))

    def problems(self) -> list[Problem]:
        """One selection, and names of fields."""
        return super().problems() + names_problems(self.fields, MECHANICAL_FIELDS)


class CutProbe(Table):
    """Force and moment that a plane through the body carries; a ``[[probes]]`` table with ``kind = "cut"``.

    Attributes
    ----------
    name : str
    point : three floats, dimension length
        A point of the plane, about which the moment counts.
    normal : three floats, not all 0
        The side it points to acts on the other.
    """

    kind: Literal["cut"]
    name: str = key(min_length=1, remedy="Give the probe a name; results are listed under it.")
    point: Vector = key(dimension="length", remedy="Give a point of the plane, for example [5.0, 0.0, 0.0].")
    normal: Vector = key(dimension="1", remedy="Give the normal of the plane, for example [1.0, 0.0, 0.0].")

    def problems(self) -> list[Problem]:
        """A direction."""
        if any(self.normal):
            return []
        return [Problem("normal", f"= {show(self.normal)} has no direction. Give one, for example [1.0, 0.0, 0.0].")]


def check_set_probes(regions: Sequence[Region], probes: Sequence[Any]) -> list[Problem]:
    """Regions that are there."""
    return unknown_regions("probes", regions, probes)
