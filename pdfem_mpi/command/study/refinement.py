"""A deck at cells h, h/2, h/4, and what its results come to: the value at vanishing cells, with its uncertainty.

The internal length is as the deck says: given, finer cells resolve one material; left out, it follows the cells.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pdfem_mpi.command.study.figure import unit_of
from pdfem_mpi.command.study.members import Member, StudyError
from pdfem_mpi.command.study.outcomes import outcome_in
from pdfem_mpi.deck.meshes import FileMesh
from pdfem_mpi.deck.toml import read_deck
from pdfem_mpi.results.run_folder import numbers_of

#: Levels that a refinement may have: cells of h / 16 are 4,096 times as many.
FEWEST, MOST = 2, 5
#: Orders of convergence between which an extrapolation is believed, and what its correction is then multiplied by;
#: elsewhere the largest difference between the levels is taken, three times (Eca & Hoekstra 2014).
ORDERS, SAFE, UNSAFE = (0.5, 2.5), 1.25, 3.0
SPACING = "mesh.spacing"
#: What is told of bodies that fail, before what probes measured.
OF_FAILURE = ("failure.peak.load", "failure.first_break.load")


@dataclass(frozen=True)
class Limit:
    """What a result comes to as cells vanish.

    Attributes
    ----------
    value, uncertainty : float
    order : float or None
        Observed order of convergence; None where the levels show none.
    """

    value: float
    uncertainty: float
    order: float | None


def vary_cells(deck: Path, levels: int, overrides: Sequence[str]) -> tuple[str, list[str]]:
    """The axis ``mesh.spacing=h,h/2,...`` of a deck, as ``--vary`` takes it, and the overrides that are left beside it:
    one of the spacing says what h is.

    Raises
    ------
    DeckError
        The deck cannot be read.
    StudyError
        It has no spacing to refine, or the levels are too few or too many.
    """
    if not FEWEST <= levels <= MOST:
        raise StudyError([f"--refine {levels}: must be {FEWEST} to {MOST} levels: cells h, h/2, h/4 are 3."])
    scene = read_deck(deck, list(overrides))
    if isinstance(scene.mesh, FileMesh):
        raise StudyError(
            ['--refine: mesh.kind = "file" has its cells in a file. Give finer files: --vary mesh.path=COARSE,FINE.']
        )
    axis = f"{SPACING}=" + ",".join(repr(scene.mesh.spacing / 2**k) for k in range(levels))
    return axis, [text for text in overrides if text.partition("=")[0].strip() != SPACING]


def limit_of(values: Sequence[float]) -> Limit:
    """Extrapolate a result at cells h, h/2, ... by the order that its last three levels show (Richardson).

    With two levels, or where the levels do not fall in line, the finest value stands.
    """
    spread = max(values) - min(values)
    if len(values) >= 3 and values[-1] != values[-2]:
        ratio = (values[-3] - values[-2]) / (values[-2] - values[-1])
        order = math.log2(ratio) if ratio > 0.0 else -math.inf
        if ORDERS[0] <= order <= ORDERS[1]:
            correction = (values[-1] - values[-2]) / (ratio - 1.0)
            return Limit(values[-1] + correction, SAFE * abs(correction), order)
    return Limit(values[-1], UNSAFE * spread, None)


def describe_refinement(members: Sequence[Member], folder: Path) -> Iterator[str]:
    """Lines about each level and about the limits, once all levels have finished."""
    found = []
    for member in members:
        outcome = outcome_in(folder / "members" / member.name, member)
        if outcome.status != "finished":
            yield f"pdfem: {member.label} has not finished: nothing is extrapolated"
            return
        found.append(outcome.summary)
    scene = members[0].scene
    rows = [numbers_of(summary) for summary in found]
    names = [name for name in OF_FAILURE if all(name in row for row in rows)]
    names += [name for name in numbers_of({"probes": found[0].get("probes", {})}) if all(name in row for row in rows)]
    for member, summary, row in zip(members, found, rows, strict=True):
        told = "".join(f", {_word(name)} {row[name]:.6g}" for name in names)
        yield f"{member.label}{told}, {_cost(summary)}"
    for name in names:
        limit = limit_of([row[name] for row in rows])
        unit = unit_of(scene, "force") if name in OF_FAILURE else ""
        how = "the levels show no order: the finest" if limit.order is None else f"of order {limit.order:.2g}"
        value = f"{limit.value:.6g} +- {limit.uncertainty:.2g}{f' {unit}' if unit else ''}"
        yield f"{_word(name)} {value} at vanishing cells, {how}"


def _word(name: str) -> str:
    return name.removeprefix("failure.").removesuffix(".load").replace("_", " ").replace(".", " ")


def _cost(summary: dict[str, Any]) -> str:
    memory = max(summary["memory"]["peak_bytes_per_rank"]) / 2**20
    return f"{summary['solve']['evaluations']:,} sweeps, {summary['seconds']['total']:.1f} s, {memory:.0f} MiB a rank"
