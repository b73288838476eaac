"""What acts on the body: deck tables ``[[loads]]`` and ``[[supports]]``."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any, Literal

from pydantic import Field

from pdfem_mpi.deck.displacements import Affine, Amounts, Rotation, Torsion
from pdfem_mpi.deck.face_loads import Pressure, Traction, one_of
from pdfem_mpi.deck.formulas import formula_problems, names_in
from pdfem_mpi.deck.meshes import Mesh, corner_problems
from pdfem_mpi.deck.regions import Region
from pdfem_mpi.deck.table import AXES, MOST_HINTS, Face, Problem, Table, Vector, did_you_mean, key, plain_name, show


class Selection(Table):
    """Cells chosen by one of: a region, layers beneath a face of the bounding box, a named set of the file, a box.

    Attributes
    ----------
    region : str or None
        The cells of the region of this name.
    face : "x-", "x+", "y-", "y+", "z-", "z+" or None
        Or ``layers`` layers of cells beneath this face of the bounding box.
    set : str or None
        Or a named set of the mesh file: its cells, or ``layers`` layers of cells beneath its faces.
    layers : int, >= 1
        How many layers of cells, beneath a face or a set of faces.
    lower, upper : three floats or None, dimension length
        Or the cells whose centroid lies in this closed box; None sets no limit on that side.
    """

    region: str | None = key(None)
    face: Face | None = key(None)
    set: str | None = key(None)
    layers: int = key(1, ge=1)
    lower: Vector | None = key(None, dimension="length")
    upper: Vector | None = key(None, dimension="length")

    def problems(self) -> list[Problem]:
        """One selection, and layers only with a face."""
        return self._selection_problems(("region", "face", "set"))

    def _selection_problems(self, ways: tuple[str, ...]) -> list[Problem]:
        given = [name for name in ways if getattr(self, name) is not None]
        if self.lower is not None or self.upper is not None:
            given.append("lower/upper")
        problems = corner_problems(self.lower, self.upper, equal=True)
        if len(given) != 1:
            has = "none of them" if not given else " and ".join(given)
            problems.append(
                Problem("", f"must say where by exactly one of {', '.join(ways)} or lower/upper, and has {has}.")
            )
        elif self.face is None and self.set is None and self.layers != 1:
            problems.append(
                Problem("layers", f"= {self.layers} counts layers from a face, and there is no face. Add it.")
            )
        return problems


class BodyForce(Selection):
    """Force per volume on cells (b of eq. 1); a ``[[loads]]`` table with ``kind = "body_force"``.

    Attributes
    ----------
    density : three floats or None, dimension force / length^3
        Force per volume at load factor 1. Exactly one of density and total is given.
    total : three floats or None, dimension force
        The whole force at load factor 1, spread evenly over the volume.
    name : str or None
        Its force is in history.csv then: `NAME.force_x`, `NAME.force_y` and `NAME.force_z`. Messages and `--set` use
        it too.
    constant : bool
        It acts as a whole at any load factor, beside loads that grow: self-weight, a preload.
    """

    kind: Literal["body_force"]
    name: str | None = key(None)
    constant: bool = key(False)
    density: Vector | None = key(None, dimension="force / length^3")
    total: Vector | None = key(None, dimension="force")

    def problems(self) -> list[Problem]:
        """One selection, and one of density and total."""
        return super().problems() + one_of(self, "density", "total") + plain_name(self.name)


class Force(Table):
    """A force at a point, or spread evenly over a straight line; a ``[[loads]]`` table with ``kind = "force"``.

    Attributes
    ----------
    point : three floats or None, dimension length
        Where the force acts: the place that a support there takes. Exactly one of point and line is given.
    line : two points or None, dimension length
        Ends of the line that the force is spread over: the places that a support there takes.
    total : three floats, dimension force
        The whole force at load factor 1.
    name : str or None
        Its force is in history.csv then: `NAME.force_x`, `NAME.force_y` and `NAME.force_z`. Messages and `--set` use
        it too.
    constant : bool
        It acts as a whole at any load factor.
    """

    kind: Literal["force"]
    name: str | None = key(None)
    constant: bool = key(False)
    point: Vector | None = key(None, dimension="length")
    line: tuple[Vector, Vector] | None = key(None, dimension="length")
    total: Vector = key(dimension="force", remedy="Give the force, for example [0.0, -100.0, 0.0].")

    def problems(self) -> list[Problem]:
        """One place, and a line with a length."""
        problems = plain_name(self.name) + one_of(self, "point", "line")
        if self.line is not None and self.line[0] == self.line[1]:
            problems.append(Problem("line", f"= {show(self.line)} has no length. Give two ends, or use point."))
        return problems


Load = Annotated[BodyForce | Traction | Pressure | Force, Field(discriminator="kind")]


class Places(Selection):
    """Nodes and peridynamic points: those of cells, or narrower than a cell, on a line, at a point or in a box."""

    of: Literal["cells", "nodes"] = key("cells")
    point: Vector | None = key(None, dimension="length")
    line: tuple[Vector, Vector] | None = key(None, dimension="length")

    def problems(self) -> list[Problem]:
        """One selection."""
        problems = self._selection_problems(("region", "face", "set", "point", "line"))
        if self.of == "nodes" and self.lower is None and self.upper is None:
            problems.append(Problem("of", '= "nodes" goes with lower and upper. Add them, or remove it.'))
        if self.line is not None and self.line[0] == self.line[1]:
            problems.append(Problem("line", f"= {show(self.line)} has no length. Give two ends, or use point."))
        return problems


#: Keys of a support that say what all of its places do.
MOTIONS = ("rotation", "torsion", "affine")


class Support(Places):
    """Prescribed displacement components; deck tables ``[[supports]]``.

    Attributes
    ----------
    face, set
        Where, as for a body force. On finite elements a face or a set selects its nodes, on peridynamic cells the
        points of ``layers`` layers of cells beneath it.
    of : "cells" or "nodes"
        What ``lower`` and ``upper`` select: all that cells have whose centroid lies in the box, or the nodes and
        peridynamic points that lie in it themselves.
    point : three floats or None, dimension length
        Or the node at a point.
    line : two points or None, dimension length
        Or the nodes on a straight line: a roller or a pin. In peridynamic cells with an edge on
        the line it is one row of points, those nearest to it, on one side, that of lower coordinates unless another has
        cells along more of the line: it leaves the rotation about the line free.
    name : str or None
        Its force on the body is in history.csv then: ``NAME.force_x``, ``NAME.force_y`` and ``NAME.force_z``.
    x, y, z : float, formula or None, dimension length
        Prescribed components, reached at load factor 1; None (default) leaves a component free. A formula of ``x``,
        ``y`` and ``z`` (see `deck.formulas`) is taken times the load factor, unless it names that (``f``) itself.
    rotation, torsion, affine : tables or None
        Or what one of these says of the components.
    """

    name: str | None = key(None)
    x: float | str | None = key(None, dimension="length")
    y: float | str | None = key(None, dimension="length")
    z: float | str | None = key(None, dimension="length")
    rotation: Rotation | None = key(None)
    torsion: Torsion | None = key(None)
    affine: Affine | None = key(None)

    def problems(self) -> list[Problem]:
        """One selection, and something prescribed."""
        problems = super().problems() + plain_name(self.name)
        for name in AXES:
            if isinstance(amount := getattr(self, name), str):
                problems += formula_problems(name, amount)
        given = [name for name in (*AXES, *MOTIONS) if getattr(self, name) is not None]
        if not given:
            problems.append(Problem("", f"prescribes nothing. Give at least one of x, y and z, or {_or(MOTIONS)}."))
        motions = [name for name in given if name in MOTIONS]
        if motions and (len(motions) > 1 or set(given) & set(self.named_by(motions[0]))):
            text = (
                f"prescribes the same components by {' and '.join(given)}. Keep one of them, or make another support."
            )
            problems.append(Problem("", text))
        return problems

    def named_by(self, motion: str) -> list[str]:
        """Components that a rotation, torsion or affine displacement prescribes."""
        return [name for name, amount in zip(AXES, getattr(self, motion).amounts, strict=True) if amount is not None]

    @property
    def amounts(self) -> Amounts:
        """What is prescribed along x, y and z: a number, a formula, or None."""
        for motion in (self.rotation, self.torsion, self.affine):
            if isinstance(motion, dict):  # of a table that is wrong by itself: it prescribes something
                return "x", "y", "z"
            if motion is not None:
                pairs = zip((self.x, self.y, self.z), motion.amounts, strict=True)
                return tuple(own if other is None else other for own, other in pairs)
        return self.x, self.y, self.z

    @property
    def follows_factor(self) -> bool:
        """Whether a component is a formula of the load factor."""
        return any(isinstance(amount, str) and "f" in names_in(amount) for amount in self.amounts)


def _or(names: Sequence[str]) -> str:
    return ", ".join(names[:-1]) + f" or {names[-1]}"


def check_references(regions: Sequence[Region], loads: Sequence[Any]) -> list[Problem]:
    return unknown_regions("loads", regions, loads)


def check_support_references(regions: Sequence[Region], supports: Sequence[Any]) -> list[Problem]:
    return unknown_regions("supports", regions, supports)


def unknown_regions(table: str, regions: Sequence[Region], items: Sequence[Any]) -> list[Problem]:
    """Items of a table that speak of a region by a name that none has."""
    names = [region.name for region in regions]
    problems = []
    for index, item in enumerate(items):
        name = getattr(item, "region", None)
        if name is not None and name not in names:
            hint = did_you_mean(name, names) if len(problems) < MOST_HINTS else ""
            remedy = hint or f" The regions are {', '.join(names[:MOST_HINTS])}."
            problems.append(Problem(f"{table}.{index}.region", f"= {show(name)} is not the name of a region.{remedy}"))
    return problems


def check_sets(table: str, mesh: Mesh, items: Sequence[Any]) -> list[Problem]:
    if mesh.kind == "file":
        return []
    return [
        Problem(
            f"{table}.{index}.set",
            f'= {show(item.set)} names a set of a mesh file, and mesh.kind is "{mesh.kind}". '
            f"Choose by lower and upper{' or by face' if table != 'regions' else ''} instead.",
        )
        for index, item in enumerate(items)
        if getattr(item, "set", None) is not None
    ]


def check_mirrored_loads(mesh: Mesh, loads: Sequence[Any]) -> list[Problem]:
    """A mirror plane is inside of the whole body: nothing pulls at it."""
    return [
        Problem(
            f"loads.{index}.face",
            f'= "{load.face}" is a mirror plane (mesh.symmetry = {show(mesh.symmetry)}), which lies inside of the '
            "whole body. Pull at another face, or remove the mirror.",
        )
        for index, load in enumerate(loads)
        if isinstance(load, Traction | Pressure) and load.face in mesh.symmetry
    ]


def check_mirrored_supports(mesh: Mesh, supports: Sequence[Any]) -> list[Problem]:
    """A mirror plane stays where it is."""
    return [
        Problem(
            f"supports.{index}.{support.face[0]}",
            f'= {show(_across(support))} moves the mirror plane "{support.face}" (mesh.symmetry = '
            f"{show(mesh.symmetry)}). Remove it, or the mirror.",
        )
        for index, support in enumerate(supports)
        if getattr(support, "face", None) in mesh.symmetry and _across(support)
    ]


def _across(support: Support) -> float | str | None:
    """What a support on a face prescribes normal to it."""
    return support.amounts[AXES.index(support.face[0])]
