"""Numerical references of docs/experiments.md: bodies whose failing load a formula or a bound knows.

Answers are for one millimetre of thickness, or stresses over the strength. All bonds have a Poisson's ratio of 1/4.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from pdfem_mpi import open_run
from tools.studies.experiments.cases import FOLDER
from tools.studies.experiments.curves import STABLE
from tools.studies.series import summary_of

#: The decks' materials: E, f_t, G_c; the brittle one has no strength.
ALUMINA, GLASS, PMMA = (335000.0, 210.0, 0.0268), (15000.0, 10.0, 0.010), (3000.0, 0.38)
POISSON = 0.25


@dataclass(frozen=True)
class Reference:
    """One run of a reference.

    Attributes
    ----------
    deck : str
    words : str
        What differs from other runs of the deck.
    settings : dict
        For ``--set``.
    answer : tuple of two floats
        The load between these; a formula's twice.
    column : str
        Of history.csv: the load, in proportion to the reaction.
    scale : float
        Of the answer's load over the column's.
    unit : str
    """

    deck: str
    words: str
    settings: Mapping[str, str]
    answer: tuple[float, float]
    column: str
    scale: float
    unit: str
    told: str = field(default="", compare=False)

    @property
    def name(self) -> str:
        """Of its folder."""
        return f"{self.deck}-{self.words}".replace(" ", "_").replace(",", "")

    @property
    def folder(self) -> Path:
        """Of its run."""
        return FOLDER / self.name

    def load(self) -> float | None:
        """Largest load over stable states, whether a row tells of them or not; None where the run has not ended.

        Under energy control rows are told every so many batches, and the summary's peak is that of all stable states.
        The column is in proportion to the reaction: the load factor of dead loads, or the only force of a moved line.
        """
        summary = summary_of(self.folder)
        if summary.get("exit_code") != 0:
            return None
        history = open_run(self.folder).history
        stable = [event in STABLE for event in history["event"]]
        column, reaction = abs(history[self.column][stable]), history["reaction"][stable]
        top = int(column.argmax())
        return self.scale * summary["failure"]["peak"]["load"] * float(column[top] / reaction[top])


def stress_at_an_edge_crack(length: float, width: float = 6.0, material=ALUMINA) -> float:
    """At which an edge crack in a strip runs in plane strain, over the strength; 1 without a crack."""
    modulus, strength, energy = material
    if length == 0.0:
        return 1.0
    x = length / width
    shape = 1.122 - 0.231 * x + 10.55 * x**2 - 21.71 * x**3 + 30.382 * x**4
    return _toughness(modulus, energy) / (math.sqrt(math.pi * length) * shape) / strength


def load_on_a_compact_tension(length: float = 25.0, width: float = 50.0, material=PMMA) -> float:
    """Force for 1 mm of thickness at which the crack runs in plane strain (ASTM E399)."""
    x = length / width
    shape = (2.0 + x) * (0.886 + 4.64 * x - 13.32 * x**2 + 14.72 * x**3 - 5.6 * x**4) / (1.0 - x) ** 1.5
    return _toughness(*material) * math.sqrt(width) / shape


def loads_on_a_hole(radius: float = 5.0, half: float = 15.0, material=GLASS) -> tuple[float, float]:
    """Force on half of the plate for 1 mm of thickness: where the most strained place of an elastic plate comes to the
    strength (Howland's factor for a radius of a third of the half width), and where all of the ligament has.
    """
    strength = material[1]
    return strength * half / HOWLAND, strength * (half - radius)


#: Stress at the edge of the hole over that of the gross section: 3.46 for a diameter of a third of the width.
HOWLAND = 3.46


def _toughness(modulus: float, energy: float) -> float:
    return math.sqrt(modulus * energy / (1.0 - POISSON**2))


def references() -> Iterator[Reference]:
    """All runs, cheapest first."""
    force = load_on_a_compact_tension()
    for h in (1.25, 0.625):
        settings = {"mesh.spacing": repr(h), "mesh.upper": f"[50.0, 30.0, {h!r}]"}
        settings |= {"stepping.eta": "1e-2", "stepping.end_reaction": "0.8"}
        yield Reference(
            "compact_tension", f"cells {h:g}", settings, (force, force), "upper_pin.force_y", 1.0 / h, "N/mm", "formula"
        )
    for h in (0.625, 0.3125):
        settings = {"mesh.spacing": repr(h), "mesh.upper": f"[25.0, 15.0, {h!r}]"}
        yield Reference(
            "plate_with_hole", f"cells {h:g}", settings, loads_on_a_hole(), "right_end.force_x", 1.0 / h, "N/mm",
            "elastic to full ligament",
        )  # fmt: skip
    for length in (0.0, 0.3, 1.5, 3.0):
        yield edge_crack(length)


def edge_crack(length: float, h: float = 0.05) -> Reference:
    """The strip with a crack of this length, or none.

    Bonds are around the tip, elements elsewhere: the crack is a slot of a cell on either side up to them, a cut from
    there on. Without a crack the stress is the same everywhere, and a narrow strip says as much as a wide one.
    """
    # dead loads would tear all of the strip apart past its peak, from where the load of a long crack falls slowly; the
    # first bonds that soften at its tip cost 12 %
    settings = {"mesh.spacing": repr(h), "stepping.control": "energy", "stepping.end_reaction": "0.85"}
    if length:
        behind = max(0.0, round((length - BEHIND) / h) * h)
        ends = [(behind - 1.0, -1.0), (length, -1.0), (length, 1.0), (behind - 1.0, 1.0)]
        polygon = ", ".join(f"[{x!r}, 0.0, {z!r}]" for x, z in ends)
        settings |= {"mesh.upper": f"[6.0, 10.0, {h!r}]", "cracks": f"[{{polygon = [{polygon}]}}]"}
        settings["regions"] = "[" + ", ".join(_around_the_tip(behind, length + AHEAD)) + "]"
        if behind:
            corners = f"lower = [0.0, {-h!r}, 0.0], upper = [{behind!r}, {h!r}, 1.0]"
            settings["mesh.remove"] = f'[{{kind = "box", {corners}}}]'
    else:
        settings |= {"mesh.lower": "[0.0, -2.0, 0.0]", "mesh.upper": f"[1.5, 2.0, {h!r}]", "cracks": "[]"}
    stress = stress_at_an_edge_crack(length)
    words = f"crack {length:g}" if length else "no crack"
    if not length:  # a stretch of f_t / E, along a bar and in plane strain
        answer, told = (1.0, 1.0 / (1.0 - POISSON**2)), "the strength, in a bar to plane strain"
    elif length > 1.0:
        answer, told = (stress, stress), "formula"
    else:
        answer, told = (0.0, min(stress, 1.0)), "below strength and formula"
    return Reference("edge_crack", words, settings, answer, "load_factor", 1.0, "f_t", told)


#: How far bonds reach behind and ahead of the tip of an edge crack, and above and below it, mm; in their outermost part
#: they may not fail.
BEHIND, AHEAD, ASIDE, RIM = 0.5, 0.9, 0.6, 0.3


def _around_the_tip(x0: float, x1: float) -> Iterator[str]:
    """Regions, as inline tables: bonds in x0 < x < x1, elements elsewhere."""
    inner, last = ASIDE - RIM, x1 - RIM
    elements = (
        ("below", 0.0, 6.0, -10.0, -ASIDE), ("above", 0.0, 6.0, ASIDE, 10.0),
        *([("behind", 0.0, x0, -ASIDE, ASIDE)] if x0 else []), ("ahead", x1, 6.0, -ASIDE, ASIDE),
    )  # fmt: skip
    held = (
        ("rim_below", x0, x1, -ASIDE, -inner), ("rim_above", x0, x1, inner, ASIDE),
        ("rim_ahead", last, x1, -inner, inner),
    )  # fmt: skip
    for model, boxes, more in (
        ("finite_elements", elements, ""),
        ("peridynamics", held, ", may_fail = false"),
        ("peridynamics", (("middle", x0, last, -inner, inner),), ""),
    ):
        for name, left, right, low, high in boxes:
            yield (
                f'{{name = "{name}", model = "{model}", lower = [{left:.6g}, {low:.6g}, 0.0], '
                f"upper = [{right:.6g}, {high:.6g}, 1.0]{more}}}"
            )
