"""Bodies of the criterion study, and rules by which their bonds may break: for this study alone.

Lengths are in cells of the coarse mesh, Young's modulus is 1, the critical stretch `STRETCH`; plates two units thick,
pulled along x.
"""

from __future__ import annotations

from pathlib import Path

import meshio
import numpy as np

from pdfem_mpi import Scene, Simulation, read_deck

STRETCH = 1e-3
#: Corners of the six sides of a cell, in the order of VTK.
FACES = np.array([[0, 3, 7, 4], [1, 2, 6, 5], [0, 1, 5, 4], [3, 2, 6, 7], [0, 1, 2, 3], [4, 5, 6, 7]])
THICKNESS = 2.0
HELD = 2.0  # cells at each end whose bonds do not break
#: Half the length, the width, the width of what has to tear, and the mirror planes of each body.
BODIES = {
    "hole": (12.0, 20.0, 12.0, ("x-", "y-", "z-")),
    "notch": (7.0, 12.0, 8.0, ("x-", "z-")),
    "two holes": (9.5, 24.0, 12.0, ("z-",)),
    "strip": (6.0, 10.0, 10.0, ("z-",)),
}


def make_cells(body: str, h: float, mirrored: bool) -> np.ndarray:
    """Corners of hexahedra of edge ``h``, (n, 8, 3): of the whole body, or of what its mirror planes leave."""
    half, width, _, planes = BODIES[body]
    planes = planes if mirrored else ()
    low = [0.0 if "x-" in planes else -half, 0.0 if "y-" in planes else -width / 2, 0.0 if "z-" in planes else -1.0]
    high = [half, width / 2, 1.0]
    if body == "hole":  # of radius 4, half-way across a plate of 20
        return _cells(low, high, h, hole_radius=4.0, symmetry=[face for face in planes if face != "z-"])
    if body == "two holes":  # of radius 3, not abreast: two plates side by side, each longer at another end
        plate = _cells([-7.0, -6.0, low[2]], [7.0, 6.0, 1.0], h, hole_radius=3.0)
        rest = _cells([7.0, -6.0, low[2]], [12.0, 6.0, 1.0], h)
        parts = (plate, (-2.5, -6.0)), (rest, (-2.5, -6.0)), (plate, (2.5, 6.0)), (rest, (-16.5, 6.0))
        return np.concatenate([corners + np.array([*move, 0.0]) for corners, move in parts])
    cells = _cells(low, high, h)
    if body == "strip":
        return cells
    x, y = cells.mean(axis=1)[:, :2].T  # a notch 4 wide and 4 deep, with square corners
    return cells[(np.abs(x) > 2.0) | (y > -2.0)]


def _cells(low, high, h: float, **hole) -> np.ndarray:
    """Corners of the cells of a box, or of a plate with a hole, as a deck of elements has them."""
    mesh = {"kind": "plate_with_hole" if hole else "box", "lower": low, "upper": high, "spacing": h} | hole
    deck = {
        "mesh": mesh,
        "material": {"youngs_modulus": 1.0},
        "regions": [{"name": "all", "model": "finite_elements"}],
        "supports": [{"face": "x+", "x": 0.1}, {"face": "y+", "y": 0.0}, {"face": "z+", "z": 0.0}],
    }
    return Simulation(read_deck(deck)).cells.corners


def write_mesh(path: Path, corners: np.ndarray) -> None:
    """Write cells to a file, corners at one place as one node."""
    every = corners.reshape(-1, 3)
    _, first, number = np.unique(np.round(1e6 * every), axis=0, return_index=True, return_inverse=True)
    meshio.Mesh(every[first], [("hexahedron", number.reshape(-1, 8))]).write(path)


