"""What the log, the end table and summary.json say of a region of bonds that a run finds."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pdfem_mpi.peridynamics.bonds import total_bonds

if TYPE_CHECKING:
    from pdfem_mpi.runs.simulation import Simulation


def describe_switch(simulation: Simulation) -> str:
    """A line about a switch. Collective."""
    found, program = simulation.share.found, simulation.state.program
    bonds = total_bonds(simulation.comm, simulation.model.bonds)
    return (
        f"switch {int(program['switches'])}: {len(found.turned):,} cells of bonds that may fail, {bonds:,} bonds; "
        f"{found.left:,} cells could still be turned"
    )
