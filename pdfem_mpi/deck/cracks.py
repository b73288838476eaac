"""Shapes of initial cracks beside polygons: deck tables ``[[cracks]]`` with ``kind = "disc"`` or ``"half_plane"``."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field

from pdfem_mpi.deck.directions import cross, frame, no_direction, unit
from pdfem_mpi.deck.peridynamics import Crack
from pdfem_mpi.deck.table import Problem, Table, Vector, key, show

DISC_CORNERS = 256  # of the polygon that stands for a disc: its radius is that of the disc within 4e-5
ALONG_NORMAL = 1e-6  # sine of the angle to its normal below which a direction gives no plane: decks print 6 digits


class DiscCrack(Table):
    """A crack in the shape of a disc ("penny"); a ``[[cracks]]`` table with ``kind = "disc"``.

    Attributes
    ----------
    centre : three floats, dimension length
        Of the disc.
    normal : three floats
        Of its plane, of any length but 0.
    radius : float, > 0, dimension length
        A polygon of 256 corners stands for the disc.
    """

    kind: Literal["disc"]
    centre: Vector = key(dimension="length", remedy="Give the centre, for example [0.0, 0.0, 0.0].")
    normal: Vector = key(dimension="1", remedy="Give the normal of its plane, for example [0.0, 1.0, 0.0].")
    radius: float = key(gt=0, dimension="length", remedy="Give the radius of the crack, for example 0.5.")

    def problems(self) -> list[Problem]:
        """A normal."""
        return no_direction("normal", self.normal)

    def corners(self, lower: Sequence[float], upper: Sequence[float]) -> tuple[Vector, ...]:
        """The polygon that stands for it: half of it outside of the circle, half inside."""
        one, two = frame(self.normal)
        angles = [2.0 * math.pi * k / DISC_CORNERS for k in range(DISC_CORNERS)]
        radius = self.radius / math.sqrt(math.cos(math.pi / DISC_CORNERS))
        return tuple(
            _along(self.centre, (radius * math.cos(angle), one), (radius * math.sin(angle), two)) for angle in angles
        )


class HalfPlaneCrack(Table):
    """A crack that begins at a straight front and goes through all of the body on one side; ``kind = "half_plane"``.

    Attributes
    ----------
    point : three floats, dimension length
        A point of the front, which is a straight line.
    normal : three floats
        Of the crack's plane, of any length but 0.
    direction : three floats
        From the front into the crack; made normal to ``normal``.
    """

    kind: Literal["half_plane"]
    point: Vector = key(dimension="length", remedy="Give a point of the crack's front, for example [1.0, 0.0, 0.0].")
    normal: Vector = key(dimension="1", remedy="Give the normal of its plane, for example [0.0, 1.0, 0.0].")
    direction: Vector = key(
        dimension="1", remedy="Give the direction from the front into the crack, for example [-1.0, 0.0, 0.0]."
    )

    def problems(self) -> list[Problem]:
        """A normal, and a direction that is not along it."""
        problems = no_direction("normal", self.normal) + no_direction("direction", self.direction)
        if problems:
            return problems
        into = _into(unit(self.normal), unit(self.direction))
        if math.hypot(*into) > ALONG_NORMAL:
            return []
        text = f"= {show(self.direction)} is normal to the crack's plane. Give the direction from the front into it."
        return [Problem("direction", text)]

    def corners(self, lower: Sequence[float], upper: Sequence[float]) -> tuple[Vector, ...]:
        """A rectangle beyond the box of the body, and of its mirror images within a bond's reach."""
        normal = unit(self.normal)
        into = unit(_into(normal, unit(self.direction)))
        front = cross(normal, into)
        far = max(math.dist(self.point, corner) for corner in (lower, upper)) + 4.0 * math.dist(lower, upper)
        ends = (-far, 0.0), (far, 0.0), (far, far), (-far, far)
        return tuple(_along(self.point, (a, front), (b, into)) for a, b in ends)


def _polygon_by_default(value: Any) -> Any:
    return {"kind": "polygon", **value} if isinstance(value, dict) else value


AnyCrack = Annotated[
    Crack | DiscCrack | HalfPlaneCrack, Field(discriminator="kind"), BeforeValidator(_polygon_by_default)
]


def _into(normal: Vector, direction: Vector) -> Vector:
    """The part of a direction in the plane of a unit normal."""
    along = math.fsum(a * b for a, b in zip(normal, direction, strict=True))
    return tuple(b - along * a for a, b in zip(normal, direction, strict=True))


def _along(origin: Vector, *steps: tuple[float, Vector]) -> Vector:
    """The place reached from an origin by steps of given lengths along unit vectors."""
    x, y, z = (origin[d] + math.fsum(length * way[d] for length, way in steps) for d in range(3))
    return x, y, z
