"""The experiments and numerical references of docs/experiments.md, and the runs that each of them has."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass, field
from pathlib import Path

from tools.studies.series import JOBS, RUNS

FOLDER = RUNS / "experiments"
DECKS = JOBS / "experiments"
#: Thinnest body: one layer of cells between mirror planes, in plane strain.
SLICE, HALF = "slice", "half"
#: Short runs end at this fraction of their peak.
BEYOND = 0.85
#: Internal length over the edge of cells in the runs that have another one.
OTHER = 0.75


@dataclass(frozen=True)
class Experiment:
    """One test, or one numerical reference.

    Attributes
    ----------
    name : str
        Of its deck, of its measured curve and of its figure.
    title : str
    spacings : floats, dimension length
        Coarse cells first.
    thickness, half : float, dimension length
        Of the specimen, and of what the deck has of it.
    force, abscissa : str
        Columns of history.csv.
    axis : str
        What the abscissa is, in words.
    ligament : float, dimension length
        What the crack has to cut.
    energy : float, dimension force / length
        The fracture energy of the deck.
    identified : bool
        The material is that which was identified from this very curve.
    sets : dict
        Other values of the material that sources have, as ``--set`` takes them, by their name.
    peaks : dict
        The same, of materials whose peak alone is compared.
    path : "y", "x" or ""
        Along which axis the crack runs, where its path is drawn.
    long : bool
        The finer slice follows the whole curve, too.
    """

    name: str
    title: str
    spacings: tuple[float, ...]
    thickness: float
    half: float
    force: str
    abscissa: str
    axis: str
    ligament: float
    energy: float
    identified: bool = False
    sets: dict[str, dict[str, str]] = field(default_factory=dict, compare=False)
    peaks: dict[str, dict[str, str]] = field(default_factory=dict, compare=False)
    path: str = ""
    long: bool = False

    @property
    def deck(self) -> Path:
        """Where the deck stands."""
        return DECKS / f"{self.name}.toml"

    @property
    def measured(self) -> Path:
        """Where the measured curve, band or path stands."""
        return DECKS / "measured" / f"{self.name}.csv"


@dataclass(frozen=True)
class Case:
    """One run.

    Attributes
    ----------
    level : int
        Number of its spacing, 0 is coarse.
    body : "half" or "slice"
        Half of the thickness, or one layer of cells between mirror planes.
    length : float
        Factor of the internal length.
    material : str
        Name of the set of material values; empty for those of the deck.
    short : bool
        The run ends a little beyond the peak: only that is compared.
    """

    experiment: Experiment
    level: int = 0
    body: str = HALF
    length: float = 1.0
    material: str = ""
    short: bool = False

    @property
    def spacing(self) -> float:
        """Edge of its cells."""
        return self.experiment.spacings[self.level]

    @property
    def name(self) -> str:
        """Of its folder."""
        length = "" if self.length == 1.0 else f"l{self.length:g}"
        parts = (self.experiment.name, f"{self.spacing:.4g}", self.body, length, self.material)
        return "-".join(part for part in parts if part).replace(" ", "_")

    @property
    def internal(self) -> float:
        """Internal length of its bonds."""
        return self.length * self.spacing

    @property
    def folder(self) -> Path:
        """Of its run."""
        return FOLDER / self.name

    @property
    def scale(self) -> float:
        """Of the specimen's load over the model's."""
        modelled = self.spacing if self.body == SLICE else self.experiment.half
        return self.experiment.thickness / modelled

    def overrides(self) -> dict[str, str]:
        """What ``--set`` gets."""
        pairs = {"mesh.spacing": repr(self.spacing)}
        if self.body == SLICE:
            mesh = tomllib.loads(self.experiment.deck.read_text(encoding="utf-8"))["mesh"]
            x, y, _ = mesh["upper"]
            mirrors = [face for face in mesh["symmetry"] if face[0] != "z"] + ["z-", "z+"]
            pairs["mesh.upper"] = f"[{x}, {y}, {self.spacing!r}]"
            pairs["mesh.symmetry"] = "[" + ", ".join(f'"{face}"' for face in mirrors) + "]"
        if self.length != 1.0:
            pairs["peridynamics.internal_length"] = repr(self.internal)
        if self.material:
            pairs |= (self.experiment.sets | self.experiment.peaks)[self.material]
        if self.short:
            pairs["stepping.end_reaction"] = repr(BEYOND)
        return pairs


DEFLECTION, CMOD = "deflection at midspan / mm", "opening of the notch / mm"
TESTS = (
    Experiment(
        "danish_normal", "Danish beam, normal strength", (10.0, 5.0), 100.0, 50.0, "pin.force_y", "deflection.u_y",
        DEFLECTION, 90.0, 0.1087, identified=True,
    ),
    Experiment(
        "danish_high", "Danish beam, high strength", (10.0, 5.0), 100.0, 50.0, "pin.force_y", "deflection.u_y",
        DEFLECTION, 90.0, 0.1829, identified=True,
    ),
    Experiment(
        "lausanne_wedge", "Lausanne wedge splitting", (10.0, 5.0), 97.0, 50.0, "right_line.force_x", "load_factor",
        "opening of the load line / mm", 85.0, 0.1083, identified=True,
        sets={"load at the top": {"supports.1.line": "[[-10.0, 200.0, 0.0], [-10.0, 200.0, 50.0]]",
                                  "supports.2.line": "[[10.0, 200.0, 0.0], [10.0, 200.0, 50.0]]"}},
    ),
    Experiment(
        "winkler_l_panel", "Winkler's L-panel", (10.0, 5.0), 100.0, 50.0, "lift.force_y", "load_factor",
        "displacement of the arm / mm", 250.0, 0.09, path="x",
        sets={"E 20,000": {"material.youngs_modulus": "20000.0", "material.tensile_strength": "2.4",
                           "material.fracture_energy": "0.113"}},
        peaks={"brittle bonds": {"material": "{youngs_modulus = 25850.0, fracture_energy = 0.09}"}},
    ),
    Experiment(
        "gregoire_half_notch", "Gregoire, D = 50, half notch", (4.166666666667, 2.5), 50.0, 25.0, "pin.force_y",
        "cmod.opening", CMOD, 25.0, 0.1432,
        sets={"f_t 3.5": {"material.tensile_strength": "3.5", "material.fracture_energy": "0.09"}},
    ),
    Experiment(
        "garcia_alvarez_eccentric", "Garcia-Alvarez, D = 80, eccentric notch", (5.0, 2.5), 50.0, 25.0, "pin.force_y",
        "cmod.opening", CMOD, 60.0, 0.1252, path="y",
    ),
    Experiment(
        "milan_polymer", "Milan polymer beam", (1.5, 0.75), 15.0, 7.5, "pin.force_y", "deflection.u_y", DEFLECTION,
        15.0, 0.2519, identified=True, long=True,
        peaks={"nu 0.25": {"material.poissons_ratio": "0.25"}},
    ),
)  # fmt: skip
PATHS = (
    Experiment(
        "pmma_semicircle", "PMMA half disc, 30 degrees", (1.0, 0.5), 5.0, 2.0, "load_left.force_y", "load_factor",
        "displacement / mm", 37.0, 0.38, path="y",
        sets={"f_t 10": {"material.tensile_strength": "10.0"}, "f_t 20": {"material.tensile_strength": "20.0"},
              "brittle bonds": {"material": "{youngs_modulus = 3000.0, poissons_ratio = 0.4, fracture_energy = 0.38}",
                                "stepping.eta": "1e-2", "stepping.end_reaction": "0.25"}},
    ),
)  # fmt: skip
EXPERIMENTS = {one.name: one for one in (*TESTS, *PATHS)}
#: The material of the paths' finer cells.
FINE_PATH = "f_t 20"


def cases(fine: bool) -> list[Case]:
    """What is run, cheapest first: slices at the coarse cells, then at others, and half of the thickness.

    Internal lengths, other values of materials and most of the finer cells are compared by their peaks. Fine cells of
    the path have a strength with which its process zone is as many cells long.
    """
    found = [Case(one, body=SLICE) for one in EXPERIMENTS.values()]
    found += [Case(one, body=SLICE, material=name) for one in EXPERIMENTS.values() for name in one.sets]
    found += [Case(one, body=SLICE, material=name, short=True) for one in TESTS for name in one.peaks]
    found += [Case(one, body=SLICE, length=OTHER, short=True) for one in TESTS]
    found += [Case(one, level=1, body=SLICE, short=not one.long) for one in TESTS]
    found += [Case(one) for one in TESTS]
    if fine:
        found += [Case(one, level=1, body=SLICE, material=FINE_PATH) for one in PATHS]
        found += [Case(one, level=1, short=True) for one in TESTS]
    return found
