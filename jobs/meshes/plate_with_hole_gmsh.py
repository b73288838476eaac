"""The paper's plate with its circular hole (section 4.2, Fig. 13) as hexahedra that conform to the circle, by Gmsh.

    pip install gmsh
    python jobs/meshes/plate_with_hole_gmsh.py --spacing 0.05 plate.msh

A square of 1.4 in around the hole is cut by its diagonals into four transfinite sectors; the rest are boxes of cubic
cells. As many edges go around the hole as around the square: they are 0.45 spacings long at the hole.

Physical groups: the volumes ``elements`` (region 1, |x| > 2), ``bands`` (region 2, 1.5 < |x| < 2) and ``hole`` (region
3), and the surfaces ``left_end`` and ``right_end``.
"""

import argparse
import math
from pathlib import Path

import gmsh

LENGTH, WIDTH, THICKNESS, RADIUS = 9.0, 3.0, 0.2, 0.4  # in
BAND, INNER, SQUARE = 2.0, 1.5, 0.7  # |x| where region 2 ends and begins; half the square around the hole, about


def cells(length: float, spacing: float) -> int:
    """Number of cells along a length."""
    return max(1, round(length / spacing))


def make_plate(spacing: float, path: Path, version: float = 4.1) -> None:
    """Mesh the plate and write it.

    Parameters
    ----------
    spacing : float, dimension length
        Divides 0.1 in, so that all widths are whole numbers of it.
    path : Path
        Ends in .msh, .inp or another suffix that Gmsh writes.
    version : float
        Of the .msh format.
    """
    gmsh.initialize(["-noenv"], readConfigFiles=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.option.setNumber("Mesh.MshFileVersion", version)
        gmsh.model.add("plate")
        groups = _make_volumes(spacing)
        gmsh.model.geo.synchronize()
        for name, volumes in groups.items():
            gmsh.model.addPhysicalGroup(3, volumes, name=name)
        margin = 1e-6
        for name, x in (("left_end", -LENGTH / 2), ("right_end", LENGTH / 2)):
            box = (x - margin, -WIDTH, -THICKNESS, x + margin, WIDTH, THICKNESS)
            gmsh.model.addPhysicalGroup(2, [tag for _, tag in gmsh.model.getEntitiesInBoundingBox(*box, 2)], name=name)
        gmsh.model.mesh.generate(3)
        gmsh.write(str(path))
    finally:
        gmsh.finalize()


def _make_volumes(spacing: float) -> dict[str, list[int]]:
    """Patches between lines of constant x and y, the middle one with the hole, extruded; volumes by region."""
    geo = gmsh.model.geo
    square = spacing * cells(SQUARE, spacing)
    xs = (-LENGTH / 2, -BAND, -INNER, -square, square, INNER, BAND, LENGTH / 2)
    ys = (-WIDTH / 2, -square, square, WIDTH / 2)
    regions = ("elements", "bands", "hole", "hole", "hole", "bands", "elements")
    z = -THICKNESS / 2
    points = [[geo.addPoint(x, y, z) for y in ys] for x in xs]
    along = {}  # lines in x from (i, j), and in y
    for i, x in enumerate(xs):
        for j, y in enumerate(ys):
            for axis, (after, values, here) in enumerate((((i + 1, j), xs, x), ((i, j + 1), ys, y))):
                if after[axis] < len(values):
                    along[axis, i, j] = geo.addLine(points[i][j], points[after[0]][after[1]])
                    n_cells = cells(values[after[axis]] - here, spacing)
                    geo.mesh.setTransfiniteCurve(along[axis, i, j], n_cells + 1)

    patches = []  # region, surface, corners
    for i, region in enumerate(regions):
        for j in range(len(ys) - 1):
            edges = [along[0, i, j], along[1, i + 1, j], -along[0, i, j + 1], -along[1, i, j]]
            corners = [points[i][j], points[i + 1][j], points[i + 1][j + 1], points[i][j + 1]]
            if (i, j) == (3, 1):
                patches += [(region, *sector) for sector in _make_sectors(edges, corners, z, spacing)]
            else:
                patches.append((region, geo.addPlaneSurface([geo.addCurveLoop(edges)]), corners))

    volumes = {name: [] for name in regions}
    for region, surface, corners in patches:
        geo.mesh.setTransfiniteSurface(surface, "Left", corners)
        geo.mesh.setRecombine(2, surface)
        extruded = geo.extrude([(2, surface)], 0, 0, THICKNESS, [cells(THICKNESS, spacing)], recombine=True)
        volumes[region] += [tag for dimension, tag in extruded if dimension == 3]
    return volumes


def _make_sectors(edges, outer, z: float, spacing: float):
    """Four sectors between the hole and a square with these edges and corners; surfaces and their corners."""
    geo = gmsh.model.geo
    centre = geo.addPoint(0.0, 0.0, z)
    angles = [math.radians(225 + 90 * k) for k in range(4)]
    rim = [geo.addPoint(RADIUS * math.cos(a), RADIUS * math.sin(a), z) for a in angles]
    arcs = [geo.addCircleArc(rim[k], centre, rim[(k + 1) % 4]) for k in range(4)]
    spokes = [geo.addLine(rim[k], outer[k]) for k in range(4)]
    mean_spoke = (1.0 + math.sqrt(2.0)) / 2 * SQUARE - RADIUS
    for arc, spoke in zip(arcs, spokes, strict=True):
        geo.mesh.setTransfiniteCurve(arc, 2 * cells(SQUARE, spacing) + 1)
        geo.mesh.setTransfiniteCurve(spoke, cells(mean_spoke, spacing) + 1)
    sectors = []
    for k in range(4):
        after = (k + 1) % 4
        loop = geo.addCurveLoop([spokes[k], edges[k], -spokes[after], -arcs[k]])
        sectors.append((geo.addPlaneSurface([loop]), [rim[k], outer[k], outer[after], rim[after]]))
    return sectors


def main() -> None:
    """Read the command line."""
    parser = argparse.ArgumentParser(description="The paper's plate with a hole as hexahedra, by Gmsh.")
    parser.add_argument("--spacing", type=float, default=0.1, help="edge of a cell away from the hole (default 0.1)")
    parser.add_argument("path", type=Path, nargs="?", default=Path(__file__).with_name("plate_with_hole.msh"))
    arguments = parser.parse_args()
    make_plate(arguments.spacing, arguments.path)


if __name__ == "__main__":
    main()
