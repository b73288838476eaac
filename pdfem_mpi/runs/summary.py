"""What summary.json and the table at the end say of a run."""

from __future__ import annotations

import hashlib
import math
import platform
import sys
from collections.abc import Iterator
from dataclasses import asdict
from typing import Any

import numpy as np

from pdfem_mpi import __version__
from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.model.model import Model
from pdfem_mpi.peridynamics.fit.fit import BodyFit
from pdfem_mpi.results.history import read_history
from pdfem_mpi.runs.failure_outcome import failure_outcome, failure_rows
from pdfem_mpi.runs.march import March
from pdfem_mpi.runs.notes import Findings
from pdfem_mpi.runs.region_notes import region_rows, region_summary
from pdfem_mpi.system.exit_codes import RUN_STATUS

SCHEMA_VERSION = 1


def make_summary(scene: Scene, march: March, findings: Findings, facts: dict[str, Any]) -> dict[str, Any]:
    """The content of summary.json.

    Parameters
    ----------
    march : March
        After its end.
    findings : Findings
    facts : dict
        What only the run knows: deck_text, fields_sha256, counts, bonds_per_rank, evaluations, memory, times.
    """
    simulation, checkpoints, ended = march.simulation, march.checkpoints, march.ended
    model, share = simulation.model, simulation.share
    return {
        "schema_version": SCHEMA_VERSION,
        "status": RUN_STATUS[ended.code],
        "reason": ended.reason,
        "exit_code": ended.code,
        "title": scene.title,
        "deck_sha256": sha256(facts["deck_text"]),
        "fields_sha256": facts["fields_sha256"],
        "ranks": simulation.comm.size,
        "mesh": {
            "kind": scene.mesh.kind,
            "symmetry": list(scene.mesh.symmetry),
            "sha256": share.mesh_sha256,
            "notes": list(share.notes),
            **asdict(share.quality),
        },
        "counts": facts["counts"],
        "bonds_per_rank": facts["bonds_per_rank"],
        **_last_row(march, facts["evaluations"]),
        "checkpoints": {
            "written": checkpoints.written,
            "failed": checkpoints.failed,
            "seconds": checkpoints.seconds_in_all,
            "bytes_of_last": checkpoints.size or None,
        },
        "restarts": checkpoints.restarts,
        "seconds_of_all_starts": facts["seconds_of_all_starts"],
        **_of_bonds(scene, model, findings),
        "failure": _failure(march, findings),
        **({"adaptive": region_summary(simulation)} if scene.is_adaptive else {}),
        "bonds_cut_by_cracks": list(model.cut),
        "parts_at_start": {"count": simulation.case.parts.count, "not_held": len(simulation.case.unsupported)},
        "bonds_by_materials": named_pairs(share.materials.names, findings.bonds_by_material),
        "probes": march.outputs.results,
        "seconds": facts["seconds"],
        "memory": facts["memory"],
        "communication": ended.communication,
        "versions": {
            "pdfem_mpi": __version__,
            "python": platform.python_version(),
            "numpy": np.__version__,
            "numba": sys.modules["numba"].__version__,
        },
    }


def _failure(march: March, findings: Findings) -> dict[str, Any] | None:
    """The criterion, and what came of it."""
    failure, simulation = march.simulation.failure, march.simulation
    if failure is None or findings.failure is None:
        return findings.failure
    try:
        history = read_history(march.outputs.history.history.path)
    except (OSError, ValueError):
        return findings.failure
    units, program = simulation.share.units, simulation.state.program
    return findings.failure | failure_outcome(history, program, failure, units, findings.failure)


def _of_bonds(scene: Scene, model: Model, findings: Findings) -> dict[str, Any]:
    """How bonds were corrected, and the volumetric part beside them; JSON knows no infinite limit."""
    kind = scene.peridynamics.surface_correction
    parts = [asdict(moment) for moment in model.moments]
    return {
        "surface_correction": {
            "kind": kind if model.bonds else None,
            "remaining": model.correction_remaining if model.bonds else None,
            "fit": fit_report(model.body_fit, findings.smallest_eigenvalue, findings.stable),
        },
        "volumetric_part": [part | {"limit": part["limit"] if part["limit"] < math.inf else None} for part in parts],
    }


