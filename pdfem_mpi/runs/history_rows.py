"""Rows of history.csv: a report of the load program in the units of the deck."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from pdfem_mpi.body.model_units import ModelUnits
from pdfem_mpi.deck.mechanical_probes import CutProbe
from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.stepping import Report

HISTORY = (
    "step", "event", "load_factor", "displacement", "reaction", "reaction_x", "reaction_y", "reaction_z", "evaluations",
    "relative_residual", "energy_error", "force_balance", "moment_balance",
)  # fmt: skip
#: Where bonds can break.
FAILURE_HISTORY = (
    "broken_bonds", "new_broken_bonds", "stored_energy", "dissipated_energy", "external_work", "released_energy",
    "ledger_error", "crack_x_min", "crack_x_max", "crack_y_min", "crack_y_max", "crack_z_min", "crack_z_max",
)  # fmt: skip
#: Where they soften before.
SOFTENING_HISTORY = ("softened_bonds",)
#: Where the run finds where bonds are needed.
ADAPTIVE_HISTORY = ("bonds", "switched_energy")


def columns_of(fails: bool, scene: Scene) -> tuple[str, ...]:
    """Columns of history.csv; more where bonds can break, or soften, of a program over a time, and of probes read at
    every row.
    """
    columns = HISTORY + FAILURE_HISTORY if fails else HISTORY
    columns += SOFTENING_HISTORY if fails and scene.softens else ()
    columns += ADAPTIVE_HISTORY if scene.is_adaptive else ()
    timed = getattr(scene.stepping, "times", None) is not None
    return columns + (("time",) if timed else ()) + tuple(probe_row(scene.probes, {}))


def probe_row(probes: Sequence[Any], probed: Mapping[str, Any]) -> dict[str, float | None]:
    """What the cuts among the probes carry, by their columns of history.csv; None where that is not known."""
    cuts = [probe.name for probe in probes if isinstance(probe, CutProbe)]
    return {
        f"{name}.{word}_{axis}": probed[name][word][d] if name in probed else None
        for name in cuts
        for word in ("force", "moment")
        for d, axis in enumerate("xyz")
    }


def history_row(row: Report, units: ModelUnits, fails: bool) -> dict[str, Any]:
    """A report in the deck's units, by the columns of history.csv."""
    resultant = (row.resultant * units.force).tolist()
    columns = {
        "step": row.step,
        "event": row.event,
        "load_factor": row.load_factor,
        "displacement": row.displacement * units.length,
        "reaction": row.reaction * units.force,
        **dict(zip(("reaction_x", "reaction_y", "reaction_z"), resultant, strict=True)),
        "evaluations": row.convergence.evaluations,
        "relative_residual": row.convergence.residual,
        "energy_error": row.convergence.energy_error,
        "force_balance": row.force_balance,
        "moment_balance": row.moment_balance,
        "wall_seconds": row.seconds,
    }
    if row.time is not None:
        columns["time"] = row.time
    if fails:
        energy = units.force * units.length
        extent = row.extent * units.length + units.origin
        columns |= {
            "broken_bonds": row.broken,
            "new_broken_bonds": row.new_broken,
            "stored_energy": _times(row.stored, energy),
            "dissipated_energy": _times(row.dissipated, energy),
            "external_work": _times(row.work, energy),
            "released_energy": _times(row.released, energy),
            "ledger_error": row.ledger_error,
        }
        for d, axis in enumerate("xyz"):
            columns[f"crack_{axis}_min"], columns[f"crack_{axis}_max"] = extent[:, d] if row.broken else (None, None)
    if row.softened is not None:
        columns["softened_bonds"] = row.softened
    if row.switched is not None:
        columns["switched_energy"] = row.switched * units.force * units.length
    return columns


def _times(value: float | None, unit: float) -> float | None:
    return None if value is None else value * unit
