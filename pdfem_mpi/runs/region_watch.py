"""Whether the bonds of a region that is found are where the next break can happen; asked by the load programs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from pdfem_mpi.body.found_region import Turning
from pdfem_mpi.measure.foretelling import Foretelling
from pdfem_mpi.model.state import State
from pdfem_mpi.parallel.comm import largest, sum_integers
from pdfem_mpi.solvers.convergence import NotConverged
from pdfem_mpi.stepping import Report

if TYPE_CHECKING:
    from pdfem_mpi.runs.simulation import Simulation

#: A load is a new peak, whose error is worth an estimate, from this many times the one before on.
RISE = 1.01
#: The largest foretold stretches are told from this fraction of the critical one on.
TOLD_FROM = 0.5


class RegionTooSmall(Exception):
    """Bonds are needed where there are elements; the state is whole.

    Attributes
    ----------
    turning : Turning
        What to turn.
    """

    def __init__(self, turning: Turning):
        self.turning = turning
        super().__init__("bonds are needed where there are elements")


@dataclass
class RegionWatch:
    """Looks at a state, and asks for more bonds.

    Attributes
    ----------
    simulation : Simulation
    foretelling : Foretelling
    damaged : bool, shape (n_cells,)
        Cells of the share at the ends of the rank's broken bonds, as far as the books were read.
    entries : int
        How many of their entries were.
    """

    simulation: Simulation
    foretelling: Foretelling
    damaged: np.ndarray
    entries: int = 0

    @classmethod
    def of(cls, simulation: Simulation) -> RegionWatch:
        """That of a simulation as it is now. Collective."""
        share = simulation.share
        none = np.zeros(len(share.cell_owner), bool)
        return cls(simulation, Foretelling(simulation.scene, share, simulation.model), none)

    def look(self, state: State, accepted: bool = True) -> None:
        """Compare what is needed with what there is. Collective.

        Parameters
        ----------
        accepted : bool
            The load program takes the state for an equilibrium: how much it foretells is remembered, of elements that
            must stay as well.

        Raises
        ------
        RegionTooSmall
            On all ranks: the region must grow.
        NotConverged
            On all ranks: it must, and cannot.
        """
        simulation, settings = self.simulation, self.simulation.scene.adaptive
        share, comm = simulation.share, simulation.comm
        found, cells = share.found, self.foretelling.cells
        threshold = settings.threshold_with(simulation.scene.peridynamics.surface_correction)
        stays, program, damaged = ~found.can_turn[cells], state.program, self._damaged()
        known, known_of_staying = (program.setdefault(name, 0.0) for name in ("foretold", "staying"))
        # what is not above these says nothing new
        new = min(max(known, TOLD_FROM), threshold) if accepted else threshold
        matters = np.where(stays, max(known_of_staying, TOLD_FROM) if accepted else np.inf, new)
        ratio = self.foretelling.ratios(state.u, matters, self.damaged)
        hot = cells[(ratio >= threshold) & ~stays]
        missing = np.count_nonzero(found.too_near[hot]) + np.count_nonzero(found.too_near[damaged])
        ends = np.count_nonzero(found.at_the_end[damaged])
        missing, ends = sum_integers(comm, np.array([missing, ends])).tolist()
        tops = np.array([ratio[~stays].max(initial=0.0), ratio[stays].max(initial=0.0)])
        top, staying = largest(comm, tops).tolist()
        top, program["staying"] = max(top, known), max(staying, known_of_staying)
        if ends:
            raise NotConverged(self._describe_end(damaged[found.at_the_end[damaged]]))
        if not missing:
            program["foretold"] = top
            return
        seeds = share.mesh.cell_id[np.concatenate([hot, damaged])]
        seeds = np.unique(np.concatenate(comm.allgather(np.unique(seeds))))
        if not settings.growth:
            raise NotConverged(self._describe_small(top, seeds))
        raise RegionTooSmall(Turning(found.turned, seeds, settings.growth))

    def asks_for_error(self, report: Report) -> bool:
        """Whether the error is to be estimated at a row: at the first break, and at the peak where that is wanted."""
        return any(self._asks_for_error(report))

    def hear_error(self, report: Report, error: float | None) -> None:
        """Remember the error at a row; None where it could not be told."""
        program = self.simulation.state.program
        first, peak = self._asks_for_error(report)
        program["widened"], program["widened_at"] = float(error is not None), report.reaction
        for name, is_told in (("error", first), ("error_of_peak", peak)):
            if is_told and error is not None:
                program[name] = error
            elif is_told:  # a lower load's says nothing of this one
                program.pop(name, None)

    def _asks_for_error(self, report: Report) -> tuple[bool, bool]:
        """Whether the row is that of the first break, and one of which the error of the peak is told."""
        program, wanted = self.simulation.state.program, self.simulation.scene.adaptive.widening_check
        if not wanted or report.event != "critical":
            return False, False
        first = not report.broken and "widened" not in program
        rises = report.reaction > RISE * program.get("widened_at", 0.0)
        return first, wanted == "peak" and (first or rises)

    def _damaged(self) -> np.ndarray:
        """Places in the share of the cells at the ends of the rank's broken bonds; int64."""
        share, failure = self.simulation.share, self.simulation.failure
        if failure is not None:
            for pairs in failure.global_pairs[self.entries :]:
                self.damaged[share.mesh.places_of_cells(np.unique(pairs // 8 % share.counts.cells))] = True
            self.entries = len(failure.global_pairs)
        return np.flatnonzero(self.damaged)

    def _describe_end(self, places: np.ndarray) -> str:
        """The crack has come to what stays elements. Collective."""
        where = self._first(self.simulation.share.mesh.cell_id[places])
        return (
            f"{self._so_far()} the damage comes within adaptive.reach = {self.simulation.scene.adaptive.reach:g} of "
            f"cells that must stay elements, at {where}: beside them no bond may fail, and what follows would not be "
            "the body's. Supports, loads, regions of elements, always_elements and may_fail = false make cells stay: "
            "move them away, or end the run before, by stepping.end_reaction or end_load_factor."
        )

    def _describe_small(self, top: float, seeds: np.ndarray) -> str:
        """The region would have to grow, and the deck says that it stays."""
        share = self.simulation.share
        length = share.units.length
        return (
            f"{self._so_far()} the region of bonds does not hold: elements foretell {top:.3f} of the critical stretch, "
            f"or broken bonds come within adaptive.reach of them, in {len(seeds):,} cells. adaptive.growth = 0 keeps "
            f"it as it was found. Let it grow: growth = {4.0 * self.simulation.scene.adaptive.reach:g} (in lengths of "
            f"{length:g}), or begin with more of it, by adaptive.pilot or a smaller threshold."
        )

    def _so_far(self) -> str:
        count = self.simulation.failure.count if self.simulation.failure else 0
        return f"after {count:,} broken bonds"

    def _first(self, numbers: np.ndarray) -> str:
        """Where the first of some cells on all ranks is. Collective."""
        share = self.simulation.share
        first = share.counts.cells if not len(numbers) else int(numbers.min())
        first = int(-largest(share.comm, np.array([-float(first)]))[0])
        place = np.full(3, -np.inf)
        here = np.flatnonzero((share.mesh.cell_id == first) & share.is_owned)
        if len(here):
            place = share.mesh.centroids[here[0]]
        return f"({', '.join(f'{x:.6g}' for x in largest(share.comm, place))})"
