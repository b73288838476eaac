"""What a run tells: deck tables ``[[probes]]``, ``[output]`` and ``[checkpoint]``."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Annotated, Any, Literal

from pydantic import Field

from pdfem_mpi.deck.directions import no_direction, unit
from pdfem_mpi.deck.meshes import Mesh
from pdfem_mpi.deck.regions import Region, has_model, repeated_names
from pdfem_mpi.deck.table import Problem, Table, Vector, key, plain_name, show

#: Results of a bar probe, listed beside those of other probes.
BAR_RESULTS = (
    "end_displacement",
    "end_error_percent",
    "modulus_ratio_finite_elements",
    "modulus_ratio_peridynamics",
    "poissons_ratio_finite_elements",
    "poissons_ratio_peridynamics",
    "interface_jump",
)


class DisplacementProbe(Table):
    """Displacement at a named point; a ``[[probes]]`` table with ``kind = "displacement"``.

    Its columns in history.csv are ``NAME.u_x``, ``NAME.u_y`` and ``NAME.u_z``.
    """

    kind: Literal["displacement"]
    name: str = key(min_length=1, remedy="Give the probe a name; results are listed under it.")
    point: Vector = key(dimension="length", remedy="Give the point, for example [5.0, 0.0, 0.0].")

    def problems(self) -> list[Problem]:
        """A name on one line: columns are called by it."""
        if "\n" not in self.name and "\r" not in self.name:
            return []
        return [Problem("name", f"= {show(self.name)} has a line break, and columns are called by it. Take it out.")]


class BarProbe(Table):
    """Comparison with a uniform bar under tension; a ``[[probes]]`` table with ``kind = "bar"``.

    Attributes
    ----------
    axis : "x", "y" or "z"
    stress : float, not 0, dimension force / length^2
        Axial stress at load factor 1; the exact strain is ``stress / youngs_modulus``.
    """

    kind: Literal["bar"]
    axis: Literal["x", "y", "z"] = key("x")
    stress: float = key(dimension="force / length^2", remedy="Give force over cross section.")

    def problems(self) -> list[Problem]:
        """A stress to compare with."""
        if self.stress != 0.0:
            return []
        return [Problem("stress", "= 0.0 gives no elongation to compare with. Give force over area.")]


class LineProbe(Table):
    """Displacements along a straight line; a ``[[probes]]`` table with ``kind = "line"``.

    Attributes
    ----------
    name : str
        Of ``lines/NAME.csv`` and ``figures/line_NAME.png``; letters, digits, ``-`` and ``_``.
    start, stop : three floats, dimension length
        Ends of the line. Samples outside of the body are left empty.
    n : int, 2 to 100,000
        Samples, equally spaced, both ends included.
    """

    kind: Literal["line"]
    name: str = key(min_length=1, remedy="Give the probe a name; its file is called by it.")
    start: Vector = key(dimension="length", remedy="Give the first point, for example [-4.5, -1.5, 0.0].")
    stop: Vector = key(dimension="length", remedy="Give the last point, for example [4.5, -1.5, 0.0].")
    n: int = key(101, ge=2, le=100_000)

    def problems(self) -> list[Problem]:
        """A name that a file can have, and two different ends."""
        problems = []
        if not re.fullmatch(r"[A-Za-z0-9_-]+", self.name):
            problems.append(Problem("name", f"= {show(self.name)} names a file. Use letters, digits, - and _ only."))
        if self.start == self.stop:
            problems.append(Problem("stop", f"= {show(self.stop)} is the start as well. Give another end."))
        return problems


class OpeningProbe(Table):
    """How far two points move apart; a ``[[probes]]`` table with ``kind = "opening"``: a CMOD, for instance.

    Attributes
    ----------
    name : str
        Letters, digits, ``-`` and ``_``; the column is ``NAME.opening``.
    one, two : three floats, dimension length
        Points of the body, on both sides of a notch or a crack.
    direction : three floats or None
        The displacement of ``two`` less that of ``one`` is measured along it, whatever its length; None (default):
        along the line from ``one`` to ``two``.
    """

    kind: Literal["opening"]
    name: str = key(min_length=1, remedy="Give the probe a name; its column is called by it.")
    one: Vector = key(dimension="length", remedy="Give a point on one side, for example [3.9, 0.0, 0.0].")
    two: Vector = key(dimension="length", remedy="Give a point on the other side, for example [4.1, 0.0, 0.0].")
    direction: Vector | None = key(None, dimension="1")

    def problems(self) -> list[Problem]:
        """A name, and something between two points."""
        problems = plain_name(self.name)
        if self.one == self.two:
            text = f"= {show(self.two)} is the other point as well: an opening across nothing. Give another point."
            problems.append(Problem("two", text))
        return problems + (no_direction("direction", self.direction) if self.direction else [])

    @property
    def unit(self) -> Vector:
        """Unit vector that the opening is measured along."""
        return unit(self.direction or tuple(b - a for a, b in zip(self.one, self.two, strict=True)))


Probe = Annotated[DisplacementProbe | BarProbe | LineProbe | OpeningProbe, Field(discriminator="kind")]


class Output(Table):
    """What is written beside the summary and the history; deck table ``[output]``.

    Attributes
    ----------
    fields : bool
        ``points.vtkhdf`` and ``elements.vtkhdf``.
    figures : bool
    damage : bool
        Local damage of the peridynamic points (eq. 5) in ``points.vtkhdf``.
    """

    fields: bool = key(True)
    figures: bool = key(True)
    damage: bool = key(False)

    def problems(self) -> list[Problem]:
        """A file for the damage to stand in."""
        if self.damage and not self.fields:
            return [Problem("damage", "= true is a field, and fields = false writes none. Change one of the two.")]
        return []


class Checkpoint(Table):
    """When a run keeps its state on the disk, to go on from there; deck table ``[checkpoint]``.

    One is written at the end and on request as well.

    Attributes
    ----------
    minutes : float, > 0
        Between checkpoints, at most 5 % of the time.
    iterations : int or None, >= 1
        A checkpoint after so many relaxation iterations of a load step too.
    steps : int or None, >= 1
        A checkpoint after so many load steps or events too.
    keep : int, >= 2
        How many of the newest stay.
    """

    minutes: float = key(10.0, gt=0)
    iterations: int | None = key(None, ge=1)
    steps: int | None = key(None, ge=1)
    keep: int = key(3, ge=2)


def check_damage(output: Output, regions: Sequence[Region]) -> list[Problem]:
    if not output.damage or has_model(regions, "peridynamics"):
        return []
    return [Problem("output.damage", "= true counts broken bonds, and no region has any. Remove it.")]


def check_column_names(probes: Sequence[Any], supports: Sequence[Any], loads: Sequence[Any]) -> list[Problem]:
    """Columns of history.csv are called by names of probes, supports and loads: each is there once."""
    first: dict[str, str] = {}
    problems = []
    for table, items in (("probes", probes), ("supports", supports), ("loads", loads)):
        for index, item in enumerate(items):
            name, where = getattr(item, "name", None), f"{table}.{index}"
            other = first.setdefault(name, where) if name is not None else where
            if other.split(".")[0] != table or (other != where and table != "probes"):
                text = f"= {show(name)} is the name of {other} already, and columns are called by it. Choose another."
                problems.append(Problem(f"{where}.name", text))
    return problems


def check_probe_names(probes: Sequence[Any]) -> list[Problem]:
    problems = repeated_names("probes", probes)
    for index, probe in enumerate(probes):
        if getattr(probe, "name", None) in BAR_RESULTS:
            problems.append(
                Problem(f"probes.{index}.name", f'= "{probe.name}" is a result of bar probes. Choose another.')
            )
    bars = [index for index, probe in enumerate(probes) if isinstance(probe, BarProbe)]
    for index in bars[1:]:
        problems.append(
            Problem(f"probes.{index}.kind", f'= "bar" is there already as probes.{bars[0]}. Remove one of them.')
        )
    return problems


def check_mirrored_bars(mesh: Mesh, probes: Sequence[Any]) -> list[Problem]:
    """A bar is compared from its fixed middle, or both ends, to its upper end."""
    problems = []
    for index, probe in enumerate(probes):
        if not isinstance(probe, BarProbe) or f"{probe.axis}+" not in mesh.symmetry:
            continue
        both = f"{probe.axis}-" in mesh.symmetry
        why = "a bar between two mirrors has no end" if both else "the probe compares the upper end of the bar"
        remedy = "Remove the probe" if both else f'Model the other half, with the mirror at "{probe.axis}-"'
        problems.append(Problem(f"probes.{index}.axis", f'= "{probe.axis}" ends at a mirror plane: {why}. {remedy}.'))
    return problems
