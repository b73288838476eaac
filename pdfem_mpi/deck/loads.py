"""What acts on the body: deck tables ``[[loads]]`` and ``[[supports]]``."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any, Literal

from pydantic import BaseModel, Field

from pdfem_mpi.deck.meshes import Mesh, corner_problems
from pdfem_mpi.deck.peridynamics import Peridynamics
from pdfem_mpi.deck.regions import Region, has_model
from pdfem_mpi.deck.table import MOST_HINTS, Face, Problem, Table, Vector, did_you_mean, key, show


class Selection(Table):
    """Cells chosen by one of: a region, layers beneath a face of the bounding box, a named set of the file, a box."""

    region: str | None = key(None)
    face: Face | None = key(None)
    set: str | None = key(None)
    layers: int = key(1, ge=1)
    lower: Vector | None = key(None, dimension="length")
    upper: Vector | None = key(None, dimension="length")

    def problems(self) -> list[Problem]:
        """One selection, and layers only with a face."""
        given = [name for name in ("region", "face", "set") if getattr(self, name) is not None]
        if self.lower is not None or self.upper is not None:
            given.append("lower/upper")
        problems = corner_problems(self.lower, self.upper, equal=True)
        if len(given) != 1:
            has = "none of them" if not given else " and ".join(given)
            problems.append(
                Problem("", f"must say where by exactly one of region, face, set or lower/upper, and has {has}.")
            )
        elif self.face is None and self.set is None and self.layers != 1:
            problems.append(
                Problem("layers", f"= {self.layers} counts layers from a face, and there is no face. Add it.")
            )
        return problems


def _one_of(table: BaseModel, *names: str) -> list[Problem]:
    given = [name for name in names if getattr(table, name) is not None]
    if len(given) == 1:
        return []
    has = "both" if given else "neither"
    return [Problem("", f"must have either {' or '.join(names)}, and has {has}. Keep one.")]


class BodyForce(Selection):
    """Force per volume on cells (b of eq. 1); a ``[[loads]]`` table with ``kind = "body_force"``.

    Attributes
    ----------
    region, face, set, layers, lower, upper
        Where: a region's name; ``layers`` layers of cells beneath a face; a named set of the mesh file, its cells or
        ``layers`` layers of cells beneath its faces; or the cells whose centroid lies in the closed box.
    density : three floats or None, dimension force / length^3
    total : three floats or None, dimension force
        Exactly one of the two; both are reached at load factor 1.
    """

    kind: Literal["body_force"]
    density: Vector | None = key(None, dimension="force / length^3")
    total: Vector | None = key(None, dimension="force")

    def problems(self) -> list[Problem]:
        """One selection, and one of density and total."""
        return super().problems() + _one_of(self, "density", "total")


class Traction(Table):
    """Force per area on a face of finite elements; a ``[[loads]]`` table with ``kind = "traction"``.

    Attributes
    ----------
    face : "x-", "x+", "y-", "y+", "z-", "z+" or None
        Face of the bounding box.
    set : str or None
        Or a named set of faces, or of all nodes of faces, of the mesh file.
    traction : three floats or None, dimension force / length^2
    total : three floats or None, dimension force
        Exactly one of the two; both are reached at load factor 1.
    nodal : "consistent" or "equal"
        Nodal forces from the shape functions, or the same on every node ("uniform point forces", sec. 4.1).
    """

    kind: Literal["traction"]
    face: Face | None = key(None)
    set: str | None = key(None)
    traction: Vector | None = key(None, dimension="force / length^2")
    total: Vector | None = key(None, dimension="force")
    nodal: Literal["consistent", "equal"] = key("consistent")

    def problems(self) -> list[Problem]:
        """One of face and set, one of traction and total."""
        return _one_of(self, "face", "set") + _one_of(self, "traction", "total")


Load = Annotated[BodyForce | Traction, Field(discriminator="kind")]


class Support(Selection):
    """Prescribed displacement components; deck tables ``[[supports]]``.

    Attributes
    ----------
    region, face, set, layers, lower, upper
        Where, as for a body force. On finite elements a face or a set selects its nodes, on peridynamic cells the
        points of ``layers`` layers of cells beneath it.
    x, y, z : float or None, dimension length
        Prescribed components, reached at load factor 1; None (default) leaves a component free.
    """

    x: float | None = key(None, dimension="length")
    y: float | None = key(None, dimension="length")
    z: float | None = key(None, dimension="length")

    def problems(self) -> list[Problem]:
        """One selection, and something prescribed."""
        problems = super().problems()
        if self.x is None and self.y is None and self.z is None:
            problems.append(Problem("", "prescribes nothing. Give at least one of x, y and z."))
        return problems


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


def check_tractions(regions: Sequence[Region], peridynamics: Peridynamics, loads: Sequence[Any]) -> list[Problem]:
    if has_model(regions, "finite_elements") or peridynamics.surface_correction == "fitted":
        return []
    return [
        Problem(
            f"loads.{index}.kind",
            '= "traction" acts on finite elements, and no region has any. Use kind = "body_force" on the '
            "same face, as in sec. 4.1 of the paper.",
        )
        for index, load in enumerate(loads)
        if isinstance(load, Traction)
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
        if isinstance(load, Traction) and load.face in mesh.symmetry
    ]


def check_mirrored_supports(mesh: Mesh, supports: Sequence[Any]) -> list[Problem]:
    """A mirror plane stays where it is."""
    return [
        Problem(
            f"supports.{index}.{support.face[0]}",
            f'= {show(getattr(support, support.face[0]))} moves the mirror plane "{support.face}" (mesh.symmetry = '
            f"{show(mesh.symmetry)}). Remove it, or the mirror.",
        )
        for index, support in enumerate(supports)
        if getattr(support, "face", None) in mesh.symmetry and getattr(support, support.face[0])
    ]
