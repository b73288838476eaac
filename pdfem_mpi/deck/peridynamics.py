"""Bonds, cracks between them, and their coupling to elements: ``[peridynamics]``, ``[[cracks]]``, ``[coupling]``."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Literal

from pdfem_mpi.deck.materials import BOND_POISSONS_RATIO, Interface, Material, all_materials
from pdfem_mpi.deck.meshes import SPACING_TOLERANCE, Mesh
from pdfem_mpi.deck.polygons import crossing_problems
from pdfem_mpi.deck.regions import Region, can_have_bonds, has_model
from pdfem_mpi.deck.table import Problem, Table, Vector, key, show

MOST_CORNERS, FEW_CORNERS = 1000, 64  # of a crack: each bond near it is compared with all; all pairs are looked at
CUTOFF_RATIO = 2.5  # r_c / l of the paper (sec. 4.1, appendix B)


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
        twin of a symmetric body. 0.005 by default where bonds soften.
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

    ``kind = "polygon"`` may be left out; other shapes are in `deck.cracks`.

    Attributes
    ----------
    polygon : three or more points, dimension length
        Corners in order, in one plane, of edges that do not cross; the polygon may stick out of the body. Bonds
        through its edges are cut too.
    """

    kind: Literal["polygon"] = key("polygon")
    polygon: tuple[Vector, ...] = key(
        min_length=3,
        dimension="length",
        remedy="Give the corners in order, for example [[0.0, -0.1, -1.0], [1.0, -0.1, -1.0], [1.0, -0.1, 1.0]].",
    )

    def problems(self) -> list[Problem]:
        """Corners that span a plane and lie in it, and edges that do not cross."""
        if len(self.polygon) > MOST_CORNERS:
            count = f"{len(self.polygon):,} corners, and at most {MOST_CORNERS:,} serve"
            return [Problem("polygon", f"has {count}. Use fewer, or several cracks.")]
        crossing = crossing_problems(self.polygon)
        normal, size = polygon_normal(self.polygon)
        if normal is None:
            text = "has no area: its corners lie on a line. Give corners that span a plane."
            return crossing or [Problem("polygon", text)]
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
        return crossing

    def corners(self, lower: Sequence[float], upper: Sequence[float]) -> tuple[Vector, ...]:
        """Corners of the polygon that cuts; one of the deck's own does not depend on the box of the body."""
        return self.polygon


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


def check_cracks(cracks: Sequence[Crack], regions: Sequence[Region]) -> list[Problem]:
    if not cracks or has_model(regions, "peridynamics"):
        return []
    return [Problem("cracks", "cut bonds, and no region has any. Describe the region of the crack by peridynamics.")]


def check_cutoff(mesh: Mesh, peridynamics: Peridynamics, regions: Sequence[Region]) -> list[Problem]:
    """A point must reach the next cell, or bodies fall apart."""
    if not has_model(regions, "peridynamics"):
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


def check_volumetric(
    regions: Sequence[Region],
    material: Material,
    materials: dict[str, Material],
    interfaces: Sequence[Interface],
    peridynamics: Peridynamics,
) -> list[Problem]:
    """Fitted weights of a volumetric part are those of bonds that do not break."""
    tables = all_materials(material, materials)
    can_fail = any(entry.can_fail for entry in (material, *materials.values(), *interfaces))
    fitted = peridynamics.surface_correction == "fitted"
    if not has_model(regions, "peridynamics") or not (fitted and can_fail):
        return []
    bonded = {region.material for region in regions if can_have_bonds(region)}
    return [
        Problem(
            f"{where}.poissons_ratio",
            f'= {show(table.poissons_ratio)} does not go with peridynamics.surface_correction = "fitted" where bonds '
            'may break. Use "virial", or 0.25.',
        )
        for name, (where, table) in tables.items()
        if name in bonded and table.poissons_ratio != BOND_POISSONS_RATIO
    ]


def check_fitted(
    mesh: Mesh,
    regions: Sequence[Region],
    material: Material,
    materials: dict[str, Material],
    interfaces: Sequence[Interface],
    peridynamics: Peridynamics,
    coupling: Coupling,
) -> list[Problem]:
    """An exact coupling is one with fitted factors; broken bodies need positive ones."""
    if not has_model(regions, "peridynamics"):
        return []
    fitted, problems = peridynamics.surface_correction == "fitted", []
    if has_model(regions, "finite_elements"):
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
    if fitted and getattr(mesh, "doubled_nodes", "refuse") == "crack":
        why = 'keeps a crack across bonds, and peridynamics.surface_correction = "fitted" takes it for a surface.'
        problems.append(Problem("mesh.doubled_nodes", f'= "crack" {why} Use "virial".'))
    can_fail = any(entry.can_fail for entry in (material, *materials.values(), *interfaces))
    if fitted and can_fail and peridynamics.signs == "free":
        problems.append(
            Problem(
                "peridynamics.signs",
                '= "free" lets bonds push where they are stretched, and a body with broken bonds then has no stable '
                'equilibrium. Use "bounded", or surface_correction = "virial", for bonds that may break.',
            )
        )
    return problems
