"""The cases of the charts of speed against error: a beam that softens and breaks, and a plate of brittle bonds.

The beam is the Danish one of jobs/experiments in a slice, one layer of cells between mirror planes, to a little beyond
its peak. Its material is a traction-opening curve, so that other methods can be given the same. The plate is that with
a cutout between mirror planes, pulled to separation: it tells what elements in place of bonds cost.
"""

from __future__ import annotations

from dataclasses import dataclass, field

DECK = "experiments/danish_normal.toml"
#: Of the whole thickness over that of one layer of cells: loads are told for the beam.
THICKNESS = 100.0
#: A run ends at this fraction of its peak.
BEYOND = 0.85
#: The brittle material of the same modulus and fracture energy.
BRITTLE = "{youngs_modulus = 26110.0, fracture_energy = 0.1087}"
#: Elements at both ends become bonds.
EVERYWHERE = {
    f"regions.{side}.{key}": value
    for side in ("left", "right")
    for key, value in (("model", "peridynamics"), ("may_fail", "false"))
}
#: What peaks are extrapolated from: the same settings at these cells.
FINEST = (10.0, 5.0, 2.5)


@dataclass(frozen=True)
class Case:
    """One run.

    Attributes
    ----------
    group : str
        What stands in the legend.
    spacing : float, dimension length
    setting : str
        What differs from the deck, in words.
    keys : dict
        The same for ``--set``.
    """

    group: str
    spacing: float
    setting: str = ""
    keys: dict[str, str] = field(default_factory=dict, compare=False)

    @property
    def name(self) -> str:
        """Of its folder."""
        return "-".join(part for part in (self.group, f"{self.spacing:g}", self.setting) if part).replace(" ", "_")

    @property
    def deck(self) -> str:
        """Its deck, below jobs/."""
        return DECK

    @property
    def scale(self) -> float:
        """Of the whole body's load over the model's."""
        return THICKNESS / self.spacing

    def overrides(self) -> dict[str, str]:
        """What ``--set`` gets."""
        return {
            "mesh.spacing": repr(self.spacing),
            "mesh.upper": f"[400.0, 100.0, {self.spacing!r}]",
            "mesh.symmetry": '["z-", "z+"]',
            "stepping.end_reaction": repr(BEYOND),
            "output": "{fields = false, figures = false}",
        } | self.keys


class PlateCase(Case):
    """One run of the plate."""

    @property
    def name(self) -> str:
        """Of its folder."""
        return "plate-" + super().name.replace("/", "_").replace('"', "").replace("'", "")

    @property
    def deck(self) -> str:
        """Its deck, below jobs/."""
        return PLATE

    @property
    def scale(self) -> float:
        """Half of the width and half of the thickness carry a quarter of the load."""
        return 1.0 if self.spacing == WHOLE else 4.0

    def overrides(self) -> dict[str, str]:
        """What ``--set`` gets: an eighth of the deck's plate, or all of it."""
        eighth = {
            "mesh.symmetry": '["x-", "y+", "z+"]',
            "mesh.lower": "[0.0, -1.5, -0.1]",
            "mesh.upper": "[4.5, 0.0, 0.0]",
            "supports": '[{face = "x+", x = 0.01}]',
        }
        given = {"mesh.spacing": repr(self.spacing), "output": "{fields = false, figures = false}"}
        return ({} if self.spacing == WHOLE else eighth) | given | self.keys


SOFT = "bonds that soften, in a part"
PLATE = "plate_adaptive.toml"
#: Everywhere is up to half an inch from the pulled end, whose cells are elements.
ALL, BOX, FOUND = "bonds everywhere", "the paper's box of bonds", 'regions = "auto"'
#: Cells of which an eighth of the plate does not hold a whole number; their faces stand at odd tenths of an inch.
WHOLE = 0.2


