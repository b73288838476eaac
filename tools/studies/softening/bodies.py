"""Bodies of the study of bonds that soften, as decks: `centre crack`, `hole`, `notch`, `beam` and `L-panel`.

All are one cell thick between mirror planes, in plane strain, and nothing fails within a cutoff of loaded ends. No
mirror plane lies in a crack's plane. Concrete follows the curve with a kink, the others a straight branch.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

#: Steel-like, psi and lbf/in; and the concretes of the two experiments, MPa and N/mm.
METAL = {"youngs_modulus": 1.0e7, "tensile_strength": 34300.0, "fracture_energy": 50.0}
KINK = {"kink_stretch_ratio": 0.26, "kink_force_ratio": 0.114}
DANISH = {"youngs_modulus": 26110.0, "tensile_strength": 2.59, "fracture_energy": 0.108} | KINK
WINKLER = {"youngs_modulus": 25850.0, "tensile_strength": 2.7, "fracture_energy": 0.09} | KINK


@dataclass(frozen=True)
class Body:
    """One body of the study.

    Attributes
    ----------
    h : float, dimension length
        Of its coarse cells.
    material : dict
    ligament : float, dimension length
        What a crack has to cut.
    thickness : float, dimension length
        Of the real body: loads are told for it.
    write : callable
        ``write(h, material, folder)`` gives a deck, and leaves the mesh that it needs in the folder.
    measured : float or None, dimension force
    """

    h: float
    material: Mapping[str, float]
    ligament: float
    thickness: float
    write: Callable[[float, Mapping[str, float], Path], str]
    measured: float | None = None


def table(name: str, entries: Mapping[str, object]) -> str:
    """A table of a deck."""
    lines = [f"{key} = {_toml(value)}" for key, value in entries.items()]
    return f"[{name}]\n" + "\n".join(lines) + "\n"


def _toml(value: object) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return f'"{value}"'
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_toml(item) for item in value) + "]"
    return str(value)


def _common(title: str, units: tuple[str, str], material: Mapping[str, float], end: float, **stepping) -> str:
    events = {"kind": "events", "report_every": 100000, "end_reaction": end} | stepping
    return "".join((
        f'title = "{title}"\n',
        table("units", {"length": units[0], "force": units[1]}),
        table("material", material),
        table("peridynamics", {"kinematics": "linear", "surface_correction": "virial"}),
        table("solver", {"kind": "cg", "tolerance": 1.0e-8}),
        table("stepping", events),
        table("output", {"fields": False, "figures": False}),
    ))  # fmt: skip


def _region(name: str, model: str = "peridynamics", **keys) -> str:
    return table("[regions]", {"name": name, "model": model} | keys)


def _pulled(half: float, by: float) -> str:
    """Both ends of a plate moved apart."""
    return "".join(
        table("[supports]", {"face": f"x{side}", "x": sign * by}) for side, sign in (("-", -1.0), ("+", 1.0))
    )


def _plate(title: str, half: float, held: float, material: Mapping[str, float], mesh: str, more: str = "") -> str:
    """A plate whose ends may not fail over a cutoff."""
    inner = half - held
    regions = (
        _region("left", upper=[-inner, 99.0, 99.0], may_fail=False)
        + _region("middle", lower=[-inner, -99.0, -99.0], upper=[inner, 99.0, 99.0])
        + _region("right", lower=[inner, -99.0, -99.0], may_fail=False)
    )
    deck = _common(title, ("in", "lbf"), material, 0.2)
    return deck + mesh + regions + _pulled(half, 0.01 * half) + more


def _box(low, high, h: float) -> str:
    entries = {"lower": [*low, 0.0], "upper": [*high, h], "spacing": h, "symmetry": ["z-", "z+"]}
    return table("mesh", entries)


def centre_crack(h: float, material: Mapping[str, float], folder: Path) -> str:
    """2.0 x 1.2, a crack of 0.6 across it on a plane between cells."""
    crack = [[0.0, -0.3, -1.0], [0.0, 0.3, -1.0], [0.0, 0.3, 1.0], [0.0, -0.3, 1.0]]
    more = table("[cracks]", {"polygon": crack})
    return _plate("centre crack", 1.0, 0.3, material, _box([-1.0, -0.6], [1.0, 0.6], h), more)


def hole(h: float, material: Mapping[str, float], folder: Path) -> str:
    """2.4 x 2.0 with a hole of radius 0.4, cells that follow it."""
    entries = {"kind": "plate_with_hole", "lower": [-1.2, -1.0, 0.0], "upper": [1.2, 1.0, h], "hole_radius": 0.4}
    mesh = table("mesh", entries | {"spacing": h, "symmetry": ["z-", "z+"]})
    return _plate("hole", 1.2, 0.3, material, mesh)


def notch(h: float, material: Mapping[str, float], folder: Path) -> str:
    """1.4 x 1.2 with a notch of 0.4 x 0.4 with square corners at the middle of its lower edge."""
    path = folder / f"notch-{h:g}.inp"

    def inside(x, y):
        return not (abs(x) < 0.2 and y < -0.2)

    write_grid(path, (-0.7, -0.6), (0.7, 0.6), h, inside, {})
    return _plate("notch", 0.7, 0.3, material, _file(path))


def beam(h: float, material: Mapping[str, float], folder: Path) -> str:
    """The Danish beam: span 800, 100 deep, notch of 10 at the middle; rollers at the ends, elements beside +-60."""
    path = folder / f"beam-{h:g}.inp"
    ends = {
        "rollers": lambda x, y: abs(abs(x) - 400.0) < 1e-6 and y < 1e-6,
        "load": lambda x, y: abs(x) <= h + 1e-6 and y > 100.0 - 1e-6,
    }
    write_grid(path, (-400.0, 0.0), (400.0, 100.0), h, lambda x, y: True, ends)
    inner, free = 60.0, 30.0  # a cutoff of the coarse cells between what may fail and the elements
    bonds = (
        _region("bonds", lower=[-free, 0.0, 0.0], upper=[free, 100.0, h])
        + _region("rim left", lower=[-inner, 0.0, 0.0], upper=[-free, 100.0, h], may_fail=False)
        + _region("rim right", lower=[free, 0.0, 0.0], upper=[inner, 100.0, h], may_fail=False)
        + _region("left", "finite_elements", upper=[-inner, 100.0, h])
        + _region("right", "finite_elements", lower=[inner, 0.0, 0.0])
    )
    notch_ = [[0.0, -10.0, -1000.0], [0.0, 10.0, -1000.0], [0.0, 10.0, 1000.0], [0.0, -10.0, 1000.0]]
    deck = _common("beam", ("mm", "N"), material, 0.3, end_load_factor=1.6)
    return (
        deck
        + _file(path)
        + bonds
        + table("[cracks]", {"polygon": notch_})
        + _roller("rollers", y=0.0)
        + table("[supports]", {"lower": [-10.0, 100.0 - h, 0.0], "upper": [10.0, 100.0, h], "y": -1.0})
    )


def l_panel(h: float, material: Mapping[str, float], folder: Path) -> str:
    """Winkler's panel: 500 x 500 without a quarter, held below, lifted at x = 470 under the arm."""
    path = folder / f"l_panel-{h:g}.inp"
    at = round(470.0 / h) * h
    sets = {"base": lambda x, y: y < 1e-6, "load": lambda x, y: abs(y - 250.0) < 1e-6 and abs(x - at) < 1e-6}
    write_grid(path, (0.0, 0.0), (500.0, 500.0), h, lambda x, y: not (x > 250.0 and y < 250.0), sets)
    # a cutoff of the coarse cells between what may fail and the elements
    rim = {"model": "peridynamics", "may_fail": False}
    regions = (
        _region("bonds", lower=[0.0, 190.0, 0.0], upper=[300.0, 360.0, h])
        + _region("rim below", **rim, lower=[0.0, 160.0, 0.0], upper=[330.0, 190.0, h])
        + _region("rim above", **rim, lower=[0.0, 360.0, 0.0], upper=[330.0, 390.0, h])
        + _region("rim right", **rim, lower=[300.0, 190.0, 0.0], upper=[330.0, 360.0, h])
        + _region("below", "finite_elements", upper=[330.0, 160.0, h])
        + _region("above", "finite_elements", lower=[0.0, 390.0, 0.0], upper=[330.0, 500.0, h])
        + _region("arm", "finite_elements", lower=[330.0, 0.0, 0.0])
    )
    deck = _common("L-panel", ("mm", "N"), material, 0.6, end_load_factor=1.0)
    return deck + _file(path) + regions + _roller("base", x=0.0, y=0.0) + _roller("load", y=1.0)


