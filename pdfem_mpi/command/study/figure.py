"""The figure of a study: results over the first key that was varied."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from pathlib import Path

from pdfem_mpi.command.study.members import Axis, Member, StudyError
from pdfem_mpi.command.study.outcomes import Outcome
from pdfem_mpi.command.study.result_table import unquoted
from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.deck.toml import dimension_of
from pdfem_mpi.results.labels import attempt
from pdfem_mpi.results.run_folder import numbers_of
from pdfem_mpi.results.study_files import Series, draw_study

#: What a study of bodies that fail is about.
PEAK = "failure.peak.load"


def choose_results(outcomes: Sequence[Outcome], wanted: Sequence[str]) -> list[str]:
    """Names of the results to draw: those wanted, else peaks of bodies that fail and what probes measured, else the
    number of evaluations.

    Raises
    ------
    StudyError
        For a name that no member has.
    """
    found = [numbers_of(outcome.summary) for outcome in outcomes if outcome.status == "finished"]
    if wanted:
        names = list(dict.fromkeys(name for row in found for name in row))
        unknown = [name for name in wanted if name not in names]
        if unknown and found:
            raise StudyError(
                [f"--plot {name}: no such result. The columns of study.csv are {', '.join(names)}." for name in unknown]
            )
        return [name for name in wanted if name in names]
    probed = [numbers_of({"probes": outcome.summary.get("probes", {})}) for outcome in outcomes]
    names = list(dict.fromkeys(name for row in probed for name in row))
    largest = {name: max(abs(row.get(name, 0.0)) for row in probed) for name in names}
    top = {name.rpartition("_")[0]: 0.0 for name in names}
    for name in names:
        top[name.rpartition("_")[0]] = max(top[name.rpartition("_")[0]], largest[name])
    peaks = [PEAK] if any(PEAK in row for row in found) else []
    # components of a vector that symmetry makes 0 show round-off
    shown = [name for name in names if largest[name] > 1e-6 * top[name.rpartition("_")[0]]]
    return peaks + shown or ["solve.evaluations"]


def draw(
    path: Path,
    members: Sequence[Member],
    axes: Sequence[Axis],
    outcomes: Sequence[Outcome],
    wanted: Sequence[str],
    report: Callable[[str], None],
) -> None:
    """Draw results over the first axis, one curve for each combination of the others; nothing without results.

    Raises
    ------
    StudyError
        For a wanted name that no member has.
    """
    names = choose_results(outcomes, wanted)
    if not any(outcome.status == "finished" for outcome in outcomes):
        return
    key = axes[0].keys[-1]
    n_first = len(axes[0].keys)
    curves: dict[str, list[tuple[str, dict[str, float]]]] = {}
    for member, outcome in zip(members, outcomes, strict=True):
        others = ", ".join(f"{name} = {unquoted(value)}" for name, value in member.values[n_first:])
        row = numbers_of(outcome.summary) if outcome.status == "finished" else {}
        curves.setdefault(others, []).append((unquoted(dict(member.values)[key]), row))
    series = [
        Series(label, [x for x, _ in points], {name: [row.get(name) for _, row in points] for name in names})
        for label, points in curves.items()
    ]
    scene = members[0].scene
    unit = unit_of(scene, dimension_of(scene, key))
    failed = sum(outcome.status not in ("finished", "waiting") for outcome in outcomes)
    note = f"{failed} of {len(members)} members failed" if failed else ""
    units = {name: unit_of(scene, "length") for name in names if _is_displacement(scene, name)}
    if PEAK in names:
        units[PEAK] = unit_of(scene, "force")
    along = f"{key}{f' ({unit})' if unit else ''}"
    attempt(lambda: draw_study(path, series, along, units, scene.title, note), path, report)


def _is_displacement(scene: Scene, name: str) -> bool:
    probes = {probe.name for probe in scene.probes if probe.kind == "displacement"}
    return name == "end_displacement" or (name[-2:] in ("_x", "_y", "_z") and name[:-2] in probes)


def unit_of(scene: Scene, dimension: str) -> str:
    """A dimension in the deck's units; empty where the deck names none."""
    words = {"length": scene.units.length, "force": scene.units.force}
    if not all(words[word] for word in words if word in dimension) or dimension in ("", "1"):
        return ""
    return re.sub("length|force", lambda match: words[match.group()], dimension).replace(" / ", "/")
