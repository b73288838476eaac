"""How far a crack or a notch opens: a deck table of ``[[probes]]``."""

from __future__ import annotations

from typing import Literal

from pdfem_mpi.deck.directions import no_direction, unit
from pdfem_mpi.deck.table import Problem, Table, Vector, key, plain_name, show


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
