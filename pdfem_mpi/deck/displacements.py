"""Displacements of a support by place: rotation, torsion and affine ones, as formulas of each component.

Keys of a deck's ``[[supports]]``. What they say is a formula of x, y and z (`deck.formulas`), times the load factor.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

from pdfem_mpi.deck.directions import cross, no_direction, unit
from pdfem_mpi.deck.table import AXES, Problem, Table, Vector, key

Amounts = tuple[float | str | None, float | str | None, float | str | None]
Matrix = tuple[Vector, Vector, Vector]


class Rotation(Table):
    """Rotation of a support about an axis; key ``rotation`` of a support.

    Attributes
    ----------
    axis : three floats
        Its direction, about which the angle counts as a right-handed screw turns.
    point : three floats, dimension length
        A point of the axis.
    angle : float, dimension 1
        In radians, reached at load factor 1.
    finite : bool
        False: displacements of a small rotation, in proportion to the angle. True: those of a true rotation by the
        load factor times the angle; this needs ``stepping.kind = "steps"``.
    """

    axis: Vector = key(remedy="Give its direction, for example [1.0, 0.0, 0.0].")
    point: Vector = key((0.0, 0.0, 0.0), dimension="length")
    angle: float = key(remedy="Give the angle in radians, for example 0.01.")
    finite: bool = key(False)

    def problems(self) -> list[Problem]:
        """A direction."""
        return no_direction("axis", self.axis)

    @property
    def amounts(self) -> Amounts:
        """What it prescribes along x, y and z."""
        k = unit(self.axis)
        around = _cross_matrix(k)
        if not self.finite:
            return _linear(_times(around, self.angle), self.point)
        outwards = tuple(cross(k, column) for column in zip(*around, strict=True))  # k x (k x .), which is symmetric
        first, second = (_linear(matrix, self.point) for matrix in (around, outwards))
        return tuple(
            f"sin({self.angle!r}*f)*({a}) + (1 - cos({self.angle!r}*f))*({b})" if a or b else 0.0
            for a, b in zip(first, second, strict=True)
        )


class Torsion(Table):
    """Twist of a support about an axis that leaves it free to warp; key ``torsion`` of a support.

    Attributes
    ----------
    axis : "x", "y" or "z"
        Displacements along it are left free.
    point : three floats, dimension length
        A point of the axis.
    angle : float, dimension 1
        In radians, reached at load factor 1; displacements are in proportion to it.
    """

    axis: Literal["x", "y", "z"] = key(remedy='Give "x", "y" or "z".')
    point: Vector = key((0.0, 0.0, 0.0), dimension="length")
    angle: float = key(remedy="Give the angle in radians, for example 0.01.")

    @property
    def amounts(self) -> Amounts:
        """What it prescribes along x, y and z."""
        along = AXES.index(self.axis)
        direction = tuple(float(d == along) for d in range(3))
        found = _linear(_times(_cross_matrix(direction), self.angle), self.point)
        return tuple(None if d == along else amount for d, amount in enumerate(found))


class Affine(Table):
    """Displacements that are linear in the place; key ``affine`` of a support.

    Attributes
    ----------
    gradient : three times three floats, dimension 1
        Row i has the derivatives of displacement i along x, y and z; reached at load factor 1.
    point : three floats, dimension length
        Where nothing moves.
    """

    gradient: Matrix = key(remedy="Give three rows, for example [[0.01, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]].")
    point: Vector = key((0.0, 0.0, 0.0), dimension="length")

    @property
    def amounts(self) -> Amounts:
        """What it prescribes along x, y and z."""
        return _linear(self.gradient, self.point)


def _cross_matrix(k: Vector) -> Matrix:
    """The matrix of ``k x``."""
    return (0.0, -k[2], k[1]), (k[2], 0.0, -k[0]), (-k[1], k[0], 0.0)


def _times(matrix: Matrix, factor: float) -> Matrix:
    return tuple(tuple(factor * c for c in row) for row in matrix)


def _linear(matrix: Sequence[Sequence[float]], point: Vector) -> Amounts:
    """Formulas of ``matrix (x - point)``, or 0 where nothing moves."""
    places = [axis if p == 0.0 else f"({axis} - {p!r})" for axis, p in zip(AXES, point, strict=True)]
    rows = (" + ".join(f"{c!r}*{x}" for c, x in zip(row, places, strict=True) if c != 0.0) for row in matrix)
    return tuple(text or 0.0 for text in rows)