def _last_row(march: March, evaluations: int) -> dict[str, Any]:
    """How well the last equilibrium was found."""
    last = march.outputs.history.history.last() or {}

    def number(column, kind=float):
        return kind(last[column]) if last.get(column) else None

    return {
        "solve": {
            "kind": march.simulation.scene.solver.kind,
            "load_steps": march.simulation.state.step,
            "evaluations": evaluations,
            "evaluations_last_step": number("evaluations", int),
            "relative_residual": number("relative_residual"),
            "energy_error": march.energy_error,
        },
        "balance": {"force": number("force_balance"), "moment": number("moment_balance")},
    }


def named_pairs(names: tuple[str, ...], by_material: np.ndarray | None) -> dict[str, int]:
    """Bonds between each two of several materials that have any, by name; empty for one material."""
    if by_material is None or len(names) == 1:
        return {}
    pairs = [(a, b) for a in range(len(names)) for b in range(a, len(names)) if by_material[a, b]]
    return {f"{names[a]} - {names[b]}": int(by_material[a, b]) for a, b in pairs}


def fit_report(outcome: BodyFit | None, smallest: float | None, stable: bool | None) -> dict[str, Any] | None:
    """What became of the fit of the bond factors; its numbers are missing where none serves.

    Stability is null where it was not looked at: by relaxation, after a restart, or positive factors of an earlier fit.
    """
    if outcome is None:
        return None
    report = {
        "fingerprint": outcome.fingerprint,
        "reused": outcome.reused,
        "notes": list(outcome.notes),
        "bodies": outcome.n_bodies,
    }
    found = {"smallest_eigenvalue": smallest, "stable": stable}
    if outcome.dilatation:
        found["dilatation"] = asdict(outcome.dilatation)
    return report | (asdict(outcome.fit) | found if outcome.fit else {})


def end_table(summary: dict, scene: Scene) -> list[tuple[str, str]]:
    """The table at the end: sizes, residuals, probes, times."""
    rows = [(name.replace("_", " "), f"{count:,}") for name, count in summary["counts"].items()]
    solve, balance = summary["solve"], summary["balance"]
    rows.append(("force evaluations", f"{solve['evaluations']:,}"))
    if solve["relative_residual"] is not None:
        rows.append(("relative residual", f"{solve['relative_residual']:.2e}"))
        if solve["energy_error"] is not None:
            rows.append(("error in the energy norm, about", f"{solve['energy_error']:.2e}"))
        rows.append(("net internal force, moment", f"{balance['force']:.1e}, {balance['moment']:.1e} of the sums"))
    rows += failure_rows(summary["failure"], scene)
    rows += region_rows(summary.get("adaptive"))
    length = scene.units.length
    for name, value in summary["probes"].items():
        if isinstance(value, dict):
            rows += [(f"{name}, {word}".replace("_", " "), text) for word, text in _nested(value)]
            continue
        unit = f" {length}" if isinstance(value, list) or name == "end_displacement" else ""
        text = ", ".join(f"{v:.6g}" for v in value) if isinstance(value, list) else f"{value:.6g}"
        rows.append((name.replace("_", " "), text + unit))
    seconds = summary["seconds"]
    rows.append(("seconds: set-up, solve, total", ", ".join(f"{seconds[k]:.1f}" for k in ("setup", "solve", "total"))))
    if summary["communication"]:
        rows.append(("between ranks", _describe_communication(summary["communication"])))
    rows.append(("peak memory per rank", f"{max(summary['memory']['peak_bytes_per_rank']) / 2**20:.0f} MiB"))
    return rows


def _describe_communication(between: dict[str, Any]) -> str:
    """Balance, waiting and what was sent, in words."""
    computed, waited = (between[f"seconds_{what}"]["mean"] for what in ("computed", "waited"))
    sent, size = (between[f"{what}_per_evaluation"]["mean"] for what in ("messages", "bytes"))
    share = 100.0 * waited / max(computed + waited, 1e-9)
    return (
        f"the busiest computed {between['imbalance']:.2f} times the mean, {share:.0f} % of the time was waited, "
        f"{sent:.0f} messages and {size / 2**10:.0f} KiB sent a rank and evaluation"
    )


def _nested(found: dict[str, Any]) -> Iterator[tuple[str, str]]:
    """Words and numbers of what a probe found by name; means of what it found over a set."""
    for word, value in found.items():
        if value is None:
            continue
        values = value["mean"] if isinstance(value, dict) else value if isinstance(value, list) else [value]
        yield (
            f"mean {word}" if isinstance(value, dict) else word,
            ", ".join("-" if v is None else f"{v:.6g}" for v in values),
        )


def sha256(text: str) -> str:
    """Digest of a deck."""
    return hashlib.sha256(text.encode()).hexdigest()
