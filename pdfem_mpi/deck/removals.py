"""What is taken out of a box of cells: deck tables ``[[mesh.remove]]``, for notches, holes, L- and T-shapes."""

from __future__ import annotations

import itertools
from typing import Annotated, Literal

from pydantic import Field

from pdfem_mpi.deck.directions import no_direction
from pdfem_mpi.deck.polygons import crossing_problems
from pdfem_mpi.deck.table import AXES, Pair, Problem, Table, Vector, key, show

Axis = Literal["x", "y", "z"]


class RemovedBox(Table):
    """Cells whose centroid lies in a closed box; a ``[[mesh.remove]]`` table with ``kind = "box"``.

    Attributes
    ----------
    lower, upper : three floats, dimension length
        Opposite corners; the box may stick out of the body.
    """

    kind: Literal["box"]
    lower: Vector = key(dimension="length", remedy="Give the lower corner of what is removed, for example [0, 0, 0].")
    upper: Vector = key(dimension="length", remedy="Give the upper corner of what is removed, for example [1, 1, 1].")

    def problems(self) -> list[Problem]:
        """Corners in order."""
        return [
            Problem(
                "upper",
                f"has {AXES[d]} = {show(high)}, which is not above {AXES[d]} = {show(low)} of lower. Exchange them, or "
                "correct one.",
            )
            for d, (low, high) in enumerate(zip(self.lower, self.upper, strict=True))
            if not high > low
        ]


class _Extruded(Table):
    """What goes along an axis, through all of the body or a part of its length."""

    axis: Axis = key(remedy='Give the axis it goes along, "x", "y" or "z".')
    span: Pair | None = key(None, dimension="length")

    def problems(self) -> list[Problem]:
        """A span with two ends in order."""
        if self.span is None or self.span[0] < self.span[1]:
            return []
        return [Problem("span", f"= {show(self.span)} has no length. Give the lower end first, then the upper one.")]


class RemovedCylinder(_Extruded):
    """Cells whose centroid lies in a closed cylinder; a ``[[mesh.remove]]`` table with ``kind = "cylinder"``.

    Attributes
    ----------
    axis : "x", "y" or "z"
        The direction of the cylinder.
    centre : three floats, dimension length
        Any point of the axis.
    radius : float, > 0, dimension length
        Of the cylinder.
    span : two floats or None, dimension length
        Where it begins and ends along the axis; None (default): through all of the body.
    """

    kind: Literal["cylinder"]
    centre: Vector = key(dimension="length", remedy="Give a point of the axis, for example [0.0, 0.0, 0.0].")
    radius: float = key(gt=0, dimension="length", remedy="Give the radius, for example 0.5.")


class RemovedHalfSpace(Table):
    """Cells whose centroid lies on one side of a plane; a ``[[mesh.remove]]`` table with ``kind = "half_space"``.

    Attributes
    ----------
    point : three floats, dimension length
        A point of the plane.
    normal : three floats
        Of any length but 0; what it points to is removed.
    """

    kind: Literal["half_space"]
    point: Vector = key(dimension="length", remedy="Give a point of the plane, for example [1.0, 0.0, 0.0].")
    normal: Vector = key(dimension="1", remedy="Give a vector to the removed side, for example [1.0, 0.0, 0.0].")

    def problems(self) -> list[Problem]:
        """A normal."""
        return no_direction("normal", self.normal)


class RemovedPrism(_Extruded):
    """Cells whose centroid lies in a prism over a polygon; a ``[[mesh.remove]]`` table with ``kind = "prism"``.

    Attributes
    ----------
    axis : "x", "y" or "z"
        The direction of the prism.
    polygon : three or more pairs of floats, dimension length
        Corners in order of a simple polygon, convex or not, by the two other coordinates in alphabetical order: (y, z)
        for ``axis = "x"``, (x, z) for ``"y"``, (x, y) for ``"z"``.
    span : two floats or None, dimension length
        Where it begins and ends along the axis; None (default): through all of the body.
    """

    kind: Literal["prism"]
    polygon: tuple[Pair, ...] = key(
        min_length=3, dimension="length", remedy="Give the corners, for example [[0.0, 0.0], [1.0, 0.0], [0.5, 1.0]]."
    )

    def problems(self) -> list[Problem]:
        """A span, and corners with an area between them and edges that do not cross."""
        problems = super().problems()
        crossing = crossing_problems(self.polygon)
        if crossing:
            return problems + crossing
        a, b = self.polygon[0]
        offsets = [(p - a, q - b) for p, q in self.polygon]
        size = max(abs(c) for offset in offsets for c in offset)
        area = 0.5 * abs(sum(p * s - r * q for (p, q), (r, s) in itertools.pairwise((*offsets, offsets[0]))))
        if area > 1e-12 * size**2:
            return problems
        return [*problems, Problem("polygon", "has no area. Give the corners in order, each once.")]


Removal = Annotated[RemovedBox | RemovedCylinder | RemovedHalfSpace | RemovedPrism, Field(discriminator="kind")]
