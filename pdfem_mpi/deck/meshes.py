"""Where the cells come from: deck table ``[mesh]``."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field

from pdfem_mpi.deck.removals import Removal
from pdfem_mpi.deck.table import AXES, Face, Problem, Table, Vector, key, show

SPACING_TOLERANCE = 1e-6  # relative misfit of a side and a whole number of spacings: decks print 6 digits
MAX_CELLS = 2**28  # 2**31 points: far above any machine this is for; catches a spacing typed in other units
HOLE_CELLS = 2  # spacings that the radius of a hole, and its distance from an edge, must have: room to grade cells
MESH_SUFFIXES = (".msh", ".inp", ".vtu", ".vtk", ".exo", ".e", ".ex2", ".g", ".gen")  # Gmsh, Abaqus, VTK, Exodus II


class _Modelled(Table):
    """A mesh, all of a body or the part of it on one side of its mirror planes."""

    symmetry: tuple[Face, ...] = key((), remedy='Give faces that are mirror planes, for example ["x-", "y-"].')

    def _symmetry_problems(self) -> list[Problem]:
        """Each face once."""
        twice = sorted({face for face in self.symmetry if self.symmetry.count(face) > 1})
        if not twice:
            return []
        return [Problem("symmetry", f"= {show(self.symmetry)} names {' and '.join(twice)} twice. Name each face once.")]

    @property
    def may_have_hollows(self) -> bool:
        """Whether a straight line between two places of the body may leave it."""
        return True


class _CubicCells(_Modelled):
    """A bounding box of cubic cells."""

    kind: str = key("")
    lower: Vector = key(dimension="length", remedy="Give the corner, for example [-5.0, -0.2, -0.2].")
    upper: Vector = key(dimension="length", remedy="Give the corner, for example [5.0, 0.2, 0.2].")
    spacing: float = key(gt=0, dimension="length", remedy="Give the edge of a cell, for example 0.05.")

    def problems(self) -> list[Problem]:
        """Corners in order, and a spacing that divides the sides."""
        corners = corner_problems(self.lower, self.upper)
        return self._symmetry_problems() + (corners or self._spacing_problems())

    def _spacing_problems(self) -> list[Problem]:
        sides = [upper - lower for lower, upper in zip(self.lower, self.upper, strict=True)]
        counts = [side / self.spacing for side in sides]
        if not all(math.isfinite(count) for count in counts) or math.prod(counts) > MAX_CELLS:
            return [
                Problem(
                    "spacing",
                    f"= {show(self.spacing)} makes more than {MAX_CELLS} cells of the box with sides "
                    f"{show(sides)}. Use a larger spacing, or check the units.",
                )
            ]
        misfits = [axis for axis in range(3) if not _divides(sides[axis], self.spacing)]
        if not misfits:
            return []
        names = " and ".join(f"{AXES[axis]} = {sides[axis]:.6g}" for axis in misfits)
        fitting = nearest_fitting_spacing(sides, self.spacing)
        remedy = (
            f"Use {fitting:.12g}, or other corners."
            if fitting is not None
            else "No spacing near it divides all three sides: choose other corners."
        )
        noun = "the box's side" if len(misfits) == 1 else "the box's sides"
        return [Problem("spacing", f"= {show(self.spacing)} does not divide {noun} {names} into whole cells. {remedy}")]

    @property
    def n_cells(self) -> tuple[int, int, int]:
        """Number of cells along x, y and z."""
        nx, ny, nz = (
            round((upper - lower) / self.spacing) for lower, upper in zip(self.lower, self.upper, strict=True)
        )
        return nx, ny, nz


class BoxMesh(_CubicCells):
    """Cubic cells filling a box; deck table ``[mesh]`` with ``kind = "box"``, which may be left out.

    Attributes
    ----------
    lower, upper : three floats, dimension length
        Opposite corners. Every side is a whole number of spacings, within 1e-6 of its length.
    spacing : float, > 0, dimension length
        Edge of a cell (the paper's Delta).
    symmetry : faces "x-", "x+", "y-", "y+", "z-", "z+"
        Faces of the box that are mirror planes; the box is then the part of the body between them.
    remove : tables of `deck.removals`
        What is taken out of the box: ``[[mesh.remove]]``. Faces and mirror planes are then those of what is left.
    """

    kind: Literal["box"] = key("box")
    remove: tuple[Removal, ...] = key(())

    @property
    def may_have_hollows(self) -> bool:
        """Where cells are taken out."""
        return bool(self.remove)


class PlateWithHoleMesh(_CubicCells):
    """A plate with a circular hole along z at its centre (Fig. 13); ``[mesh]`` with ``kind = "plate_with_hole"``.

    Attributes
    ----------
    lower, upper : three floats, dimension length
        Opposite corners of the plate, or of the part of it that mirror planes leave: with ``symmetry = ["x-", "y-"]``
        a quarter of the plate, with the hole at its corner. Every side is a whole number of spacings, within 1e-6 of
        its length.
    hole_radius : float, > 0, dimension length
        At least 2 spacings; the hole keeps at least 2 spacings from the edges in x and y.
    spacing : float, > 0, dimension length
        Edge of a cell away from the hole. Cells at the hole have edges near it.
    symmetry : faces "x-", "x+", "y-", "y+", "z-", "z+"
        Faces that are mirror planes. Not both of x or of y: one of them goes through the hole.
    """

    kind: Literal["plate_with_hole"] = key("plate_with_hole")
    hole_radius: float = key(gt=0, dimension="length", remedy="Give the radius of the hole, for example 0.4.")

    @property
    def may_have_hollows(self) -> bool:
        """Bonds over the rim of the hole stay, as in the paper: there are some where it has few cells."""
        return False

    def problems(self) -> list[Problem]:
        """Those of a box, and a hole that fits into it."""
        return super().problems() or self._mirrored_holes() or self._hole_problems()

    def _mirrored_holes(self) -> list[Problem]:
        both = [axis for axis in "xy" if {f"{axis}-", f"{axis}+"} <= set(self.symmetry)]
        if not both:
            return []
        return [
            Problem(
                "symmetry",
                f"= {show(self.symmetry)} has both faces of {' and of '.join(both)}, and the hole lies on a mirror "
                f'plane. Keep "{both[0]}-" or "{both[0]}+".',
            )
        ]

    @property
    def whole_plate(self) -> tuple[Vector, Vector]:
        """Corners of the plate and its mirror images in x and y, whose centre is that of the hole."""
        corners = list(self.lower), list(self.upper)
        for axis, (low, high) in enumerate(zip(self.lower, self.upper, strict=True)):
            if f"{AXES[axis]}-" in self.symmetry and axis < 2:
                corners[0][axis] = low - (high - low)
            elif f"{AXES[axis]}+" in self.symmetry and axis < 2:
                corners[1][axis] = high + (high - low)
        return tuple(corners[0]), tuple(corners[1])

    def _hole_problems(self) -> list[Problem]:
        radius, least = self.hole_radius, HOLE_CELLS * self.spacing
        tolerance = SPACING_TOLERANCE * self.spacing
        if radius < least - tolerance:
            return [
                Problem(
                    "hole_radius",
                    f"= {show(radius)} is below {HOLE_CELLS} * spacing = {least:.12g}: too few cells for a circle. "
                    f"Use a spacing of at most {radius / HOLE_CELLS:.12g}, or a larger hole.",
                )
            ]
        lower, upper = self.whole_plate
        half = [0.5 * (upper[axis] - lower[axis]) for axis in (0, 1)]
        axis = int(half[1] < half[0])
        if radius > half[axis] - least + tolerance:
            return [
                Problem(
                    "hole_radius",
                    f"= {show(radius)} does not fit: it leaves {half[axis] - radius:.6g} between the hole and the "
                    f"plate's edges in {AXES[axis]}, where {HOLE_CELLS} * spacing = {least:.12g} is needed. "
                    "Use a smaller hole or spacing, or a larger plate.",
                )
            ]
        return []


class FileMesh(_Modelled):
    """Hexahedra from a mesh file; ``[mesh]`` with ``kind = "file"``. See docs/meshes.md.

    Attributes
    ----------
    path : str
        A .msh (Gmsh), .inp (Abaqus), .vtu or .vtk (VTK), .exo, .e, .ex2, .g or .gen (Exodus II) file, relative to the
        deck's folder.
    spacing : float or None, > 0, dimension length
        What the defaults of [peridynamics] are made of. None (default): the mean edge of the cells.
    scale : float, > 0, dimension 1
        Multiplies the file's coordinates, to have them in the deck's unit of length.
    merge : float or None, > 0, dimension length
        Nodes nearer to each other than this are made one; at most a tenth of the shortest edge. None (default): nodes
        at one place are refused.
    doubled_nodes : "refuse" or "crack"
        "crack": faces at one place that share no node stay apart, as a crack between elements, and bonds through them
        are cut.
    symmetry : faces "x-", "x+", "y-", "y+", "z-", "z+"
        Faces of the mesh's bounding box that are mirror planes; the mesh is then the part of the body between them.
    """

    kind: Literal["file"] = key("file")
    path: str = key(min_length=1, remedy='Give the file, relative to the deck, for example "meshes/plate.msh".')
    spacing: float | None = key(None, gt=0, dimension="length")
    scale: float = key(1.0, gt=0, dimension="1")
    merge: float | None = key(None, gt=0, dimension="length")
    doubled_nodes: Literal["refuse", "crack"] = key("refuse")

    def problems(self) -> list[Problem]:
        """A suffix that tells the format."""
        problems = self._symmetry_problems()
        if self.merge is not None and self.doubled_nodes == "crack":
            text = f'= {show(self.merge)} makes one of nodes that doubled_nodes = "crack" keeps. Keep one of them.'
            problems.append(Problem("merge", text))
        if self.path.lower().endswith(MESH_SUFFIXES):
            return problems
        remedy = f"Give a file that ends in one of {', '.join(MESH_SUFFIXES)}."
        return [*problems, Problem("path", f"= {show(self.path)} has a suffix of no known mesh format. {remedy}")]


def _box_by_default(value: Any) -> Any:
    return {"kind": "box", **value} if isinstance(value, dict) else value


Mesh = Annotated[BoxMesh | PlateWithHoleMesh | FileMesh, Field(discriminator="kind"), BeforeValidator(_box_by_default)]


def _divides(side: float, spacing: float) -> bool:
    count = round(side / spacing)
    return abs(count * spacing - side) <= SPACING_TOLERANCE * side


def nearest_fitting_spacing(sides: Sequence[float], spacing: float) -> float | None:
    """Return the spacing nearest to ``spacing`` that divides all sides into whole cells, or None."""
    shortest = min(sides)
    middle = max(1, round(shortest / spacing))
    counts = range(max(1, middle // 4), 4 * middle + 100)
    fitting = [shortest / n for n in counts if all(_divides(side, shortest / n) for side in sides)]
    return min(fitting, key=lambda s: (abs(s - spacing), s)) if fitting else None


def corner_problems(lower: Vector | None, upper: Vector | None, equal: bool = False) -> list[Problem]:
    if lower is None or upper is None:
        return []
    problems = []
    for axis in range(3):
        low, high = lower[axis], upper[axis]
        if high < low or (high == low and not equal):
            problems.append(
                Problem(
                    "upper",
                    f"has {AXES[axis]} = {show(high)}, which is not above {AXES[axis]} = {show(low)} "
                    "of lower. Exchange them, or correct one.",
                )
            )
    return problems