def _regions(bonds: float, end: float, whole: bool) -> dict[str, str]:
    """Bonds up to this distance from the middle, elements from ``end`` on, and a band where bonds may not fail."""
    tables = [("bonds", "peridynamics", -bonds if whole else 0.0, bonds, "")]
    for name, side in (("left", -1.0), ("right", 1.0))[not whole :]:
        tables.append((f"{name}_end", "finite_elements", side * end, side * 9.0, ""))
        if end > bonds:
            tables.append((f"{name}_band", "peridynamics", side * bonds, side * end, ", may_fail = false"))
    words = []
    for name, model, one, other, more in tables:
        low, high = sorted((one, other))
        corners = f"lower = [{low}, -9.0, -9.0], upper = [{high}, 9.0, 9.0]"
        words.append(f'{{name = "{name}", model = "{model}", {corners}{more}}}')
    return {"regions": "[" + ", ".join(words) + "]"}


THIRD, A_THIRD = "nu = 1/3", {"material.poissons_ratio": "0.3333333333333333"}


def cases(fine: bool) -> list[Case]:
    """Cheapest first; ``fine`` adds the cells that the reference needs."""
    correction = "peridynamics.surface_correction"
    found = [
        Case(SOFT, 20.0, keys={"regions.left.upper": "[-100.0, 100.0, 50.0]"} | _wide()),
        Case(SOFT, 10.0),
        Case("appendix A", 10.0, keys={correction: "appendix_a"}),
        Case("no correction", 10.0, keys={correction: "none"}),
        Case("brittle bonds, in a part", 10.0, keys={"material": BRITTLE}),
        Case("bonds that soften, everywhere", 10.0, keys=EVERYWHERE),
        Case(SOFT, 10.0, "eta 1e-2", {"stepping.eta": "1e-2"}),
        Case(SOFT, 10.0, "eta 1e-1", {"stepping.eta": "1e-1"}),
        Case(SOFT, 10.0, "l 0.75 cells", {"peridynamics.internal_length": "7.5"}),
        Case(SOFT, 5.0),
        Case("appendix A", 5.0, keys={correction: "appendix_a"}),
        Case("brittle bonds, in a part", 5.0, keys={"material": BRITTLE}),
        Case("bonds that soften, everywhere", 5.0, keys=EVERYWHERE),
    ]
    return [*found, Case(SOFT, 2.5)] if fine else found


def plate_cases() -> list[PlateCase]:
    """Cheapest first. Found regions are for a Poisson's ratio of 1/4."""
    found = []
    for h in (WHOLE, 0.1, 0.05):
        far, band = (3.9, 2.1) if h == WHOLE else (4.0, 2.0)
        everywhere, box = _regions(far, far, h == WHOLE), _regions(1.5, band, h == WHOLE)
        if h != WHOLE:
            found += [
                PlateCase(FOUND, h),
                PlateCase(FOUND, h, "no check", {"adaptive": "{widening_check = false}"}),
                PlateCase(FOUND, h, "growth 9", {"adaptive": "{growth = 9.0}"}),
            ]
        found += [PlateCase(BOX, h, keys=box), PlateCase(ALL, h, keys=everywhere)]
        if h != WHOLE:
            found += [PlateCase(BOX, h, THIRD, box | A_THIRD), PlateCase(ALL, h, THIRD, everywhere | A_THIRD)]
    return [*found, PlateCase(BOX, h, "appendix A", box | {"peridynamics.surface_correction": "appendix_a"})]


def _wide() -> dict[str, str]:
    """Regions of cells of 20, whose cutoff radius is 50."""
    return {
        "regions.rim_left.lower": "[-100.0, 0.0, 0.0]",
        "regions.rim_left.upper": "[-40.0, 100.0, 50.0]",
        "regions.middle.lower": "[-40.0, 0.0, 0.0]",
        "regions.middle.upper": "[40.0, 100.0, 50.0]",
        "regions.rim_right.lower": "[40.0, 0.0, 0.0]",
        "regions.rim_right.upper": "[100.0, 100.0, 50.0]",
        "regions.right.lower": "[100.0, 0.0, 0.0]",
    }
