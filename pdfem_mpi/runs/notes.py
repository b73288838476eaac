"""Sentences about a run at its beginning and at its end."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from pdfem_mpi.body.share import Share
from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.model.parts import describe_unsupported
from pdfem_mpi.peridynamics.bonds import count_by_material
from pdfem_mpi.peridynamics.volumetric import describe_moments
from pdfem_mpi.runs.correction_notes import describe_correction
from pdfem_mpi.runs.failure_notes import criteria, describe_criterion, failure_summary
from pdfem_mpi.runs.prepare import describe_mirrors
from pdfem_mpi.runs.sanity import doubts
from pdfem_mpi.runs.simulation import Simulation
from pdfem_mpi.solvers.stability import smallest_eigenvalue
from pdfem_mpi.system.exit_codes import EXIT_FINISHED, EXIT_STOPPED, RUN_STATUS


@dataclass
class Findings:
    """What was found when a simulation was examined before its first step.

    Attributes
    ----------
    notes : list of str
        What the user should know.
    failure : dict or None
        Strength, lengths and fracture energies for summary.json.
    bonds_by_material : int64, shape (n_materials, n_materials), or None
    smallest_eigenvalue : float or None
        Of a body with fitted factors.
    stable : bool or None
        None where it was not examined.
    """

    notes: list[str] = field(default_factory=list)
    failure: dict[str, Any] | None = None
    bonds_by_material: np.ndarray | None = None
    smallest_eigenvalue: float | None = None
    stable: bool | None = None


def describe_body(simulation: Simulation) -> list[str]:
    """Lines about the mesh file, unsupported parts, and loads on supported places. Collective."""
    scene, share, case = simulation.scene, simulation.share, simulation.case
    lines = [f"mesh: {text}" for text in share.notes]
    lines += describe_unsupported(case.parts, case.unsupported)
    if not np.isnan(case.taken).all():
        lines.append(describe_taken(case.taken * share.units.force, scene.units.force))
    return lines


def examine(simulation: Simulation, is_resumed: bool) -> Findings:
    """Examine a simulation whose solver is prepared, before its first step. Collective."""
    scene, share, model = simulation.scene, simulation.share, simulation.model
    found = Findings()
    found.notes += model.body_fit.notes if model.body_fit else ()
    found.notes += describe_correction(scene, share, model)
    found.notes += describe_moments(model.moments)
    limits = criteria(scene, share, model)
    found.failure = failure_summary(scene, share, simulation.failure, limits)
    found.notes += doubts(scene, share, limits)
    found.notes += describe_criterion(scene, share, simulation.failure, limits)
    _examine_stability(simulation, is_resumed, found)
    return found


def describe_bonds(simulation: Simulation, found: Findings) -> list[str]:
    """Lines about cracks, and interfaces that no bond crosses. Collective."""
    scene, share, model = simulation.scene, simulation.share, simulation.model
    lines = []
    for index, cut in enumerate(model.cut):
        text = f"cuts {cut:,} bonds" if cut else "cuts no bond: it does not pass through peridynamic cells"
        lines.append(f"cracks.{index} {text}")
    lines += share.crack_notes
    found.bonds_by_material = count_by_material(simulation.comm, model.bonds) if model.bonds else None
    return lines + list(interfaces_without_bonds(scene, share, found.bonds_by_material))


def _examine_stability(simulation: Simulation, is_resumed: bool, found: Findings) -> None:
    """Fitted factors of both signs may leave a body without a stable equilibrium. Collective."""
    fit, preconditioner = simulation.model.body_fit, simulation.solver.preconditioner
    free = simulation.scene.peridynamics.signs == "free"
    if not (fit and fit.fit and preconditioner and not is_resumed and (free or not fit.reused)):
        return
    found.smallest_eigenvalue = smallest_eigenvalue(simulation.model, simulation.case.fixed, preconditioner)
    found.stable = found.smallest_eigenvalue is not None
    if not found.stable:
        remedy = 'peridynamics.signs = "bounded"' if free else 'surface_correction = "virial"'
        text = f"warning: the fitted body is unstable: some motion lowers its energy. Use {remedy}."
        found.notes.append(text)


def interfaces_without_bonds(scene: Scene, share: Share, by_material: np.ndarray | None):
    """Sentences about interfaces that no bond crosses."""
    number = share.materials.names.index
    for index, interface in enumerate(scene.interfaces):
        if not by_material[tuple(number(name) for name in interface.between)]:
            yield f"interfaces.{index} is crossed by no bond: its materials do not meet in peridynamics or the overlap"


def describe_nothing(start_up: float, idle: int) -> str:
    """A sentence about a start that ended where it began, perhaps after others that did."""
    again = f" It is start {idle + 1} in a row that did nothing." if idle else ""
    return f". Nothing was done. Start-up alone took {start_up:.1f} s: allow more.{again}"


def describe_taken(force: np.ndarray, unit: str) -> str:
    """A sentence about loads on supported places; force (3,), NaN along axes where there are none."""
    parts = [f"{value:.6g}{' ' + unit if unit else ''} along {axis}" for value, axis in zip(force, "xyz", strict=True)
             if not np.isnan(value)]  # fmt: skip
    return f"loads of {', '.join(parts)} act on held places: their supports take them, and reactions do not count them"


def headline(simulation: Simulation, sizes: dict[str, int], seconds: float) -> list[str]:
    """The line that opens a run, and one about its mirror planes."""
    scene, comm, counts = simulation.scene, simulation.comm, sizes
    parts = [f"{counts[name]:,} {name.replace('_', ' ')}" for name in ("elements", "points", "undirected_bonds")]
    lines = [f"{scene.title or 'scene'}: {', '.join(parts)} on {comm.size} ranks, set up in {seconds:.1f} s"]
    if simulation.share.mirrors:
        lines.append(f"mirror planes {describe_mirrors(scene)}; forces and counts are those of this part")
    return lines


def ending(code: int, reason: str | None, out: Path) -> str:
    """The last line of a run."""
    if code == EXIT_FINISHED:
        return f"finished; results in {out}"
    remedy = f". Go on with: pdfem resume {out}" if code == EXIT_STOPPED else ""
    return f"{RUN_STATUS[code]}: {(reason or '').rstrip('.')}{remedy}"
