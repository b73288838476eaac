"""Probes of strain and stress: at a point, over a set of cells, and what a plane through the body carries."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Literal

from pydantic import SkipValidation

from pdfem_mpi.deck.field_names import MECHANICAL_FIELDS, field_problems, is_list_of_names
from pdfem_mpi.deck.loads import Selection, unknown_regions
from pdfem_mpi.deck.materials import Material
from pdfem_mpi.deck.regions import Region
from pdfem_mpi.deck.table import Problem, Table, Vector, key, show

#: Corners within this fraction of a crack's extent of the farthest are its front.
FRONT = 1e-6
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
        Its results are listed under it.
    point : three floats, dimension length
        Not outside of the body. Read in the cell that holds it: of elements by the functions through its Gauss points,
        of bonds the cell's mean.
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

    The mean displacement is also in history.csv: ``NAME.u_x``, ``NAME.u_y`` and ``NAME.u_z``.

    Attributes
    ----------
    name : str
        Its results are listed under it.
    region, face, set, layers, lower, upper
        The cells: a region's name; ``layers`` layers of cells beneath a face; a named set of the mesh file; or the
        cells whose centroid lies in the closed box.
    fields : names
        Of the displacement (its mean over the volume alone) and the mechanical fields.
    """

    kind: Literal["set"]
    name: str = key(min_length=1, remedy="Give the probe a name; results are listed under it.")
    fields: SkipValidation[tuple[str, ...]] = key(("stress",))

    def problems(self) -> list[Problem]:
        """One selection, and names of fields."""
        return super().problems() + names_problems(self.fields, PLACE_FIELDS)

    @property
    def recovered(self) -> tuple[str, ...]:
        """Fields that follow from strain and stress."""
        return tuple(name for name in self.fields if name != "displacement")


class CutProbe(Table):
    """Force and moment that a plane through the body carries; a ``[[probes]]`` table with ``kind = "cut"``.

    Attributes
    ----------
    name : str
        Its results are listed under it.
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


class EnergyReleaseProbe(Table):
    """Energy release rate of an initial crack by stiffness at two lengths; ``kind = "energy_release"``.

    The run solves the body once more at its end, with the crack longer by ``extension``; the rate is that halfway.

    Attributes
    ----------
    name : str
        Its results are listed under it.
    crack : int, >= 0
        Number of the crack among ``[[cracks]]``, whose corners farthest along ``direction`` are its front.
    direction : three floats, not all 0
        In the plane of the crack, normal to its front: where it would grow.
    extension : float or None, > 0, dimension length
        By how much the crack is longer the second time. None (default): the extent of the cells at
        the front along ``direction``.
    width : float or None, > 0, dimension length
        Length of the front within the body that is modelled; None (default): the body's extent along the front.
    state : "plane_strain" or "plane_stress"
        For the stress intensity factor, ``K^2 = G E'``.
    """

    kind: Literal["energy_release"]
    name: str = key(min_length=1, remedy="Give the probe a name; results are listed under it.")
    crack: int = key(0, ge=0)
    direction: Vector = key(dimension="1", remedy="Give the direction of growth, for example [1.0, 0.0, 0.0].")
    extension: float | None = key(None, gt=0, dimension="length")
    width: float | None = key(None, gt=0, dimension="length")
    state: Literal["plane_strain", "plane_stress"] = key("plane_strain")

    def problems(self) -> list[Problem]:
        """A direction."""
        if any(self.direction):
            return []
        text = f"= {show(self.direction)} has no direction. Give one, for example [1.0, 0.0, 0.0]."
        return [Problem("direction", text)]


def check_energy_release(
    cracks: Sequence[Any],
    material: Material,
    materials: dict[str, Material],
    interfaces: Sequence[Any],
    temperature: Any,
    probes: Sequence[Any],
) -> list[Problem]:
    """A crack that is there, of a polygon with a straight front, in a body that keeps its bonds and its temperature."""
    problems = []
    for index, probe in enumerate(probes):
        if not isinstance(probe, EnergyReleaseProbe):
            continue
        where = f"probes.{index}"
        if probe.crack >= len(cracks):
            text = f"= {probe.crack} is not the number of a crack: there are {len(cracks)}, counted from 0."
            problems.append(Problem(f"{where}.crack", f"{text} Correct it."))
        elif getattr(cracks[probe.crack], "polygon", None) is None:
            problems.append(Problem(f"{where}.crack", f"= {probe.crack} is no polygon. Give its corners as one."))
        elif len(front_of(cracks[probe.crack].polygon, probe.direction)) < 2:
            text = f"= {show(probe.direction)} ends at one corner of the crack. Give the normal of its straight front."
            problems.append(Problem(f"{where}.direction", text))
        if any(table.can_fail for table in (material, *materials.values(), *interfaces)):
            text = '= "energy_release" compares two bodies that keep their bonds. Remove critical_stretch and'
            problems.append(Problem(f"{where}.kind", f"{text} fracture_energy, or the probe."))
        if temperature is not None:
            text = '= "energy_release" is that of loads and supports. Remove the table [temperature], or the probe.'
            problems.append(Problem(f"{where}.kind", text))
    return problems


def front_of(corners: Sequence[Vector], direction: Vector) -> list[int]:
    """Numbers of the corners that lie farthest along a direction."""
    size = math.hypot(*direction) or 1.0
    along = [sum(c * d for c, d in zip(corner, direction, strict=True)) / size for corner in corners]
    extent = max(along) - min(along)
    return [k for k, place in enumerate(along) if place >= max(along) - FRONT * extent]


def check_set_probes(regions: Sequence[Region], probes: Sequence[Any]) -> list[Problem]:
    """Regions that are there."""
    return unknown_regions("probes", regions, probes)
