"""What the log, the end table and summary.json say of a region of bonds that a run finds."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from pdfem_mpi.peridynamics.bonds import total_bonds

if TYPE_CHECKING:
    from pdfem_mpi.runs.simulation import Simulation


def region_summary(simulation: Simulation) -> dict[str, Any] | None:
    """The entry ``adaptive`` of the summary; None where the deck says where bonds are."""
    program = simulation.state.program
    if not simulation.share.found or "bonds_first" not in program:
        return None
    work = program.get("work", 0.0)
    return {
        "switches": int(program.get("switches", 0.0)),
        "bonds": {
            "first": int(program["bonds_first"]),
            "mean": program["bond_sweeps"] / max(program["counted_at"], 1.0),
            "largest": int(program["bonds_largest"]),
        },
        "error": program.get("error"),
        "error_of_peak": program.get("error_of_peak"),
        "largest_foretold": program.get("foretold"),
        "largest_in_staying_elements": program.get("staying"),
        "switched_energy_over_work": program.get("switched", 0.0) / work if work else None,
        "cells_turned": len(simulation.share.found.turned),
        "cells_left": simulation.share.found.left,
    }


def region_rows(found: dict[str, Any] | None) -> Iterator[tuple[str, str]]:
    """Rows of the table at the end."""
    if found is None:
        return
    bonds = found["bonds"]
    yield "bonds: first, mean, largest", f"{bonds['first']:,}, {bonds['mean']:,.0f}, {bonds['largest']:,}"
    yield "switches", f"{found['switches']}"
    if found["error"] is not None:
        yield "error of the first break, about", f"{100.0 * found['error']:+.2g} %"
    if found["error_of_peak"] is not None:
        yield "error of the peak, about", f"{100.0 * found['error_of_peak']:+.2g} %"
    if found["switches"] and found["switched_energy_over_work"] is not None:
        yield "energy of switches over work", f"{100.0 * found['switched_energy_over_work']:+.2g} %"


def describe_staying(simulation: Simulation) -> Iterator[str]:
    """A warning where elements that must stay would have broken, had they been bonds."""
    most = simulation.state.program.get("staying", 0.0)
    if most >= 1.0:
        yield (
            f"warning: elements that must stay were stretched to {most:.3g} times the critical stretch, and bonds "
            "would have broken there: cells that are held or loaded, that the deck keeps, and those beside them. Hold "
            "and load the body farther away from where it breaks."
        )


def describe_switch(simulation: Simulation) -> str:
    """A line about a switch. Collective."""
    found, program = simulation.share.found, simulation.state.program
    bonds = total_bonds(simulation.comm, simulation.model.bonds)
    return (
        f"switch {int(program['switches'])}: {len(found.turned):,} cells of bonds that may fail, {bonds:,} bonds; "
        f"{found.left:,} cells could still be turned"
    )