def _file(path: Path) -> str:
    return table("mesh", {"kind": "file", "path": str(path), "symmetry": ["z-", "z+"]})


def _roller(name: str, **motion: float) -> str:
    return table("[supports]", {"set": name} | motion)


def with_length(deck: str, length: float) -> str:
    """The deck with an internal length."""
    return deck.replace("[peridynamics]\n", f"[peridynamics]\ninternal_length = {length!r}\n", 1)


def write_grid(path: Path, low, high, h: float, inside, sets) -> None:
    """Square cells whose centres are inside, one deep, and sets of nodes by place."""
    nx, ny = (round((b - a) / h) for a, b in zip(low, high, strict=True))
    number: dict[tuple[int, int, int], int] = {}
    cells = []
    corners = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)]
    for i in range(nx):
        for j in range(ny):
            if inside(low[0] + (i + 0.5) * h, low[1] + (j + 0.5) * h):
                cells.append([number.setdefault((i + a, j + b, c), len(number)) for a, b, c in corners])
    nodes = [(low[0] + i * h, low[1] + j * h, k * h) for i, j, k in number]
    chosen = {name: [n for n, (x, y, _) in enumerate(nodes) if where(x, y)] for name, where in sets.items()}
    write_abaqus(path, nodes, cells, chosen)


def write_abaqus(path: Path, nodes, cells, sets) -> None:
    """Nodes, hexahedra and sets of nodes, counted from 0, as an Abaqus deck."""
    lines = ["*NODE", *(f"{n + 1}, {x:.12g}, {y:.12g}, {z:.12g}" for n, (x, y, z) in enumerate(nodes))]
    lines.append("*ELEMENT, TYPE=C3D8, ELSET=all")
    lines += [f"{k + 1}, " + ", ".join(str(n + 1) for n in cell) for k, cell in enumerate(cells)]
    for name, members in sets.items():
        lines.append(f"*NSET, NSET={name}")
        lines += [", ".join(str(n + 1) for n in members[k : k + 8]) for k in range(0, len(members), 8)]
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


BODIES = {
    "centre crack": Body(0.1, METAL, 0.6, 0.1, centre_crack),
    "hole": Body(0.1, METAL, 1.2, 0.1, hole),
    "notch": Body(0.1, METAL, 0.8, 0.1, notch),
    "beam": Body(10.0, DANISH, 90.0, 100.0, beam, 2675.6),
    "L-panel": Body(10.0, WINKLER, 250.0, 100.0, l_panel, 7219.0),
}
