"""An L-shaped bracket of hexahedra with physical groups, by Gmsh: the mesh of docs/tutorial.md.

    pip install gmsh
    python jobs/tutorial/bracket_gmsh.py --spacing 2.5 bracket.msh

Two arms of 50 mm, 15 mm wide and 5 mm thick, meet in a corner. Rectangles are meshed in rows ("transfinite"), their
triangles are joined ("recombine"), and layers of cells are extruded along z: so all cells are hexahedra.

Physical groups: the volumes ``arms``, ``bands`` and ``corner``, the surfaces ``wall`` and ``tip``.
"""

import argparse
import itertools
from pathlib import Path

import gmsh

ARM, WIDTH, THICKNESS = 50.0, 15.0, 5.0  # mm
CORNER, BAND = 25.0, 35.0  # from the outer edge: where the corner ends and where the bands end


def make_bracket(spacing: float, path: Path) -> None:
    """Mesh the bracket and write it; ``spacing``, the edge of a cell, divides 5 mm."""
    gmsh.initialize(["-noenv"], readConfigFiles=False)
    gmsh.option.setNumber("General.Terminal", 0)
    geo = gmsh.model.geo
    ends = (0.0, WIDTH, CORNER, BAND, ARM)  # along each arm, from the outer corner of the L
    cells = [round((after - before) / spacing) for before, after in itertools.pairwise(ends)]

    def point(i, j):
        """The point at ends[i] to the right and ends[j] down from the outer corner; each is made once."""
        if (i, j) not in points:
            points[i, j] = geo.addPoint(ends[i], ARM - ends[j], 0.0)
        return points[i, j]

    def line(a, b, n):
        """The line between two points, of n cells; each is made once."""
        if (b, a) in lines:
            return -lines[b, a]
        if (a, b) not in lines:
            lines[a, b] = geo.addLine(point(*a), point(*b))
            geo.mesh.setTransfiniteCurve(lines[a, b], n + 1)
        return lines[a, b]

    points, lines = {}, {}
    groups = {"corner": [], "bands": [], "arms": []}
    for i, j, name in (
        (0, 0, "corner"), (1, 0, "corner"), (0, 1, "corner"), (2, 0, "bands"), (0, 2, "bands"), (3, 0, "arms"),
        (0, 3, "arms"),
    ):  # fmt: skip
        corners = [(i, j + 1), (i + 1, j + 1), (i + 1, j), (i, j)]
        sides = zip(corners, corners[1:] + corners[:1], (cells[i], cells[j], cells[i], cells[j]), strict=True)
        surface = geo.addPlaneSurface([geo.addCurveLoop([line(a, b, n) for a, b, n in sides])])
        geo.mesh.setTransfiniteSurface(surface)
        geo.mesh.setRecombine(2, surface)
        layers = [round(THICKNESS / spacing)]
        made = geo.extrude([(2, surface)], 0, 0, THICKNESS, layers, recombine=True)
        groups[name] += [tag for dimension, tag in made if dimension == 3]
    geo.synchronize()
    for name, volumes in groups.items():
        gmsh.model.addPhysicalGroup(3, volumes, name=name)
    far, near = 2 * ARM, 1e-6
    for name, box in (
        ("wall", (-far, -near, -far, far, near, far)),
        ("tip", (ARM - near, -far, -far, ARM + near, far, far)),
    ):
        surfaces = [tag for _, tag in gmsh.model.getEntitiesInBoundingBox(*box, 2)]
        gmsh.model.addPhysicalGroup(2, surfaces, name=name)
    gmsh.model.mesh.generate(3)
    gmsh.write(str(path))
    gmsh.finalize()


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="An L-shaped bracket of hexahedra, by Gmsh.")
    parser.add_argument("--spacing", type=float, default=2.5, help="edge of a cell in mm (default 2.5)")
    parser.add_argument("path", type=Path)
    arguments = parser.parse_args()
    make_bracket(arguments.spacing, arguments.path)
