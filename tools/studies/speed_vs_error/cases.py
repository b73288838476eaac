"""The cases of the chart of speed against error: one beam that softens and breaks, in many settings.

The body is the Danish beam of jobs/experiments in a slice, one layer of cells between mirror planes, to a little beyond
its peak. Its material is a traction-opening curve, so that other methods can be given the same.
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

    def overrides(self) -> dict[str, str]:
        """What ``--set`` gets."""
        return {
            "mesh.spacing": repr(self.spacing),
            "mesh.upper": f"[400.0, 100.0, {self.spacing!r}]",
            "mesh.symmetry": '["z-", "z+"]',
            "stepping.end_reaction": repr(BEYOND),
            "output": "{fields = false, figures = false}",
        } | self.keys


SOFT = "bonds that soften, in a part"


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
