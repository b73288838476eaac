"""Winkler's panel beside a phase field of the same modulus and fracture energy."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass

from tools.studies.experiments.cases import EXPERIMENTS, FOLDER, SLICE, Case
from tools.studies.series import table

#: What `tools/benchmarks/easyfea_panel` printed.
PEER = FOLDER / "easyfea.txt"
LINE = re.compile(
    r"l (?P<length>\S+), triangles of (?P<edge>\S+): .* peak (?P<peak>[\d,]+) N at (?P<at>\S+) mm .* "
    r"(?P<seconds>\d+) s of a processor, (?P<memory>\d+) MiB"
)
PANEL = EXPERIMENTS["winkler_l_panel"]
#: Ours, in words, cheapest peak first.
OURS = {
    "brittle bonds": Case(PANEL, body=SLICE, material="brittle bonds", short=True),
    "bonds that soften": Case(PANEL, body=SLICE),
}


@dataclass(frozen=True)
class Outcome:
    """What a program gave: lengths in mm, N, processor seconds with start-up, MiB."""

    program: str
    internal: float
    edge: float
    peak: float
    at: float
    seconds: float
    memory: float


def peers() -> list[Outcome]:
    """What EasyFEA gave; empty, and a sentence, where it was not run."""
    if not PEER.exists():
        print(f"{PEER.name} is missing: no rows of EasyFEA (tools/benchmarks/easyfea_panel > {PEER}).")
        return []
    return [
        Outcome("phase field (EasyFEA)", *(float(one[name].replace(",", "")) for name in (
            "length", "edge", "peak", "at", "seconds", "memory")))
        for one in LINE.finditer(PEER.read_text(encoding="utf-8"))
    ]  # fmt: skip


def panel_table(measured: float, ours: Callable[[str, Case], Outcome | None]) -> list[str]:
    """The peer's rows, and ours.

    Parameters
    ----------
    measured : float
        The measured peak, N.
    ours : callable
        The outcome of a case, by its words; None where it was not run.
    """
    own = [found for words, case in OURS.items() if (found := ours(words, case)) is not None]
    head = ["material", "internal length, cells / mm", "peak / N at / mm", "over the measured", "processor s", "MiB"]
    return table(head, [
        [one.program, f"{one.internal:g}, {one.edge:g}", f"{one.peak:,.0f} at {one.at:.3g}",
         f"{one.peak / measured:.2f}", f"{one.seconds:,.0f}", f"{one.memory:.0f}"]
        for one in [*peers(), *own]
    ])  # fmt: skip