def make_scene(body: str, h: float, length: float, correction: str, mirrored: bool, folder: Path) -> Scene:
    """The body with cells of edge ``h`` and an internal length, pulled from break to break."""
    half, _, _, planes = BODIES[body]
    planes = planes if mirrored else ()
    path = folder / f"{body.replace(' ', '_')}-{h:g}{'-part' if mirrored else ''}.vtu"
    if not path.exists():
        write_mesh(path, make_cells(body, h, mirrored))
    inner, far, layers = half - HELD, 99.0, round(1.0 / h)
    regions = [
        {"name": "middle", "model": "peridynamics", "lower": [-inner, -far, -far], "upper": [inner, far, far]},
        {"name": "right", "model": "peridynamics", "lower": [inner, -far, -far], "may_fail": False},
    ]
    supports = [{"face": "x+", "layers": layers, "x": 0.1}]
    if "x-" not in planes:
        regions.append({"name": "left", "model": "peridynamics", "upper": [-inner, far, far], "may_fail": False})
        supports.append({"face": "x-", "layers": layers, "x": -0.1})
    deck = {
        "mesh": {"kind": "file", "path": str(path), "symmetry": planes},
        "material": {"youngs_modulus": 1.0, "critical_stretch": STRETCH},
        "regions": regions,
        "peridynamics": {
            "internal_length": length, "surface_correction": correction, "signs": "bounded", "kinematics": "linear",
        },
        "supports": supports,
        "solver": {"kind": "cg", "tolerance": 1e-8},
        "stepping": {"kind": "events", "report_every": 10**6, "end_reaction": 0.05 if h == 1.0 else 0.5},
    }  # fmt: skip
    return read_deck(deck)


def factors(simulation: Simulation) -> np.ndarray:
    """Factor of each listed bond over that of no correction, shape (n,)."""
    scene = simulation.scene
    settings = scene.peridynamics.model_copy(update={"surface_correction": "none"})
    plain = Simulation(scene.model_copy(update={"peridynamics": settings})).bonds()
    bonds = simulation.bonds()
    top = plain.points.max() + 1
    place = np.searchsorted(plain.points @ [top, 1], bonds.points @ [top, 1])
    return bonds.stiffness / plain.stiffness[place]


def weights(rule: str, simulation: Simulation, edge: float) -> tuple[np.ndarray, np.ndarray]:
    """What a rule multiplies the stretches of the listed bonds by before it compares: to set the load, and to break.

    Parameters
    ----------
    rule : text
        "all", "r>=A", "g>=A", "A<=g<=B" or "depth", several joined by " and " (bonds that do not set the load; they
        break with others), or "energy", "capped" (of all).
    edge : float
        Of the cells.
    """
    bonds, factor = simulation.bonds(), factors(simulation)
    if rule in ("energy", "capped"):  # 1/2 K s^2 of the bond, over what it is without correction
        both = np.sqrt(np.maximum(factor, 0.0))
        both = np.minimum(both, 1.0) if rule == "capped" else both
        return both, both
    setting = np.ones(len(factor))
    for term in rule.split(" and "):
        if term.startswith("r>="):
            setting *= bonds.length >= float(term[3:]) * edge
        elif term.startswith("g>="):
            setting *= factor >= float(term[3:])
        elif "<=g<=" in term:
            low, high = map(float, term.split("<=g<="))
            setting *= (factor >= low) & (factor <= high)
        elif term == "depth":
            setting *= ~_outer_points(simulation)[bonds.points].any(axis=1)
    return setting, np.ones(len(factor))


def _outer_points(simulation: Simulation) -> np.ndarray:
    """Points in the outer layer of a cell at the surface: closer to it than half a cell; bool, shape (n_points,)."""
    cells, points = simulation.cells, simulation.points.reshape(-1, 8, 3)
    corners = np.round(1e6 * cells.corners[cells.has_points])
    node = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)[1].reshape(-1, 8)
    middle = cells.corners[cells.has_points].mean(axis=1)
    # the four corners nearest to a point's side of the cell, for each of its three directions
    outer = np.zeros(points.shape[:2], bool)
    sides = np.sort(node[:, FACES], axis=2).reshape(-1, 4)
    _, number, count = np.unique(sides, axis=0, return_inverse=True, return_counts=True)
    alone = (count[number.reshape(-1)] == 1).reshape(-1, 6)
    for side, face in enumerate(FACES):
        away = cells.corners[cells.has_points][:, face].mean(axis=1) - middle
        near = ((points - middle[:, None]) * away[:, None]).sum(axis=2) > 0.0
        outer |= near & alone[:, side, None]
    return outer.reshape(-1)
