"""Random decks that ask for several things at once: materials, loads, programs and probes that decks combine freely.

`random_decks` draws the body; here it gets Poisson's ratios, bonds that soften, constant loads, pressures, formulas,
temperatures, probes and one of the load programs. The seed alone decides.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from pydantic import ValidationError

from pdfem_mpi.body.discretization import discretize
from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.deck.table import SceneError
from support.random_decks import LIMIT, draw_deck, frozen

AXES = "xyz"


def dressed_scene(seed: int, folder: Path) -> Scene:
    """The scene of a seed; a mesh file of it is written to the folder."""
    rng = np.random.default_rng([20261130, seed])
    while True:
        deck = draw_deck(rng, Path(folder) / f"mesh_{seed}.inp")
        if deck["mesh"]["kind"] == "plate_with_hole" or "peridynamics" not in deck:
            continue
        if "critical_stretch" not in deck["material"] and rng.random() < 0.6:
            continue  # few bodies break, and most can go wrong there
        _dress(rng, deck)
        deck["title"] = f"dressed {seed}"
        try:
            scene = Scene(**frozen(deck))
            discretize(scene)
        except (ValidationError, SceneError):
            continue
        return scene


class _Place:
    """Where the body of a deck is."""

    def __init__(self, deck: dict):
        self.lower, self.upper = (np.array(deck["regions"][k][name]) for k, name in ((0, "lower"), (-1, "upper")))
        self.far = deck["supports"][0]["face"].replace("-", "+")
        self.long = AXES.index(self.far[0])
        self.spacing = deck["mesh"]["spacing"]
        self.length = float(self.upper[self.long] - self.lower[self.long])
        self.mirrors = deck["mesh"].get("symmetry", [])

    def at(self, *share: float) -> list[float]:
        """A position, by shares of the length and of the two widths."""
        order = [self.long, *(d for d in range(3) if d != self.long)]
        place = np.empty(3)
        place[order] = share
        return (self.lower + place * (self.upper - self.lower)).tolist()


def _dress(rng: np.random.Generator, deck: dict) -> None:
    place, fails = _Place(deck), "critical_stretch" in deck["material"]
    _materials(rng, deck, place, fails)
    _loads(rng, deck, place)
    _program(rng, deck, fails)
    deck["probes"] = [
        {"kind": "displacement", "name": "middle", "point": place.at(0.5, 0.5, 0.5)},
        {"kind": "opening", "name": "opening", "one": place.at(0.2, 0.4, 0.5), "two": place.at(0.9, 0.4, 0.5)},
        {"kind": "cut", "name": "cut", "point": place.at(0.5, 0.5, 0.5), "normal": np.eye(3)[place.long].tolist()},
    ]
    deck["output"] |= (
        {"damage": True, "fields": ["displacement", "stress"]} if rng.random() < 0.5 else {"fields": False}
    )
    deck["supports"][0]["name"] = "clamp"


def _materials(rng, deck: dict, place: _Place, fails: bool) -> None:
    tables = [deck["material"], *deck.get("materials", {}).values()]
    bonds = deck["peridynamics"]
    if bonds["surface_correction"] != "fitted" and not fails and rng.random() < 0.5:
        nu = float(f"{rng.uniform(0.05, 0.45):.3g}")
        for table in tables:
            table["poissons_ratio"] = nu
    if fails and rng.random() < 0.5:
        length = bonds.get("internal_length", place.spacing)
        for table in tables:
            table.pop("critical_stretch", None)
            modulus, ratio = table["youngs_modulus"], rng.uniform(3.0, 8.0)
            energy = 4.843 * 0.4 * modulus * length * LIMIT**2 * (1.0 + 0.5 * (ratio - 1.0))
            table |= {"tensile_strength": LIMIT * modulus, "fracture_energy": float(f"{energy:.4g}")}
            table["poissons_ratio"] = 0.25
    elif not fails and bonds["kinematics"] == "linear" and rng.random() < 0.4:
        for table in tables:
            table["thermal_expansion"] = float(f"{10.0 ** rng.uniform(-6, -4):.3g}")
        amount = float(f"{rng.uniform(-50, 50):.3g}")
        axis = AXES[int(rng.integers(3))]
        uneven = {"formula": f"{amount} * (1 + ({axis} - {place.lower[AXES.index(axis)]!r}) / {place.length!r})"}
        deck["temperature"] = uneven if rng.random() < 0.5 else {"change": amount}
    if rng.random() < 0.3:
        bonds |= {"stiffness_noise": 0.01, "seed": int(rng.integers(100))}


def _loads(rng, deck: dict, place: _Place) -> None:
    size = 1e-3 * min(t["youngs_modulus"] for t in (deck["material"], *deck.get("materials", {}).values()))
    if deck["peridynamics"]["kinematics"] == "finite":
        size *= 0.1
    sides = [f"{a}{s}" for a in AXES for s in "-+" if a != place.far[0] and f"{a}{s}" not in place.mirrors]
    if sides and rng.random() < 0.5:
        pressure = {"kind": "pressure", "face": str(rng.choice(sides)), "pressure": float(f"{0.3 * size:.3g}")}
        deck["loads"].append(pressure | {"constant": bool(rng.random() < 0.5)})
    if rng.random() < 0.4:
        weight = np.zeros(3)
        weight[[d for d in range(3) if d != place.long]] = float(f"{-0.02 * size / place.length:.3g}")
        region = deck["regions"][int(rng.integers(len(deck["regions"])))]["name"]
        deck["loads"].append(
            {"kind": "body_force", "region": region, "density": weight.tolist(), "constant": bool(rng.random() < 0.7)}
        )
    pulled = [support for support in deck["supports"] if support.get("face") == place.far]
    if pulled and rng.random() < 0.7:
        across = [AXES[d] for d in range(3) if d != place.long]
        axis = place.far[0]
        middle = place.at(1.0, 0.5, 0.5)[AXES.index(across[0])]
        pulled[0][axis] = f"{pulled[0][axis]!r} * (1 + 0.2 * ({across[0]} - {middle!r}) / {place.length!r})"
        pulled[0]["name"] = "pulled"


def _program(rng, deck: dict, fails: bool) -> None:
    if not fails:
        deck["stepping"] = {"load_factors": [0.3, 0.7, 1.0]}
        if rng.random() < 0.3:
            deck["solver"] = {"kind": "adr", "tolerance": 1e-3}
        return
    kind = str(rng.choice(["events", "events", "energy", "opening", "steps", "ramp"]))
    if kind == "steps":
        deck["stepping"] = {"load_factors": [0.1, 0.3, 0.5]}
    elif kind == "ramp":
        deck["stepping"] = {"kind": "ramp", "increment": 1.0 / 300.0, "end_load_factor": 0.4, "report_every": 50}
        deck["solver"] = {"kind": "adr", "tolerance": 1e-4}
    else:
        deck["stepping"] = {"kind": "events", "end_reaction": 0.7, "report_every": 5, "inner_iterations": 4}
        if kind != "events":
            deck["stepping"]["control"] = kind
        if kind == "opening":
            deck["stepping"]["opening"] = "opening"
