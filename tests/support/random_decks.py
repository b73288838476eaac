"""Valid decks drawn from a seed: small bodies of every kind that a deck can ask for, in any units, anywhere.

Decks are drawn until one is consistent by the program's own checks that need a mesh; what those refuse is not
counted. The seed alone decides, so that a deck that finds something can be asked for again.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
from pydantic import ValidationError

from pdfem_mpi.body.discretization import discretize
from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.deck.table import SceneError
from pdfem_mpi.mesh import generators
from support.mesh_files import write_mesh

#: Cells of a body, at most; the tests' time grows with their square.
MOST_CELLS = 24
AXES = "xyz"
#: Critical stretch of bodies that break.
LIMIT = 0.004
#: Shift of corners of a distorted mesh, in cells.
JITTER = 0.2


@dataclasses.dataclass
class Draw:
    """What has been decided so far.

    Attributes
    ----------
    rng : numpy Generator
    long : int
        The axis along which the body is long, clamped at one end and pulled at the other.
    cells : tuple of int
    spacing, modulus : float
    origin : float64, shape (3,)
    """

    rng: np.random.Generator
    long: int
    cells: tuple[int, int, int]
    spacing: float
    modulus: float
    origin: np.ndarray

    def chance(self, p: float) -> bool:
        """True with probability ``p``."""
        return bool(self.rng.random() < p)

    def at(self, layer: float) -> float:
        """Position along the long axis, in cells from the clamped end."""
        return float(self.origin[self.long] + layer * self.spacing)

    def corner(self, layer: float, lower: bool) -> list[float]:
        """Corner of a box that ends at a layer and covers the whole cross-section."""
        corner = self.origin + (0.0 if lower else 1.0) * np.array(self.cells) * self.spacing
        corner[self.long] = self.at(layer)
        return corner.tolist()


def random_scene(seed: int, folder: Path) -> Scene:
    """The scene of a seed; a mesh file of it is written to the folder."""
    rng = np.random.default_rng([20261129, seed])
    while True:
        deck = draw_deck(rng, Path(folder) / f"mesh_{seed}.inp")
        deck["title"] = f"random {seed}"
        try:
            scene = Scene(**frozen(deck))
            discretize(scene)
        except (ValidationError, SceneError):
            continue
        return scene


def frozen(value):
    """Lists as tuples, all the way down: scenes convert nothing."""
    if isinstance(value, dict):
        return {name: frozen(entry) for name, entry in value.items()}
    return tuple(map(frozen, value)) if isinstance(value, list) else value


def draw_deck(rng: np.random.Generator, path: Path) -> dict:
    """The tables of a deck, which may not be a valid one; where its mesh is a file, it is written to the path."""
    cells = np.ones(3, int)
    while True:
        cells = np.array([rng.integers(1, 4), rng.integers(1, 4), rng.integers(1, 3)])
        long = int(rng.integers(3))
        cells[long] = rng.integers(4, 8)
        if cells.prod() <= MOST_CELLS:
            break
    spacing = float(f"{10.0 ** rng.uniform(-4, 3):.3g}")
    modulus = float(f"{10.0 ** rng.uniform(0, 11):.3g}")
    origin = spacing * np.round(rng.choice([0.0, 1.0, 300.0]) * rng.uniform(-1, 1, 3), 2)
    draw = Draw(rng, long, tuple(cells.tolist()), spacing, modulus, origin)
    deck: dict = {"output": {"figures": False}}
    kind = rng.choice(["box", "box", "box", "file", "plate"])
    if kind == "plate":
        return deck | _plate(draw)
    deck["mesh"] = _mesh(draw, kind, path)
    _regions(draw, deck)
    _bonds(draw, deck)
    _program(draw, deck)
    _loads(draw, deck)
    return deck


def _mesh(draw: Draw, kind: str, path: Path) -> dict:
    lower = draw.origin
    upper = draw.origin + draw.spacing * np.array(draw.cells)
    if kind == "file":
        box = generators.box(tuple(lower.tolist()), tuple(upper.tolist()), draw.cells)
        inside = (box.nodes > lower + 0.1 * draw.spacing) & (box.nodes < upper - 0.1 * draw.spacing)
        shift = draw.rng.uniform(-JITTER, JITTER, box.nodes.shape) * draw.spacing
        path.parent.mkdir(parents=True, exist_ok=True)
        write_mesh(path, dataclasses.replace(box, nodes=box.nodes + np.where(inside, shift, 0.0)))
        return {"kind": "file", "path": str(path), "spacing": draw.spacing}
    mesh = {"kind": "box", "lower": lower.tolist(), "upper": upper.tolist(), "spacing": draw.spacing}
    if draw.chance(0.3):  # the clamped end and the pulled one stay free of mirrors
        across = [d for d in range(3) if d != draw.long]
        faces = [f"{AXES[d]}{side}" for d in across for side in "-+" if draw.chance(0.35)]
        mesh["symmetry"] = faces
    return mesh


def _regions(draw: Draw, deck: dict) -> None:
    """Bands along the long axis: bonds, elements, or both beside each other, of one material or of several."""
    n, rng = draw.cells[draw.long], draw.rng
    model = rng.choice(["peridynamics", "coupled", "coupled", "elements"], p=[0.3, 0.3, 0.25, 0.15])
    overlap = 2 if n >= 6 and draw.chance(0.2) else 1
    bands: list[tuple[str, int]] = []  # model, layers
    if model == "peridynamics":
        bands = [("peridynamics", n)]
    elif model == "elements":
        bands = [("finite_elements", n)]
    else:
        elements = int(rng.integers(overlap + 1, n))
        bands = [("finite_elements", elements), ("peridynamics", n - elements)]
        if draw.chance(0.5):
            bands.reverse()
        deck["coupling"] = {"kind": str(rng.choice(["paper", "paper_a"])), "overlap": overlap}
    deck["material"] = {"youngs_modulus": draw.modulus}
    several = draw.chance(0.4)
    regions, first = [], 0
    for model, layers in bands:
        parts = [layers]
        if several and layers >= 2 + (model == "finite_elements") * overlap:
            near = int(rng.integers(1, layers)) if model == "peridynamics" else layers - 1
            parts = [near, layers - near]
            if model == "finite_elements" and first:  # the band next to the bonds comes first
                parts = [near, layers - near]
            elif model == "finite_elements":
                parts.reverse()
        for k, part in enumerate(parts):
            material = "default"
            far = model == "finite_elements" and len(parts) == 2 and part == parts[1 if first else 0]
            if several and len(parts) == 2 and (far if model == "finite_elements" else k == 1):
                material = f"m{len(regions)}"
                table = {"youngs_modulus": draw.modulus * float(f"{10.0 ** rng.uniform(-2, 2):.3g}")}
                if model == "finite_elements" and draw.chance(0.7):
                    table["poissons_ratio"] = float(f"{rng.uniform(-0.2, 0.45):.3g}")
                deck.setdefault("materials", {})[material] = table
            regions.append(
                {
                    "name": f"r{len(regions)}",
                    "model": model,
                    "material": material,
                    "lower": draw.corner(first, True),
                    "upper": draw.corner(first + part, False),
                }
            )
            first += part
    deck["regions"] = regions
    bonded = {region["material"] for region in regions if region["model"] == "peridynamics"}
    if len(bonded) == 2 and draw.chance(0.4):
        moduli = [deck["material"] if name == "default" else deck["materials"][name] for name in bonded]
        mean = float(np.sqrt(np.prod([table["youngs_modulus"] for table in moduli])))
        deck["interfaces"] = [{"between": sorted(bonded), "youngs_modulus": float(f"{mean:.3g}")}]


def _bonds(draw: Draw, deck: dict) -> None:
    rng = draw.rng
    if all(region["model"] != "peridynamics" for region in deck["regions"]):
        return
    table = {
        "kinematics": str(rng.choice(["linear", "finite"])),
        "surface_correction": str(rng.choice(["none", "appendix_a", "virial"])),
    }
    plain = "materials" not in deck and not deck["mesh"].get("symmetry")
    if plain and draw.chance(0.2):
        table |= {"surface_correction": "fitted", "signs": "bounded"}
        if "coupling" in deck:
            deck["coupling"]["kind"] = "exact"
    elif draw.chance(0.3):
        table["internal_length"] = float(f"{draw.spacing * rng.uniform(0.6, 1.3):.4g}")
    deck["peridynamics"] = table
    if draw.chance(0.35) and not (table["surface_correction"] == "fitted" and "coupling" in deck):
        deck["cracks"] = [{"polygon": _crack(draw, deck)}]


def _crack(draw: Draw, deck: dict) -> list[list[float]]:
    """A notch across a band of bonds from one side, through 0.3 to 0.7 of the width, askew."""
    bands = [region for region in deck["regions"] if region["model"] == "peridynamics"]
    band = bands[int(draw.rng.integers(len(bands)))]
    low, high = band["lower"][draw.long], band["upper"][draw.long]
    deep, wide = [d for d in range(3) if d != draw.long]
    place = low + draw.rng.uniform(0.2, 0.8) * (high - low)
    depth = draw.rng.uniform(0.3, 0.7) * draw.cells[deep] * draw.spacing
    slant = draw.rng.uniform(-0.4, 0.4) * draw.spacing
    corners = []
    for along, across in ((-0.5, -0.5), (1.0, -0.5), (1.0, 1.5), (-0.5, 1.5)):
        corner = draw.origin.copy()
        corner[draw.long] = place + slant * along
        corner[deep] += depth if along > 0 else -0.5 * draw.cells[deep] * draw.spacing
        corner[wide] += across * draw.cells[wide] * draw.spacing
        corners.append(corner.tolist())
    return corners


def _loads(draw: Draw, deck: dict) -> None:
    """Clamped at one end; forces, tractions or a moving support at the other."""
    rng, long = draw.rng, draw.long
    near, far = f"{AXES[long]}-", f"{AXES[long]}+"
    finite = deck.get("peridynamics", {}).get("kinematics") == "finite"
    strain = float(10.0 ** (rng.uniform(-4, -1.7) if finite else rng.uniform(-5, -2)))
    soft = min([deck["material"], *deck.get("materials", {}).values()], key=lambda table: table["youngs_modulus"])
    fails = deck["material"].get("critical_stretch") is not None
    across = [d for d in range(3) if d != long]
    area = draw.spacing**2 * draw.cells[across[0]] * draw.cells[across[1]]
    force = strain * soft["youngs_modulus"] * area
    slender = min(draw.cells[d] for d in across) / draw.cells[long] / 6.0
    side = np.where(np.arange(3) == long, 1.0, slender)

    def vector(size: float) -> list[float]:
        amount = size * side * rng.uniform(-1, 1, 3)
        if fails:
            amount[long] = abs(amount[long])  # no bond breaks in a body that is pushed together
        return [float(f"{c:.6g}") for c in amount]

    deck["supports"] = [{"face": near, "x": 0.0, "y": 0.0, "z": 0.0}]
    loads: list[dict] = []
    last = deck["regions"][-1]
    if draw.chance(0.2):
        deck["supports"].append({"face": far, AXES[long]: float(f"{strain * draw.cells[long] * draw.spacing:.4g}")})
    else:
        loads.append({"kind": "body_force", "face": far, "total": vector(force)})
    if last["model"] == "finite_elements" and draw.chance(0.7):
        nodal = str(rng.choice(["consistent", "equal"]))
        amount = {"total": vector(force)} if draw.chance(0.5) else {"traction": vector(force / area)}
        loads.append({"kind": "traction", "face": far, "nodal": nodal} | amount)
    if draw.chance(0.4):
        region = deck["regions"][int(rng.integers(len(deck["regions"])))]["name"]
        density = vector(force / (area * draw.spacing * draw.cells[long]))
        loads.append({"kind": "body_force", "region": region, "density": density})
    deck["loads"] = loads


def _program(draw: Draw, deck: dict) -> None:
    """One or two load steps, or events."""
    finite = deck.get("peridynamics", {}).get("kinematics") == "finite"
    # residuals of several materials stop at the round-off of the stiffest
    deck["solver"] = {"kind": "cg", "tolerance": 1e-8 if "materials" in deck else 1e-9 if finite else 1e-10}
    bonds, fitted = "peridynamics" in deck, deck.get("peridynamics", {}).get("surface_correction") == "fitted"
    free = sum(  # layers of bonds beyond the clamped one, whose bonds are held
        round((region["upper"][draw.long] - max(region["lower"][draw.long], draw.at(1))) / draw.spacing)
        for region in deck["regions"]
        if region["model"] == "peridynamics"
    )
    if bonds and not fitted and free >= 2 and draw.chance(0.25):
        for table in (deck["material"], *deck.get("materials", {}).values()):
            if table.get("poissons_ratio", 0.25) == 0.25:
                table["critical_stretch"] = LIMIT
        for region in deck["regions"]:
            region["may_fail"] = region["model"] == "peridynamics"
        deck["stepping"] = {"kind": "events", "end_reaction": 0.7, "report_every": 1000}
    elif draw.chance(0.3):
        deck["stepping"] = {"load_factors": [0.4, 1.0]}


def _plate(draw: Draw) -> dict:
    """An eighth of a plate with a hole between three mirror planes, pulled at its end; bonds around the hole."""
    h, rng = draw.spacing, draw.rng
    length, width = float(rng.integers(5, 8)), float(rng.integers(4, 6))
    lower = draw.origin
    upper = lower + h * np.array([length, width, 1.0])
    force = float(f"{10.0 ** rng.uniform(-5, -2.5) * draw.modulus * width * h * h:.4g}")
    regions = [{"name": "r0", "model": "peridynamics", "lower": lower.tolist(), "upper": upper.tolist()}]
    deck: dict = {"coupling": {"kind": str(rng.choice(["paper", "paper_a"]))}}
    if draw.chance(0.6):
        regions[0]["upper"] = [float(lower[0] + 4.0 * h), *upper[1:].tolist()]
        corner = [float(lower[0] + 4.0 * h), *lower[1:].tolist()]
        regions.append({"name": "r1", "model": "finite_elements", "lower": corner, "upper": upper.tolist()})
    finite = draw.chance(0.5)
    return deck | {
        "mesh": {
            "kind": "plate_with_hole",
            "lower": lower.tolist(),
            "upper": upper.tolist(),
            "spacing": h,
            "hole_radius": 2.0 * h,
            "symmetry": ["x-", "y-", "z-"],
        },
        "material": {"youngs_modulus": draw.modulus},
        "regions": regions,
        "peridynamics": {
            "kinematics": "finite" if finite else "linear",
            "surface_correction": str(rng.choice(["none", "appendix_a", "virial"])),
        },
        "loads": [{"kind": "body_force", "face": "x+", "total": [force, 0.0, 0.0]}],
        "solver": {"kind": "cg", "tolerance": 1e-9 if finite else 1e-10},
    }
