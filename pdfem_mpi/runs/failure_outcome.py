"""What came of a body that can fail: first break, peak, energies and the crack, for summary.json and the end table."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from pdfem_mpi.body.model_units import ModelUnits
from pdfem_mpi.body.share import Share
from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.peridynamics.failure import Failure

#: Rows that are no state of equilibrium, and do not count as a peak.
LOOSE = ("batch", "end")


def failure_outcome(
    history: dict[str, np.ndarray],
    program: dict[str, float],
    failure: Failure,
    units: ModelUnits,
    found: dict[str, Any],
) -> dict[str, Any]:
    """First break, peak, counts, energies and crack, in the deck's units; None for what did not happen.

    Parameters
    ----------
    history : dict
        Columns of history.csv.
    program : dict
        Numbers of the load program: events keep their peak, whatever rows are told.
    found : dict
        What `failure_notes.failure_summary` says of the materials.
    """
    materials = list(found["materials"].values())
    one = materials[0] if len(materials) == 1 else None
    fracture_energy = {
        "bulk": one and one["fracture_energy_bulk"],
        "own_bonds": one and one["fracture_energy_own_bonds"],
    }
    low, high = (side.tolist() for side in failure.extent * units.length + units.origin)
    there = bool(np.isfinite(low).all())
    return {
        "first_break": first_break(history, program, units),
        "peak": peak(history, program, units),
        "broken_bonds": failure.count,
        "softened_bonds": getattr(failure, "soft", 0),
        "fracture_energy": fracture_energy,
        "crack": {
            "area": _area(failure, units, fracture_energy["bulk"]),
            "lower": low if there else None,
            "upper": high if there else None,
        },
    }


def first_break(history: dict[str, np.ndarray], program: dict[str, float], units: ModelUnits) -> dict[str, Any] | None:
    """Load and displacement at which the first bond broke or softened; of steps and ramps those of the row after it."""
    if program.get("first_reaction"):
        return {
            "load": program["first_reaction"] * units.force,
            "displacement": program["first_displacement"] * units.length,
            "row": int(program["first_row"]),
        }
    broke = history["broken_bonds"] > 0
    if "softened_bonds" in history:
        broke |= history["softened_bonds"] > 0
    return _row(history, int(np.argmax(broke))) if broke.any() else None


def peak(history: dict[str, np.ndarray], program: dict[str, float], units: ModelUnits) -> dict[str, Any] | None:
    """The largest reaction of the states in equilibrium; of a ramp, that of its rows."""
    if program.get("peak_row"):
        return {
            "load": program["peak"] * units.force,
            "displacement": program["peak_displacement"] * units.length,
            "row": int(program["peak_row"]),
        }
    load = history["reaction"]
    if not len(load):
        return None
    held = ~np.isin(history["event"], LOOSE)
    return _row(history, int(np.argmax(np.where(held if held.any() else True, load, -np.inf))))


def _row(history: dict[str, np.ndarray], k: int) -> dict[str, Any]:
    return {
        "load": float(history["reaction"][k]),
        "displacement": float(history["displacement"][k]),
        "row": int(history["step"][k]),
    }


def _area(failure: Failure, units: ModelUnits, fracture_energy: float | None) -> float | None:
    """Energy of the bonds that are gone over the fracture energy; brittle materials need one for all."""
    if hasattr(failure, "area"):
        return failure.area * units.length**2
    if not fracture_energy:
        return None
    return failure.dissipated * units.force * units.length / fracture_energy


def failure_rows(outcome: dict[str, Any] | None, scene: Scene) -> list[tuple[str, str]]:
    """Rows of the table at the end."""
    if not outcome or "peak" not in outcome:
        return []
    force, length = (f" {unit}" if unit else "" for unit in (scene.units.force, scene.units.length))
    rows = []
    for name, key in (("first break", "first_break"), ("peak", "peak")):
        if found := outcome[key]:
            rows.append(
                (name, f"{found['load']:.6g}{force} at {found['displacement']:.6g}{length}, row {found['row']}")
            )
    broken, softened = (f"{outcome[key]:,}" for key in ("broken_bonds", "softened_bonds"))
    rows.append(
        (
            "bonds broken, softened" if scene.softens else "bonds broken",
            f"{broken}, {softened}" if scene.softens else broken,
        )
    )
    crack = outcome["crack"]
    if crack["area"]:
        rows.append(("crack area, energy over G_c", f"{crack['area']:.4g}{f'{length}^2' if length else ''}"))
    return rows


def crack_in_a_mirror(scene: Scene, share: Share, failure: Failure | None) -> Iterator[str]:
    """A warning where bonds softened along a mirror plane: both sides of the crack are then one."""
    if failure is None or not scene.softens or not failure.count:
        return
    low, high = failure.extent
    sizes = high - low
    for face in scene.mesh.symmetry:
        axis, upper = "xyz".index(face[0]), face[1] == "+"
        if len(share.mirrors.planes[axis]) > 1:
            continue
        (plane,) = share.mirrors.planes[axis]
        depth = plane - low[axis] if upper else high[axis] - plane
        if depth <= share.cutoff and sizes.max() > share.cutoff:
            yield (
                f"warning: the crack runs in the mirror plane {face}, where bonds soften on both sides alike: it takes "
                "up to 1.5 times its energy, and the peak is too high. Model both sides of the plane."
            )
