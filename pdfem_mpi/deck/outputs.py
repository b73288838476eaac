"""What a run tells: deck tables ``[[probes]]``, ``[output]`` and ``[checkpoint]``."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Annotated, Any, Literal

from pydantic import Field, SkipValidation

from pdfem_mpi.deck.field_names import FIELDS, GAUSS_FIELDS, MECHANICAL_FIELDS, field_problems, is_list_of_names
from pdfem_mpi.deck.mechanical_probes import (
    PLACE_FIELDS,
    CutProbe,
    EnergyReleaseProbe,
    PointProbe,
    SetProbe,
    names_problems,
)
from pdfem_mpi.deck.meshes import Mesh
from pdfem_mpi.deck.opening_probe import OpeningProbe
from pdfem_mpi.deck.regions import Region, has_model, repeated_names
from pdfem_mpi.deck.table import Problem, Table, Vector, key, show

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

    Attributes
    ----------
    name : str
        Of the columns, and of the entry in summary.json.
    point : three floats, dimension length
        Where it is at rest, inside of the body or on its surface.
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
        Along which the bar is pulled.
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
    fields : names
        Mechanical fields beside the displacement; see `PointProbe`.
    """

    kind: Literal["line"]
    name: str = key(min_length=1, remedy="Give the probe a name; its file is called by it.")
    start: Vector = key(dimension="length", remedy="Give the first point, for example [-4.5, -1.5, 0.0].")
    stop: Vector = key(dimension="length", remedy="Give the last point, for example [4.5, -1.5, 0.0].")
    n: int = key(101, ge=2, le=100_000)
    fields: SkipValidation[tuple[str, ...]] = key(("displacement",))

    def problems(self) -> list[Problem]:
        """A name that a file can have, two different ends, names of fields."""
        problems = names_problems(self.fields, PLACE_FIELDS)
        if not re.fullmatch(r"[A-Za-z0-9_-]+", self.name):
            problems.append(Problem("name", f"= {show(self.name)} names a file. Use letters, digits, - and _ only."))
        if self.start == self.stop:
            problems.append(Problem("stop", f"= {show(self.stop)} is the start as well. Give another end."))
        return problems


Probe = Annotated[
    DisplacementProbe | BarProbe | LineProbe | PointProbe | SetProbe | CutProbe | EnergyReleaseProbe | OpeningProbe,
    Field(discriminator="kind"),
]


class Output(Table):
    """What is written beside the summary and the history; deck table ``[output]``.

    Attributes
    ----------
    fields : bool, or names
        ``points.vtkhdf`` and ``elements.vtkhdf``: false writes neither, true (default) the displacement, a list the
        fields that it names (``docs/results.md`` says what each is).
    body : bool
        ``body.vtkhdf`` too, all cells in one file, where there is peridynamics.
    every : int, >= 1
        A frame of the fields at every so many rows of the history, and at the last.
    figures : bool
        Draw figures at the end of the run.
    damage : bool
        Local damage of the peridynamic points (eq. 5) in ``points.vtkhdf``, its mean over a cell in ``body.vtkhdf``;
        the same as ``"damage"`` in a list.
    """

    fields: SkipValidation[bool | tuple[str, ...]] = key(True)
    body: bool = key(True)
    every: int = key(1, ge=1)
    figures: bool = key(True)
    damage: bool = key(False)

    @property
    def names(self) -> tuple[str, ...]:
        """The fields that are written, in the order of `FIELDS`."""
        chosen = self.fields if is_list_of_names(self.fields) else ("displacement",) if self.fields is True else ()
        return tuple(name for name in FIELDS if name in chosen or (name == "damage" and self.damage))

    @property
    def has_damage(self) -> bool:
        """Whether local damage is written."""
        return "damage" in self.names

    @property
    def mechanical(self) -> tuple[str, ...]:
        """Those of `names` that follow from strain and stress."""
        return tuple(name for name in self.names if name in MECHANICAL_FIELDS + GAUSS_FIELDS)

    def problems(self) -> list[Problem]:
        """Names of fields, a file for the damage to stand in, and frames to count."""
        if not isinstance(self.fields, bool) and not is_list_of_names(self.fields):
            remedy = 'Use a list like ["displacement", "stress"], or true or false.'
            return [Problem("fields", f"= {show(self.fields)} is not true or false or a list of names. {remedy}")]
        problems = [] if isinstance(self.fields, bool) else field_problems("fields", self.fields)
        if self.damage and not self.fields:
            problems += [Problem("damage", "= true is a field, and fields = false writes none. Change one of the two.")]
        if self.every != 1 and not self.fields:
            text = f"= {self.every} counts frames of fields, and fields = false writes none. Remove it."
            problems += [Problem("every", text)]
        return problems


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
    if not output.has_damage or has_model(regions, "peridynamics"):
        return []
    if output.damage:
        return [Problem("output.damage", "= true counts broken bonds, and no region has any. Remove it.")]
    return [Problem("output.fields", 'has "damage", which counts broken bonds, and no region has any. Remove it.')]


def check_column_names(*tables: Sequence[Any]) -> list[Problem]:
    """Columns of history.csv are called by names of probes, supports, loads, springs and ties: each is there once."""
    first: dict[str, str] = {}
    problems = []
    for table, items in zip(("probes", "supports", "loads", "springs", "ties"), tables, strict=True):
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
