"""What to simulate: the frozen models behind a deck, and every check that needs no mesh.

A ``Scene`` is complete (defaults included), immutable, and the same object on every rank. Keys of the deck
equal field names. Dimensions are written with force, length and 1; a deck may use any consistent unit system.
Checks within one table are its method ``problems``, checks between tables are listed in ``CHECKS``; both
state their findings as ``Problem``: the key, and the rest of the sentence. ``deck.py`` adds the file's name.
"""

from __future__ import annotations

import contextlib
import difflib
import functools
import itertools
import math
import re
from collections.abc import Callable, Iterable, Sequence
from typing import Annotated, Any, Literal, NamedTuple, Self

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, model_validator
from pydantic_core import PydanticCustomError

Vector = tuple[float, float, float]
Face = Literal["x-", "x+", "y-", "y+", "z-", "z+"]
AXES = ("x", "y", "z")

SPACING_TOLERANCE = 1e-6  # relative misfit of a side and a whole number of spacings: decks print 6 digits
MAX_CELLS = 2**28  # 2**31 points: far above any machine this is for; catches a spacing typed in other units
HOLE_CELLS = 2  # spacings that the radius of a hole, and its distance from an edge, must have: room to grade cells
LONGEST_NAME = 200  # characters: line_NAME.png.tmp is a file, whose name may have 255 bytes
MOST_REGIONS = 255  # classes of bonds are stored in one byte a cluster
MOST_CORNERS, FEW_CORNERS = 1000, 64  # of a crack: each bond near it is compared with all; all pairs are looked at
MOST_HINTS = 50  # findings of one kind that get a hint of what may have been meant: more would take minutes
CUTOFF_RATIO = 2.5  # r_c / l of the paper (sec. 4.1, appendix B)
MESH_SUFFIXES = (".msh", ".inp", ".vtu", ".vtk", ".exo", ".e", ".ex2", ".g", ".gen")  # Gmsh, Abaqus, VTK, Exodus II
DEFAULT_MATERIAL = "default"  # what regions and interfaces call the table [material]
MOST_CONTRAST = 1e5  # of Young's moduli: at 1e6 residuals of elements stop at 2e-6, above the tolerance in use
PERIDYNAMIC_POISSONS_RATIO = 0.25  # central bond forces in an isotropic solid admit no other value


class SceneError(Exception):
    """A scene that cannot be simulated; every problem is one plain sentence.

    Attributes
    ----------
    messages : list of str
        All problems found, each with the key, the value and the remedy.
    """

    def __init__(self, messages: Iterable[str]):
        self.messages = list(messages)
        super().__init__("\n".join(self.messages))


class Problem(NamedTuple):
    """One finding: the key's path, and the rest of the sentence (``= 0.07 does not ... Use 0.05.``)."""

    key: str
    text: str


def did_you_mean(word: object, known: Iterable[str]) -> str:
    """Return `` Did you mean X?`` for the nearest of ``known``, or an empty string."""
    known = list(known)
    near = difflib.get_close_matches(str(word), known, n=1, cutoff=0.65)
    if not near:
        same = {name.casefold(): name for name in known}
        near = [same[str(word).casefold()]] if str(word).casefold() in same else []
    return f" Did you mean {near[0]}?" if near else ""


def show(value: object) -> str:
    """Return a value as a deck would print it, shortened to 60 characters."""
    if isinstance(value, bool):
        text = "true" if value else "false"
    elif isinstance(value, str):
        text = '"' + value.replace("\n", "\\n") + '"'
    elif isinstance(value, int) and abs(value) >= 10**20:
        text = f"a whole number of {int(math.log10(abs(value))) + 1} digits"
    elif isinstance(value, tuple | list):
        text = "[" + ", ".join(show(item) for item in value[:8]) + (", ..." if len(value) > 8 else "") + "]"
    elif isinstance(value, dict):
        text = "a table"
    else:
        text = repr(value) if isinstance(value, float | int) else str(value)
    return text if len(text) <= 60 else text[:57] + "..."


def key(default: Any = ..., *, dimension: str = "", remedy: str = "", **limits: Any) -> Any:
    """Return a pydantic field with the dimension and remedy that error sentences and documents print."""
    return Field(default, json_schema_extra={"dimension": dimension, "remedy": remedy}, **limits)


def _refuse(problems: Sequence[Problem]) -> None:
    """Raise the problems of one table as one pydantic error that ``deck.py`` can take apart."""
    if problems:
        text = " ".join(f"{problem.key} {problem.text}".strip() for problem in problems)
        raise PydanticCustomError("pdfem", "{text}", {"text": text, "problems": list(problems)})


