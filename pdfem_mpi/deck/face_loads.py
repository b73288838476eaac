"""Forces per area on faces of cells: ``[[loads]]`` tables with ``kind = "traction"`` and ``"pressure"``."""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel

from pdfem_mpi.deck.meshes import corner_problems
from pdfem_mpi.deck.table import Face, Problem, Table, Vector, key, plain_name


def one_of(table: BaseModel, *names: str) -> list[Problem]:
    """What is wrong where exactly one of some keys must be given."""
    given = [name for name in names if getattr(table, name) is not None]
    if len(given) == 1:
        return []
    has = "both" if given else "neither"
    return [Problem("", f"must have either {' or '.join(names)}, and has {has}. Keep one.")]


class _OnFaces(Table):
    """Faces of cells on the boundary, chosen by one of: a face of the bounding box, a set of the mesh file, a box."""

    name: str | None = key(None)
    constant: bool = key(False)
    face: Face | None = key(None)
    set: str | None = key(None)
    lower: Vector | None = key(None, dimension="length")
    upper: Vector | None = key(None, dimension="length")

    def problems(self) -> list[Problem]:
        """One selection."""
        given = [name for name in ("face", "set") if getattr(self, name) is not None]
        if self.lower is not None or self.upper is not None:
            given.append("lower/upper")
        problems = plain_name(self.name) + corner_problems(self.lower, self.upper, equal=True)
        if len(given) == 1:
            return problems
        has = "none of them" if not given else " and ".join(given)
        where = "must say where by exactly one of face, set or lower/upper"
        return [*problems, Problem("", f"{where}, and has {has}.")]

    @property
    def shown(self) -> str:
        """The selection, for messages."""
        if self.face is not None:
            return f"face = {self.face}"
        return f"set = {self.set}" if self.set is not None else "lower/upper"


class Traction(_OnFaces):
    """Force per area on faces of cells; a ``[[loads]]`` table with ``kind = "traction"``.

    Attributes
    ----------
    face : "x-", "x+", "y-", "y+", "z-", "z+" or None
        Face of the bounding box.
    set : str or None
        Or a named set of faces, or of all nodes of faces, of the mesh file.
    lower, upper : three floats or None, dimension length
        Or all faces of the boundary whose middle lies in this closed box; None sets no limit on that side.
    traction : three floats or None, dimension force / length^2
        Force per area at load factor 1. Exactly one of traction and total is given.
    total : three floats or None, dimension force
        The whole force at load factor 1, spread evenly over the area.
    nodal : "consistent" or "equal"
        Nodal forces from the shape functions, or the same on every node ("uniform point forces", sec. 4.1).
    name : str or None
        Its force is in history.csv then: `NAME.force_x`, `NAME.force_y` and `NAME.force_z`. Messages and `--set` use
        it too.
    constant : bool
        It acts as a whole at any load factor.
    """

    kind: Literal["traction"]
    traction: Vector | None = key(None, dimension="force / length^2")
    total: Vector | None = key(None, dimension="force")
    nodal: Literal["consistent", "equal"] = key("consistent")

    def problems(self) -> list[Problem]:
        """One selection, one of traction and total."""
        return super().problems() + one_of(self, "traction", "total")


class Pressure(_OnFaces):
    """Force per area normal to faces of cells, which pushes at them; a ``[[loads]]`` table with ``kind = "pressure"``.

    Attributes
    ----------
    face : "x-", "x+", "y-", "y+", "z-", "z+" or None
        Face of the bounding box.
    set : str or None
        Or a named set of faces, or of all nodes of faces, of the mesh file.
    lower, upper : three floats or None, dimension length
        Or all faces of the boundary whose middle lies in this closed box; None sets no limit on that side.
    name : str or None
        Its force is in history.csv then: `NAME.force_x`, `NAME.force_y` and `NAME.force_z`. Messages and `--set` use
        it too.
    constant : bool
        It acts as a whole at any load factor.
    pressure : float, dimension force / length^2
        Reached at load factor 1; a negative one pulls. Faces stay as they are at rest, however far they move.
    """

    kind: Literal["pressure"]
    pressure: float = key(dimension="force / length^2", remedy="Give the pressure, for example 10.0.")
