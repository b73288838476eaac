"""What holds a body softly, or makes places of it move as one: deck tables ``[[springs]]`` and ``[[ties]]``."""

from __future__ import annotations

from typing import Literal

from pdfem_mpi.deck.face_loads import Traction
from pdfem_mpi.deck.loads import Places
from pdfem_mpi.deck.meshes import corner_problems
from pdfem_mpi.deck.table import AXES, Face, Problem, Table, Vector, key, plain_name, show


class Spring(Table):
    """Springs between the body and a ground that does not move; deck tables ``[[springs]]``.

    Attributes
    ----------
    name : str or None
        Its force on the body is in history.csv then: ``NAME.force_x``, ``NAME.force_y`` and ``NAME.force_z``.
    point : three floats or None, dimension length
        Where: all of it at a point, as a force is.
    line : two points or None, dimension length
        Or spread over a line by length, as a force is.
    face, set, lower, upper
        Or faces of cells, as for a traction: spread over them by area.
    stiffness : three floats >= 0, dimension force / length
        Along x, y and z, of all that is chosen together. It stays what it is at any load factor.
    """

    name: str | None = key(None)
    point: Vector | None = key(None, dimension="length")
    line: tuple[Vector, Vector] | None = key(None, dimension="length")
    face: Face | None = key(None)
    set: str | None = key(None)
    lower: Vector | None = key(None, dimension="length")
    upper: Vector | None = key(None, dimension="length")
    stiffness: Vector = key(
        dimension="force / length", remedy="Give it along x, y and z, for example [0.0, 1000.0, 0.0]."
    )

    def problems(self) -> list[Problem]:
        """One place, and a stiffness that holds."""
        ways = ("point", "line", "face", "set")
        given = [name for name in ways if getattr(self, name) is not None]
        if self.lower is not None or self.upper is not None:
            given.append("lower/upper")
        problems = plain_name(self.name) + corner_problems(self.lower, self.upper, equal=True)
        if len(given) != 1:
            has = "none of them" if not given else " and ".join(given)
            text = f"must say where by exactly one of {', '.join(ways)} or lower/upper, and has {has}."
            problems.append(Problem("", text))
        if self.line is not None and self.line[0] == self.line[1]:
            problems.append(Problem("line", f"= {show(self.line)} has no length. Give two ends, or use point."))
        if min(self.stiffness) < 0.0:
            text = "would push a body away from its place. Use numbers that are not negative."
            problems.append(Problem("stiffness", f"= {show(self.stiffness)} {text}"))
        elif not any(self.stiffness):
            problems.append(Problem("stiffness", f"= {show(self.stiffness)} holds nothing. Give one above 0."))
        return problems

    def pull(self, force: float) -> Traction | None:
        """A traction of this force along each axis on the same faces; None at a point or on a line."""
        if self.point is not None or self.line is not None:
            return None
        return Traction.model_construct(
            kind="traction", face=self.face, set=self.set, lower=self.lower, upper=self.upper, traction=None,
            total=(force, force, force), nodal="consistent", name=None, constant=False,
        )  # fmt: skip


class Tie(Places):
    """Places that have one displacement in some directions: a loading pin, a platen; deck tables ``[[ties]]``.

    How large it is, forces decide: those of loads on any of these places count as forces on all of them together.

    Attributes
    ----------
    name : str or None
        Its displacement is in history.csv then: ``NAME.u_x``, ``NAME.u_y`` and ``NAME.u_z``, as far as it is tied.
    region, face, set, layers, lower, upper, of, point, line
        Where, as for a support.
    along : list of "x", "y", "z"
        Directions in which these places move as one; in the others each is free.
    """

    name: str | None = key(None)
    along: tuple[Literal["x", "y", "z"], ...] = key(min_length=1, remedy='Give directions, for example ["y"].')

    def problems(self) -> list[Problem]:
        """One selection, and each direction once."""
        problems = super().problems() + plain_name(self.name)
        if len(set(self.along)) < len(self.along):
            problems.append(Problem("along", f"= {show(self.along)} has a direction twice. Give each once."))
        return problems

    @property
    def axes(self) -> tuple[int, ...]:
        """Numbers of the directions, rising."""
        return tuple(d for d, axis in enumerate(AXES) if axis in self.along)