class Table(BaseModel):
    """Base of all deck tables: frozen, unknown keys refused, no silent conversion, no nan or inf."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)

    def problems(self) -> list[Problem]:
        """Return what is wrong between the keys of this table; each key by itself is sound."""
        return []

    @model_validator(mode="after")
    def _check(self) -> Self:
        _refuse(self.problems())
        return self


class Units(Table):
    """Names of the units, for labels only; nothing is converted. Deck table ``[units]``."""

    length: str = key("")
    force: str = key("")


class _Modelled(Table):
    """A mesh, all of a body or the part of it on one side of its mirror planes."""

    symmetry: tuple[Face, ...] = key((), remedy='Give faces that are mirror planes, for example ["x-", "y-"].')

    def _symmetry_problems(self) -> list[Problem]:
        """Each face once."""
        twice = sorted({face for face in self.symmetry if self.symmetry.count(face) > 1})
        if not twice:
            return []
        return [Problem("symmetry", f"= {show(self.symmetry)} names {' and '.join(twice)} twice. Name each face once.")]


class _CubicCells(_Modelled):
    """A bounding box of cubic cells."""

    kind: str = key("")
    lower: Vector = key(dimension="length", remedy="Give the corner, for example [-5.0, -0.2, -0.2].")
    upper: Vector = key(dimension="length", remedy="Give the corner, for example [5.0, 0.2, 0.2].")
    spacing: float = key(gt=0, dimension="length", remedy="Give the edge of a cell, for example 0.05.")

    def problems(self) -> list[Problem]:
        """Corners in order, and a spacing that divides the sides."""
        corners = _corner_problems(self.lower, self.upper)
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
        return [
            Problem(
                "spacing", f"= {show(self.spacing)} does not divide {noun} {names} into whole cells. {remedy}"
            )
        ]

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
    """

    kind: Literal["box"] = key("box")


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
    symmetry : faces "x-", "x+", "y-", "y+", "z-", "z+"
        Faces of the mesh's bounding box that are mirror planes; the mesh is then the part of the body between them.
    """

    kind: Literal["file"] = key("file")
    path: str = key(min_length=1, remedy='Give the file, relative to the deck, for example "meshes/plate.msh".')
    spacing: float | None = key(None, gt=0, dimension="length")
    scale: float = key(1.0, gt=0, dimension="1")
    merge: float | None = key(None, gt=0, dimension="length")

    def problems(self) -> list[Problem]:
        """A suffix that tells the format."""
        problems = self._symmetry_problems()
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


def _corner_problems(lower: Vector | None, upper: Vector | None, equal: bool = False) -> list[Problem]:
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


def _failure_problems(table: BaseModel) -> list[Problem]:
    if table.critical_stretch is None or table.fracture_energy is None:
        return []
    return [Problem("critical_stretch", "and fracture_energy are both given, and each gives the other. Keep one.")]


class Material(Table):
    """Isotropic elastic material (sec. 2.1); deck tables ``[material]`` and, for further ones, ``[materials.NAME]``.

    Attributes
    ----------
    youngs_modulus : float, > 0, dimension force / length^2
    poissons_ratio : float, above -1 and below 0.5, dimension 1
        1/4 wherever the material has bonds (peridynamic regions, overlap): central forces admit no other value.
    critical_stretch : float or None, > 0, dimension 1
        ``s_0`` of eq. (4): bonds beyond it break.
    fracture_energy : float or None, > 0, dimension force / length
        ``G_c``, which gives ``s_0`` by the bonds that a plane cuts. At most one of the two; None (default): no failure.

    Examples
    --------
    >>> Material(youngs_modulus=1.0e7).bulk_modulus
    6666666.666666667
    """

    youngs_modulus: float = key(
        gt=0, dimension="force / length^2", remedy="Give Young's modulus, for example 1.0e7."
    )
    poissons_ratio: float = key(PERIDYNAMIC_POISSONS_RATIO, gt=-1, lt=0.5, dimension="1")
    critical_stretch: float | None = key(None, gt=0, dimension="1")
    fracture_energy: float | None = key(None, gt=0, dimension="force / length")

    def problems(self) -> list[Problem]:
        """At most one of critical stretch and fracture energy."""
        return _failure_problems(self)

    @property
    def can_fail(self) -> bool:
        """Whether bonds of this material break."""
        return self.critical_stretch is not None or self.fracture_energy is not None

    def stretch_at_failure(self, internal_length: float, cutoff_ratio: float) -> float | None:
        """The critical stretch, given or from the fracture energy; None without failure.

        ``G_c = (pi / 2) c s_0^2 int_0^rc xi^4 exp(-(xi / l)^2) dxi = (27 sqrt(pi) / 16) k l s_0^2 share(r_c / l)``: the
        energy of all bonds that a plane through the bulk cuts (Silling's integral with the response of eq. 2).

        Parameters
        ----------
        internal_length : float, dimension length
        cutoff_ratio : float
            ``r_c / l``.
        """
        if self.fracture_energy is None:
            return self.critical_stretch
        return math.sqrt(self.fracture_energy / self.energy_at_failure(1.0, internal_length, cutoff_ratio))

    def energy_at_failure(self, critical_stretch: float, internal_length: float, cutoff_ratio: float) -> float:
        """The fracture energy of the bulk whose bonds break at a stretch; dimension force / length."""
        a = min(cutoff_ratio, 30.0)  # the share is 1 from 6 on, and powers of large ratios are not finite
        share = math.erf(a) - 2.0 / math.sqrt(math.pi) * math.exp(-a * a) * (2.0 / 3.0 * a**3 + a)
        whole = 27.0 * math.sqrt(math.pi) / 16.0 * self.bulk_modulus * internal_length
        return whole * share * critical_stretch**2

    @property
    def bulk_modulus(self) -> float:
        """``k = E / (3 (1 - 2 nu))``, dimension force / length^2."""
        return self.youngs_modulus / (3.0 * (1.0 - 2.0 * self.poissons_ratio))


class Interface(Table):
    """What holds for the bonds between two materials (sec. 2.1, Fig. 6); deck tables ``[[interfaces]]``.

    What is not given here is that of the material with the smaller bulk modulus.

    Attributes
    ----------
    between : two texts
        Names of the materials, in any order; "default" is the table [material].
    youngs_modulus : float or None, > 0, dimension force / length^2
    critical_stretch : float or None, > 0, dimension 1
    fracture_energy : float or None, > 0, dimension force / length
        At most one of the last two.
    """

    between: tuple[str, ...] = key(remedy='Name the two materials, for example ["default", "steel"].')
    youngs_modulus: float | None = key(None, gt=0, dimension="force / length^2")
    critical_stretch: float | None = key(None, gt=0, dimension="1")
    fracture_energy: float | None = key(None, gt=0, dimension="force / length")

    def problems(self) -> list[Problem]:
        """Two different names, and something given."""
        problems = _failure_problems(self)
        if len(self.between) != 2 or self.between[0] == self.between[1]:
            problems.append(
                Problem("between", f"= {show(self.between)} must name two different materials. Correct it.")
            )
        if self.youngs_modulus is None and not self.can_fail:
            problems.append(
                Problem("", "changes nothing. Give youngs_modulus, critical_stretch or fracture_energy, or remove it.")
            )
        return problems

    @property
    def can_fail(self) -> bool:
        """Whether it says when bonds break."""
        return self.critical_stretch is not None or self.fracture_energy is not None


class Region(Table):
    """Cells described by one model; deck tables ``[[regions]]``.

    Attributes
    ----------
    name : str
    model : "finite_elements" or "peridynamics"
    material : str
        Name of a table [materials.NAME]; "default" (the default) is the table [material].
    lower, upper : three floats or None, dimension length
        The cells whose centroid lies in this closed box; None (default) sets no limit on that side.
    centre : three floats or None, dimension length
    radius : float or None, > 0, dimension length
        Both or none: only the cells whose centroid lies in this closed ball. Regions with a radius take their cells
        out of those without.
    axis : "x", "y", "z" or None
        With a radius: a cylinder about this axis instead of a ball.
    may_fail : bool or None
        False: bonds with an end in this region never break. None (default): they may, but for those between two points
        of the overlap, which follow element nodes. True: these too, which a run warns of.
    set : str or None
        Or the cells of a named set of the mesh file.
    """

    name: str = key(min_length=1, remedy="Give the region a name that loads and supports can refer to.")
    model: Literal["finite_elements", "peridynamics"] = key(remedy="Give the model that describes its cells.")
    material: str = key(DEFAULT_MATERIAL)
    lower: Vector | None = key(None, dimension="length")
    upper: Vector | None = key(None, dimension="length")
    centre: Vector | None = key(None, dimension="length")
    radius: float | None = key(None, gt=0, dimension="length")
    axis: Literal["x", "y", "z"] | None = key(None)
    may_fail: bool | None = key(None)
    set: str | None = key(None)

    def problems(self) -> list[Problem]:
        """Corners in order, a whole ball or cylinder, and one way to choose cells."""
        problems = _corner_problems(self.lower, self.upper)
        if self.set is not None and (self.lower, self.upper, self.centre, self.radius) != (None,) * 4:
            problems.append(
                Problem("set", f"= {show(self.set)} chooses cells, and so do lower, upper or radius. Keep one of them.")
            )
        if (self.centre is None) != (self.radius is None):
            given, other = ("centre", "radius") if self.radius is None else ("radius", "centre")
            problems.append(Problem(given, f"= {show(getattr(self, given))} needs a {other}. Add it."))
        if self.axis is not None and self.radius is None:
            problems.append(Problem("axis", f'= "{self.axis}" is that of a cylinder. Add centre and radius.'))
        return problems


class Peridynamics(Table):
    """Parameters of the bonds (eqs 2-4, appendix A); deck table ``[peridynamics]``.

    Attributes
    ----------
    internal_length : float or None, > 0, dimension length
        ``l`` in ``exp(-(r0/l)^2)`` of eq. (2). None (default): the mesh's spacing, as in the paper.
    cutoff_radius : float or None, dimension length
        ``r_c``; points with ``r0 <= r_c`` share a bond. None (default): 2.5 l, as in the paper.
    surface_correction : "none", "appendix_a", "virial" or "fitted"
        Of the paper; the same twenty sweeps with a virial stress in place of the force of half a body, which brings
        bars and plates to within 1.4 % of Young's modulus where appendix A leaves 5 %; or one fitted factor a bond,
        with which every uniform strain is an equilibrium.
    signs : "free" or "bounded"
        Of fitted factors: any, which is one linear solve, or positive only, which costs two to four times as much and
        is the one to choose where bonds may break.
    kinematics : "linear", "finite" or None
        Stretch linear in the displacement, or the paper's. Finite elements follow: in "finite" they turn and strain as
        the bonds do. None (default): "finite" where there are bonds; a body of elements alone is linear (eq. 15).
    stiffness_noise : float, 0 to below 1, dimension 1
        Every bond's stiffness is multiplied by a factor drawn evenly from ``1 +- stiffness_noise``: the imperfect
        twin of a symmetric body.
    seed : int, 0 to 2^32 - 1
        Of the noise; the factors depend on it and on the bond alone.
    """

    internal_length: float | None = key(None, gt=0, dimension="length")
    cutoff_radius: float | None = key(None, gt=0, dimension="length")
    surface_correction: Literal["none", "appendix_a", "virial", "fitted"] = key("appendix_a")
    signs: Literal["free", "bounded"] = key("free")
    kinematics: Literal["linear", "finite"] | None = key(None)
    stiffness_noise: float = key(0.0, ge=0, lt=1, dimension="1")
    seed: int = key(0, ge=0, lt=2**32)

    def problems(self) -> list[Problem]:
        """A cutoff radius that is not below the internal length."""
        length, radius = self.internal_length, self.cutoff_radius
        if length is None or radius is None or radius >= length:
            return []
        return [
            Problem(
                "cutoff_radius",
                f"= {show(radius)} is below internal_length = {show(length)}. "
                f"Use 2.5 * internal_length = {CUTOFF_RATIO * length:.12g}, as in the paper.",
            )
        ]

    def lengths(self, cell_edge: float) -> tuple[float, float]:
        """Return (internal length, cutoff radius), defaults filled in from the cells' edge."""
        internal_length = cell_edge if self.internal_length is None else self.internal_length
        cutoff_radius = CUTOFF_RATIO * internal_length if self.cutoff_radius is None else self.cutoff_radius
        return internal_length, cutoff_radius


class Crack(Table):
    """An initial crack: bonds through a plane polygon are cut before the first load; ``[[cracks]]`` tables.

    Attributes
    ----------
    polygon : three or more points, dimension length
        Corners in order, in one plane; the polygon may stick out of the body. Bonds through its edges are cut too.
    """

    polygon: tuple[Vector, ...] = key(
        min_length=3,
        dimension="length",
        remedy="Give the corners in order, for example [[0.0, -0.1, -1.0], [1.0, -0.1, -1.0], [1.0, -0.1, 1.0]].",
    )

    def problems(self) -> list[Problem]:
        """Corners that span a plane and lie in it."""
        if len(self.polygon) > MOST_CORNERS:
            count = f"{len(self.polygon):,} corners, and at most {MOST_CORNERS:,} serve"
            return [Problem("polygon", f"has {count}. Use fewer, or several cracks.")]
        normal, size = polygon_normal(self.polygon)
        if normal is None:
            return [Problem("polygon", "has no area: its corners lie on a line. Give corners that span a plane.")]
        height = max(
            abs(math.fsum(n * (c - o) for n, c, o in zip(normal, corner, self.polygon[0], strict=True)))
            for corner in self.polygon
        )
        if height > SPACING_TOLERANCE * size:
            return [
                Problem(
                    "polygon",
                    f"is not plane: a corner lies {height:.3g} off the plane of the others. Move it, or use triangles.",
                )
            ]
        return []


def polygon_normal(corners: Sequence[Vector]) -> tuple[Vector | None, float]:
    """Unit normal of a plane polygon (None without area) by Newell's formula, and its size."""
    if len(corners) <= FEW_CORNERS:
        size = max(math.dist(a, b) for a in corners for b in corners)
    else:  # of the order of it, without all pairs
        size = math.dist(*([choose(c[d] for c in corners) for d in range(3)] for choose in (min, max)))
    normal = [
        math.fsum(
            (a[j] - b[j]) * (a[k] + b[k] - 2.0 * corners[0][k])
            for a, b in zip(corners, (*corners[1:], corners[0]), strict=True)
        )
        for j, k in ((1, 2), (2, 0), (0, 1))
    ]
    length = math.hypot(*normal)
    if not length > 1e-12 * size**2:
        return None, size
    return (normal[0] / length, normal[1] / length, normal[2] / length), size


class Coupling(Table):
    """How the two descriptions are joined (sec. 3.2); deck table ``[coupling]``.

    Attributes
    ----------
    kind : "paper", "paper_a" or "exact"
        "paper" (reading B): nodes of the overlap get the lumped peridynamic force only, as the sentence under
        eq. (26) says. "paper_a" (reading A): overlap elements keep their internal force as well, eq. (18). "exact":
        reading B with fitted bond factors, the ones that balance every uniform strain across the interface.
    overlap : int, >= 1
        Layers of cells, on the finite-element side of the interface, where both descriptions live.
    """

    kind: Literal["paper", "paper_a", "exact"] = key("paper")
    overlap: int = key(1, ge=1)


class _Selection(Table):
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
        problems = _corner_problems(self.lower, self.upper, equal=True)
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


class BodyForce(_Selection):
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


class Support(_Selection):
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


class Solver(Table):
    """How equilibrium is found (sec. 3.3); deck table ``[solver]``.

    Attributes
    ----------
    kind : "adr" or "cg"
        Adaptive dynamic relaxation, eqs (31)-(35), as in the paper; or preconditioned conjugate gradients.
    tolerance : float, above 0 and below 1, dimension 1
        Residual relative to the external force, or to the reactions where there is none.
    max_evaluations : int, >= 1
        Force evaluations of one load step before the run ends as not converged.
    """

    kind: Literal["adr", "cg"] = key("adr")
    tolerance: float = key(1.0e-6, gt=0, lt=1, dimension="1")
    max_evaluations: int = key(200_000, ge=1)


class Steps(Table):
    """Equilibrium at given load factors; deck table ``[stepping]`` with ``kind = "steps"``, which may be left out.

    Where bonds can break, those beyond their critical stretch break at each load until none is.

    Attributes
    ----------
    load_factors : floats, dimension 1
        Equilibrium is found at each; strictly rising from 0 (or strictly falling from 0).
    """

    kind: Literal["steps"] = key("steps")
    load_factors: tuple[float, ...] = key((1.0,), min_length=1, dimension="1")

    def problems(self) -> list[Problem]:
        """Load factors strictly monotone from 0."""
        factors = (0.0, *self.load_factors)
        sign = 1.0 if factors[1] > 0.0 else -1.0
        for before, after in itertools.pairwise(factors):
            if not sign * after > sign * before:
                word = "different from" if before == 0.0 else "above" if sign > 0 else "below"
                return [
                    Problem(
                        "load_factors",
                        f"= {show(self.load_factors)} has {show(after)} after {show(before)}, but must "
                        f"strictly rise (or fall) from 0. Use a number {word} {show(before)}.",
                    )
                ]
        return []


class Ramp(Table):
    """The paper's load program (sec. 4.2): the load rises at each relaxation iteration; ``kind = "ramp"``.

    Attributes
    ----------
    increment : float, > 0, dimension 1
        Of the load factor, an iteration.
    end_load_factor : float, > 0, dimension 1
        The run ends here,
    end_reaction : float, 0 to below 1, dimension 1
        or when the reaction has fallen below this fraction of its peak.
    report_every : int, >= 1
        Iterations between two rows of the history, which are frames of the fields as well.
    """

    kind: Literal["ramp"]
    increment: float = key(gt=0, dimension="1", remedy="Give the rise of the load factor an iteration, e.g. 1.0e-6.")
    end_load_factor: float = key(1.0, gt=0, dimension="1")
    end_reaction: float = key(0.05, ge=0, lt=1, dimension="1")
    report_every: int = key(1000, ge=1)

    def problems(self) -> list[Problem]:
        """A ramp of at least one iteration."""
        if self.increment <= self.end_load_factor:
            return []
        return [
            Problem(
                "increment",
                f"= {show(self.increment)} is above end_load_factor = {show(self.end_load_factor)}: a ramp without an "
                "iteration. Use a smaller increment.",
            )
        ]


class Events(Table):
    """From break to break at exact loads; ``kind = "events"``.

    Attributes
    ----------
    eta : float, 1e-6 to below 0.5, dimension 1
        Bonds within this fraction of their critical stretch break together with the first.
    inner_iterations : int, >= 1
        Sweeps of relaxation between two batches of breaks in an avalanche, fewer where the residual gets to 1e-4.
    arrest_tolerance : float, above 0 and below 1, dimension 1
        Relative residual above which no state counts as stable; one below it does when a tenfold smaller residual
        moves neither the load of the next break nor a bond to its limit (`stepping.arrest`).
    end_load_factor : float or None, > 0, dimension 1
        The run ends here; None (default): no such limit.
    end_reaction : float, above 0 and below 1, dimension 1
        The run ends when the reaction at held load has fallen below this fraction of the peak.
    control : "load" or "energy"
        "load": broken bonds unload the body at a held load, until none is left to break. "energy": after each batch
        the load is scaled so that the next bond is about to break, which follows snap-backs.
    report_every : int, >= 1
        Batches between two rows of the history within an avalanche.
    """

    kind: Literal["events"]
    eta: float = key(1.0e-3, ge=1e-6, lt=0.5, dimension="1")
    inner_iterations: int = key(8, ge=1)
    arrest_tolerance: float = key(1.0e-3, gt=0, lt=1, dimension="1")
    end_load_factor: float | None = key(None, gt=0, dimension="1")
    end_reaction: float = key(0.05, gt=0, lt=1, dimension="1")
    control: Literal["load", "energy"] = key("load")
    report_every: int = key(10, ge=1)


def _steps_by_default(value: Any) -> Any:
    return {"kind": "steps", **value} if isinstance(value, dict) else value


Stepping = Annotated[Steps | Ramp | Events, Field(discriminator="kind"), BeforeValidator(_steps_by_default)]


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
    """Displacement at a named point; a ``[[probes]]`` table with ``kind = "displacement"``."""

    kind: Literal["displacement"]
    name: str = key(min_length=1, remedy="Give the probe a name; results are listed under it.")
    point: Vector = key(dimension="length", remedy="Give the point, for example [5.0, 0.0, 0.0].")


class BarProbe(Table):
    """Comparison with a uniform bar under tension; a ``[[probes]]`` table with ``kind = "bar"``.

    Attributes
    ----------
    axis : "x", "y" or "z"
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
    """

    kind: Literal["line"]
    name: str = key(min_length=1, remedy="Give the probe a name; its file is called by it.")
    start: Vector = key(dimension="length", remedy="Give the first point, for example [-4.5, -1.5, 0.0].")
    stop: Vector = key(dimension="length", remedy="Give the last point, for example [4.5, -1.5, 0.0].")
    n: int = key(101, ge=2, le=100_000)

    def problems(self) -> list[Problem]:
        """A name that a file can have, and two different ends."""
        problems = []
        if not re.fullmatch(r"[A-Za-z0-9_-]+", self.name):
            problems.append(
                Problem("name", f"= {show(self.name)} names a file. Use letters, digits, - and _ only.")
            )
        if self.start == self.stop:
            problems.append(Problem("stop", f"= {show(self.stop)} is the start as well. Give another end."))
        return problems


Probe = Annotated[DisplacementProbe | BarProbe | LineProbe, Field(discriminator="kind")]


class Output(Table):
    """What is written beside the summary and the history; deck table ``[output]``.

    Attributes
    ----------
    fields : bool
        ``points.vtkhdf`` and ``elements.vtkhdf``.
    figures : bool
    damage : bool
        Local damage of the peridynamic points (eq. 5) in ``points.vtkhdf``.
    """

    fields: bool = key(True)
    figures: bool = key(True)
    damage: bool = key(False)

    def problems(self) -> list[Problem]:
        """A file for the damage to stand in."""
        if self.damage and not self.fields:
            return [Problem("damage", "= true is a field, and fields = false writes none. Change one of the two.")]
        return []


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


class Scene(Table):
    """What to simulate, complete and frozen; the whole deck.

    Raises
    ------
    pydantic.ValidationError
        Value out of range, wrong type, unknown key, or a check of ``CHECKS``. ``deck.parse_deck`` collects
        all of them as plain sentences.
    """

    title: str = key("")
    units: Units = Field(default_factory=Units)
    mesh: Mesh = key(remedy="Add a table [mesh] with lower, upper and spacing.")
    material: Material = key(remedy="Add a table [material] with youngs_modulus.")
    materials: dict[str, Material] = key({})
    interfaces: tuple[Interface, ...] = key(())
    regions: tuple[Region, ...] = key(
        min_length=1, remedy="Add at least one table [[regions]] with name and model."
    )
    peridynamics: Peridynamics = Field(default_factory=Peridynamics)
    cracks: tuple[Crack, ...] = key(())
    coupling: Coupling = Field(default_factory=Coupling)
    loads: tuple[Load, ...] = key(())
    supports: tuple[Support, ...] = key(())
    solver: Solver = Field(default_factory=Solver)
    stepping: Stepping = Field(default_factory=Steps)
    probes: tuple[Probe, ...] = key(())
    output: Output = Field(default_factory=Output)
    checkpoint: Checkpoint = Field(default_factory=Checkpoint)

    def problems(self) -> list[Problem]:
        """What ``CHECKS`` find between the tables."""
        return find_problems({name: getattr(self, name) for name in type(self).model_fields})

    @property
    def has_peridynamics(self) -> bool:
        """Whether some region is described by peridynamics."""
        return _has_model(self.regions, "peridynamics")

    @property
    def has_finite_elements(self) -> bool:
        """Whether some region is described by finite elements."""
        return _has_model(self.regions, "finite_elements")

    @property
    def kinematics(self) -> Literal["linear", "finite"]:
        """Of bonds and elements; what ``peridynamics.kinematics`` stands for where it is not given."""
        return self.peridynamics.kinematics or ("finite" if self.has_peridynamics else "linear")

    @property
    def can_fail(self) -> bool:
        """Whether the deck has a limit for some bond."""
        return any(entry.can_fail for entry in (self.material, *self.materials.values(), *self.interfaces))

    @property
    def is_coupled(self) -> bool:
        """Whether the scene has both descriptions."""
        return self.has_peridynamics and self.has_finite_elements


def _check_cracks(cracks: Sequence[Crack], regions: Sequence[Region]) -> list[Problem]:
    if not cracks or _has_model(regions, "peridynamics"):
        return []
    return [Problem("cracks", "cut bonds, and no region has any. Describe the region of the crack by peridynamics.")]


def _check_failure(
    material: Material,
    materials: dict[str, Material],
    interfaces: Sequence[Interface],
    regions: Sequence[Region],
    stepping: Any,
) -> list[Problem]:
    """Failure needs bonds that may break, and a program that breaks them needs failure."""
    tables = _all_materials(material, materials)
    if not _has_model(regions, "peridynamics"):
        problems = [
            Problem(
                f"{where}.{'fracture_energy' if table.critical_stretch is None else 'critical_stretch'}",
                "breaks bonds, and no region has any. Remove it, or describe a region by peridynamics.",
            )
            for where, table in tables.values()
            if table.can_fail
        ]
        return problems or _needs_failure(
            stepping, "finite elements do not break. Describe a region by peridynamics."
        )
    bonded = [region for region in regions if region.model == "peridynamics"]
    breakable = any(tables[region.material][1].can_fail for region in bonded if region.material in tables)
    if not breakable and not any(interface.can_fail for interface in interfaces):
        return _needs_failure(
            stepping, "nothing says when bonds break. Give material.critical_stretch or material.fracture_energy."
        )
    if all(region.may_fail is False for region in bonded):
        return [
            Problem("regions", "with peridynamics all have may_fail = false: no bond can break. Let one of them fail.")
        ]
    return []


def _needs_failure(stepping: Any, reason: str) -> list[Problem]:
    if stepping.kind == "steps":
        return []
    return [Problem("stepping.kind", f"= {show(stepping.kind)} follows failure, and {reason}")]


def _check_stepping_solver(stepping: Any, solver: Solver) -> list[Problem]:
    needed = {"ramp": "adr", "events": "cg"}.get(stepping.kind, solver.kind)
    if solver.kind == needed:
        return []
    return [
        Problem(
            "solver.kind",
            f"= {show(solver.kind)} does not go with stepping.kind = {show(stepping.kind)}, which "
            + ("is relaxation" if needed == "adr" else "needs a solver for equilibrium")
            + f'. Use "{needed}".',
        )
    ]


def _check_something_loads(stepping: Any, loads: Sequence[Any], supports: Sequence[Support]) -> list[Problem]:
    """Failure needs a load: a force, or a support that moves."""
    amounts = [
        component
        for load in loads
        for vector in (getattr(load, "total", None), getattr(load, "density", None), getattr(load, "traction", None))
        for component in vector or ()
    ] + [component for support in supports for component in (support.x, support.y, support.z)]
    if stepping.kind == "steps" or any(amounts):
        return []
    return [
        Problem(
            "stepping.kind",
            f"= {show(stepping.kind)} raises the load until bonds break, and nothing loads the body. "
            "Add a table [[loads]], or a support that moves.",
        )
    ]


def _check_damage(output: Output, regions: Sequence[Region]) -> list[Problem]:
    if not output.damage or _has_model(regions, "peridynamics"):
        return []
    return [Problem("output.damage", "= true counts broken bonds, and no region has any. Remove it.")]


def _has_model(regions: Sequence[Region], model: str) -> bool:
    models = [getattr(region, "model", None) for region in regions]
    if model not in models and (None in models or not models):
        raise AttributeError("model")  # a partial scene does not tell
    return model in models


def _all_materials(material: Material, materials: dict[str, Material]) -> dict[str, tuple[str, Material]]:
    """Key in the deck and table of every material, by name."""
    return {DEFAULT_MATERIAL: ("material", material)} | {
        name: (f"materials.{name}", table) for name, table in materials.items()
    }


def _check_poissons_ratio(
    material: Material, materials: dict[str, Material], regions: Sequence[Region]
) -> list[Problem]:
    bonded = {
        getattr(region, "material", None) for region in regions if getattr(region, "model", None) == "peridynamics"
    }
    return [
        Problem(
            f"{where}.poissons_ratio",
            f"= {show(table.poissons_ratio)} is not 1/4, the only value of bond-based peridynamics. "
            "Use 0.25, or describe every region of this material by finite_elements.",
        )
        for name, (where, table) in _all_materials(material, materials).items()
        if name in bonded and table.poissons_ratio != PERIDYNAMIC_POISSONS_RATIO
    ]


def _check_material_names(materials: dict[str, Material]) -> list[Problem]:
    problems = []
    for name in materials:
        if name == DEFAULT_MATERIAL:
            problems.append(Problem(f"materials.{name}", "is the name of the table [material]. Choose another name."))
        elif len(name) > LONGEST_NAME:
            text = f"is longer than {LONGEST_NAME} characters. Shorten it."
            problems.append(Problem(f"materials.{show(name)}", text))
        elif not re.fullmatch(r"[A-Za-z0-9_-]+", name):
            problems.append(
                Problem(f"materials.{show(name)}", "is not a name. Use letters, digits, - and _ only.")
            )
    return problems


def _check_region_materials(
    material: Material, materials: dict[str, Material], regions: Sequence[Region]
) -> list[Problem]:
    """Every region has a material, and every material a region."""
    if not regions:
        return []
    tables = _all_materials(material, materials)
    problems = _unknown_names([(f"regions.{k}.material", region.material) for k, region in enumerate(regions)], tables)
    if problems:  # a misspelt name may be the missing use of another
        return problems
    used = {region.material for region in regions}
    for name, (where, _) in tables.items():
        if name not in used:
            remedy = (
                f'Give a region material = "{name}", or remove the table.'
                if name != DEFAULT_MATERIAL
                else "Let a region without the key material use it: write the values of another material there."
            )
            problems.append(Problem(where, f"is the material of no region. {remedy}"))
    return problems


def _check_contrast(
    material: Material, materials: dict[str, Material], interfaces: Sequence[Interface]
) -> list[Problem]:
    """Residuals of all materials are weighed together, and stop at the round-off of the stiffest."""
    moduli = {where: table.youngs_modulus for where, table in _all_materials(material, materials).values()}
    moduli |= {f"interfaces.{k}": i.youngs_modulus for k, i in enumerate(interfaces) if i.youngs_modulus is not None}
    stiffest, softest = max(moduli, key=moduli.get), min(moduli, key=moduli.get)
    contrast = moduli[stiffest] / moduli[softest]
    if contrast <= MOST_CONTRAST * (1.0 + 1e-9):
        return []
    return [
        Problem(
            f"{softest}.youngs_modulus",
            f"= {show(moduli[softest])} is {contrast:.3g} times below {stiffest}.youngs_modulus = "
            f"{show(moduli[stiffest])}: round-off of the stiff would hide the soft. Keep them within "
            f"{MOST_CONTRAST:g}; leave out what carries nothing, and support what does not give.",
        )
    ]


def _check_interfaces(
    material: Material, materials: dict[str, Material], regions: Sequence[Region], interfaces: Sequence[Interface]
) -> list[Problem]:
    if not interfaces:
        return []
    if not _has_model(regions, "peridynamics"):
        return [Problem("interfaces", "are of bonds, and no region has any. Remove them.")]
    tables = _all_materials(material, materials)
    first: dict[frozenset[str], int] = {}
    problems = []
    for index, interface in enumerate(interfaces):
        where = f"interfaces.{index}.between"
        problems += _unknown_names([(where, name) for name in interface.between], tables)
        pair = frozenset(interface.between)
        if pair in first:
            problems.append(
                Problem(where, f"= {show(interface.between)} is there already as interfaces.{first[pair]}. Keep one.")
            )
        first.setdefault(pair, index)
    return problems


def _unknown_names(uses: Iterable[tuple[str, str]], tables: dict[str, Any]) -> list[Problem]:
    problems = []
    for where, name in uses:
        if name not in tables:
            hint = did_you_mean(name, tables) if len(problems) < MOST_HINTS else ""
            remedy = hint or f" The materials are {', '.join(itertools.islice(tables, MOST_HINTS))}."
            problems.append(Problem(where, f"has {show(name)}, which is not the name of a material.{remedy}"))
    return problems


def _check_cutoff(mesh: Mesh, peridynamics: Peridynamics, regions: Sequence[Region]) -> list[Problem]:
    """A point must reach the next cell, or bodies fall apart."""
    if not _has_model(regions, "peridynamics"):
        return []
    return [] if mesh.spacing is None else cutoff_problems(peridynamics, mesh.spacing, "mesh.spacing")


def cutoff_problems(peridynamics: Peridynamics, edge: float, name: str) -> list[Problem]:
    """A cutoff radius below the edge of the cells, which the sentence calls ``name``."""
    internal_length, cutoff_radius = peridynamics.lengths(edge)
    if cutoff_radius >= edge * (1.0 - SPACING_TOLERANCE):
        return []
    if peridynamics.cutoff_radius is None:
        return [
            Problem(
                "peridynamics.internal_length",
                f"= {show(internal_length)} makes the cutoff radius 2.5 * internal_length = "
                f"{cutoff_radius:.12g}, below {name} = {show(edge)}: points would not reach "
                f"the next cell. Use at least {edge / CUTOFF_RATIO:.12g}; the paper uses {show(edge)}.",
            )
        ]
    return [
        Problem(
            "peridynamics.cutoff_radius",
            f"= {show(cutoff_radius)} is below {name} = {show(edge)}: points would not reach "
            f"the next cell. Use 2.5 * spacing = {CUTOFF_RATIO * edge:.12g}, or smaller cells.",
        )
    ]


def _check_region_names(regions: Sequence[Region]) -> list[Problem]:
    problems = _repeated_names("regions", regions)
    if len(regions) > MOST_REGIONS:
        text = f"are {len(regions)}, and at most {MOST_REGIONS} can be told apart. Join some of them."
        problems.append(Problem("regions", text))
    return problems


def _check_probe_names(probes: Sequence[Any]) -> list[Problem]:
    problems = _repeated_names("probes", probes)
    for index, probe in enumerate(probes):
        if getattr(probe, "name", None) in BAR_RESULTS:
            problems.append(
                Problem(f"probes.{index}.name", f'= "{probe.name}" is a result of bar probes. Choose another.')
            )
    bars = [index for index, probe in enumerate(probes) if isinstance(probe, BarProbe)]
    for index in bars[1:]:
        problems.append(
            Problem(
                f"probes.{index}.kind", f'= "bar" is there already as probes.{bars[0]}. Remove one of them.'
            )
        )
    return problems


def _repeated_names(table: str, items: Sequence[Any]) -> list[Problem]:
    first: dict[str, int] = {}
    problems = []
    for index, item in enumerate(items):
        name = getattr(item, "name", None)
        if name is None:
            continue
        if name in first:
            problems.append(
                Problem(
                    f"{table}.{index}.name",
                    f"= {show(name)} is the name of {table}.{first[name]} already. Choose another name.",
                )
            )
        first.setdefault(name, index)
    return problems


def _check_references(regions: Sequence[Region], loads: Sequence[Any]) -> list[Problem]:
    return _unknown_regions("loads", regions, loads)


def _check_support_references(regions: Sequence[Region], supports: Sequence[Any]) -> list[Problem]:
    return _unknown_regions("supports", regions, supports)


def _unknown_regions(table: str, regions: Sequence[Region], items: Sequence[Any]) -> list[Problem]:
    names = [region.name for region in regions]
    problems = []
    for index, item in enumerate(items):
        name = getattr(item, "region", None)
        if name is not None and name not in names:
            hint = did_you_mean(name, names) if len(problems) < MOST_HINTS else ""
            remedy = hint or f" The regions are {', '.join(names[:MOST_HINTS])}."
            problems.append(
                Problem(f"{table}.{index}.region", f"= {show(name)} is not the name of a region.{remedy}")
            )
    return problems


def _check_sets(table: str, mesh: Mesh, items: Sequence[Any]) -> list[Problem]:
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


def _check_tractions(regions: Sequence[Region], peridynamics: Peridynamics, loads: Sequence[Any]) -> list[Problem]:
    if _has_model(regions, "finite_elements") or peridynamics.surface_correction == "fitted":
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


def _check_mirrored_loads(mesh: Mesh, loads: Sequence[Any]) -> list[Problem]:
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


def _check_mirrored_supports(mesh: Mesh, supports: Sequence[Any]) -> list[Problem]:
    """A mirror plane stays where it is."""
    return [
        Problem(
            f"supports.{index}.{support.face[0]}",
            f'= {show(getattr(support, support.face[0]))} moves the mirror plane "{support.face}" (mesh.symmetry = '
            f"{show(mesh.symmetry)}). Remove it, or the mirror.",
        )
        for index, support in enumerate(supports)
        if support is not None and support.face in mesh.symmetry and getattr(support, support.face[0])
    ]


def _check_mirrored_bars(mesh: Mesh, probes: Sequence[Any]) -> list[Problem]:
    """A bar is compared from its fixed middle, or both ends, to its upper end."""
    problems = []
    for index, probe in enumerate(probes):
        if not isinstance(probe, BarProbe) or f"{probe.axis}+" not in mesh.symmetry:
            continue
        both = f"{probe.axis}-" in mesh.symmetry
        why = "a bar between two mirrors has no end" if both else "the probe compares the upper end of the bar"
        remedy = "Remove the probe" if both else f'Model the other half, with the mirror at "{probe.axis}-"'
        problems.append(
            Problem(f"probes.{index}.axis", f'= "{probe.axis}" ends at a mirror plane: {why}. {remedy}.')
        )
    return problems


def _check_fitted(
    mesh: Mesh,
    regions: Sequence[Region],
    material: Material,
    materials: dict[str, Material],
    peridynamics: Peridynamics,
    coupling: Coupling,
) -> list[Problem]:
    """An exact coupling is one with fitted factors; broken bodies need positive ones."""
    if not _has_model(regions, "peridynamics"):
        return []
    fitted, problems = peridynamics.surface_correction == "fitted", []
    if _has_model(regions, "finite_elements"):
        if fitted and coupling.kind != "exact":
            problems.append(
                Problem(
                    "coupling.kind",
                    f"= {show(coupling.kind)} is a reading of the paper, whose bonds are not fitted. "
                    'Use "exact", or another peridynamics.surface_correction.',
                )
            )
        elif coupling.kind == "exact" and not fitted:
            problems.append(
                Problem(
                    "coupling.kind",
                    '= "exact" needs bonds that balance uniform strains, and peridynamics.surface_correction = '
                    f'{show(peridynamics.surface_correction)} does not make them. Use "fitted".',
                )
            )
    if fitted and mesh.symmetry:
        problems.append(
            Problem(
                "mesh.symmetry",
                f'= {show(mesh.symmetry)} does not go with peridynamics.surface_correction = "fitted", whose '
                'surfaces are those of the whole body. Model all of it, or use "virial".',
            )
        )
    can_fail = any(entry.can_fail for entry in (material, *materials.values()))
    if fitted and can_fail and peridynamics.signs == "free":
        problems.append(
            Problem(
                "peridynamics.signs",
                '= "free" lets bonds push where they are stretched, and a body with broken bonds then has no stable '
                'equilibrium. Use "bounded", or surface_correction = "virial", for bonds that may break.',
            )
        )
    return problems


CHECKS: tuple[tuple[tuple[str, ...], Callable[..., list[Problem]]], ...] = (
    (("material", "materials", "regions"), _check_poissons_ratio),
    (("materials",), _check_material_names),
    (("material", "materials", "regions"), _check_region_materials),
    (("material", "materials", "interfaces"), _check_contrast),
    (("material", "materials", "regions", "interfaces"), _check_interfaces),
    (("mesh", "peridynamics", "regions"), _check_cutoff),
    (("cracks", "regions"), _check_cracks),
    (("material", "materials", "interfaces", "regions", "stepping"), _check_failure),
    (("stepping", "solver"), _check_stepping_solver),
    (("stepping", "loads", "supports"), _check_something_loads),
    (("output", "regions"), _check_damage),
    (("regions",), _check_region_names),
    (("probes",), _check_probe_names),
    (("regions", "loads"), _check_references),
    (("regions", "supports"), _check_support_references),
    (("regions", "peridynamics", "loads"), _check_tractions),
    (("mesh", "regions", "material", "materials", "peridynamics", "coupling"), _check_fitted),
    (("mesh", "regions"), functools.partial(_check_sets, "regions")),
    (("mesh", "loads"), functools.partial(_check_sets, "loads")),
    (("mesh", "supports"), functools.partial(_check_sets, "supports")),
    (("mesh", "loads"), _check_mirrored_loads),
    (("mesh", "supports"), _check_mirrored_supports),
    (("mesh", "probes"), _check_mirrored_bars),
)


def find_problems(tables: dict[str, Any]) -> list[Problem]:
    """Run every check of ``CHECKS`` whose tables are there, and return all findings.

    Tables may be partial (keys that are wrong by themselves left out, items None): a check that needs what is
    not there says nothing.
    """
    problems: list[Problem] = []
    for names, check in CHECKS:
        if all(name in tables for name in names):
            with contextlib.suppress(AttributeError):
                problems += check(*(tables[name] for name in names))
    return problems
