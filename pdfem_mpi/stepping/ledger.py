"""The books of a program of events: what its state is, what broke, and where the energy went.

The ledger is ``W = U + D + X``: work of loads and supports, strain energy, energy of the bonds when they broke, energy
that relaxation took out. Where a region of bonds grows it is ``W = U + D + X + S``: the two descriptions differ at the
same displacements, and ``S`` is what vanished in all switches. ``W``, ``D`` and ``X`` are summed as they arise (``X``
from each step of the relaxation, by `cg.improve`), ``U`` is measured by a sweep of its own at every row.
"""

from __future__ import annotations

import math

import numpy as np

from pdfem_mpi.deck.programs import Events
from pdfem_mpi.model.forces import Forces
from pdfem_mpi.model.loads import LoadCase, without_loads_on_loose_parts
from pdfem_mpi.model.parts import NAMED
from pdfem_mpi.model.state import State
from pdfem_mpi.parallel.comm import largest, sum_integers
from pdfem_mpi.parallel.sums import exact_dots
from pdfem_mpi.peridynamics.failure import Failure
from pdfem_mpi.solvers.convergence import Convergence
from pdfem_mpi.solvers.equilibrium import EquilibriumSolver
from pdfem_mpi.stepping import arrest
from pdfem_mpi.stepping.report import Report, Reporter, displacement, reaction, support_resultants
from pdfem_mpi.stepping.steps import break_bonds

#: What ``state.program`` keeps.
NUMBERS = (
    "work", "released", "peak", "stable", "batches", "relative", "reaction", "sweeps", "told_sweeps", "size", "adrift",
    "cuts", "apart", "fragments", "fresh", "leg", "began", "evaluated", "first_reaction", "first_displacement",
    "first_row", "peak_displacement", "peak_row", *arrest.NUMBERS,
)  # fmt: skip


class Ledger:
    """The books of one run; ``state.program`` keeps all that a later continuation needs.

    Its numbers: external ``work`` and energy ``released`` by relaxation so far; ``peak`` of the reaction over stable
    states; whether the state is ``stable``; ``batches`` of broken bonds; ``relative`` residual and ``reaction`` at the
    last evaluation; ``sweeps`` so far, and ``told_sweeps`` at the last row; ``size`` of the displacements when last
    stable; how often in a row something went ``adrift`` without breaking a bond, and steps were ``cuts``; whether the
    body came ``apart`` under a constant force; whether parts ran away under their own loads before, so that such
    ``fragments`` are looked for; whether the last batch broke bonds, loads were taken off since or a step was cut
    (``fresh``); at which batch the last avalanche ``began``; and whether the last evaluation is that of the stable
    state (``evaluated``). Under opening control also the largest ``opening`` so far; and the reaction, displacement and
    row where the ``first`` bond is about to break and at the ``peak``.
    """

    def __init__(
        self, settings: Events, solve: EquilibriumSolver, failure: Failure, state: State, case: LoadCase, watch
    ):
        self.settings, self.solve, self.failure, self.state, self.case = settings, solve, failure, state, case
        self.whole = case
        self.forces, self.model = solve.forces, solve.forces.model
        self.finite = self.model.finite
        self.tangent = self.forces
        if self.finite:
            bounds = self.forces.bounds.part("tangent")
            own = self.forces
            self.tangent = Forces(self.model, bounds, tangent=True, seconds=own.seconds, swept=own.swept)
        self.watch = lambda progress: watch(state.step + 1, progress)
        self.reporter = Reporter(self.forces, case, failure)
        self.residual = np.empty_like(state.u)
        self.counted = self._evaluations()
        self.unsupported: frozenset[str] = frozenset()
        if "stable" in state.program:  # a checkpoint may be older than some of the numbers
            state.program |= dict.fromkeys(NUMBERS, 0.0) | state.program
        if settings.control == "opening":
            state.program.setdefault("opening", 0.0)
        if state.program.get("fragments"):
            self.find_loads()

    def row(self, event: str) -> Report:
        """Describe the state."""
        program = self.state.program
        self.state.step += 1
        self.count()
        sweeps = int(program["sweeps"] - program["told_sweeps"])
        program["told_sweeps"] = program["sweeps"]
        row = self.reporter.report(
            self.state, event, Convergence(sweeps, program["relative"]), program["work"], program["released"]
        )
        self.count()
        return row

    def pause(self) -> None:
        """Keep a checkpoint or stop, if asked to: the books are complete here."""
        self.count()
        self.solve.look_at_region(self.state, accepted=False)
        self.solve.stop_requests.between(self.state)

    def carries_little(self) -> bool:
        """Whether the reaction has fallen to where the program ends."""
        program = self.state.program
        return program["reaction"] < self.settings.end_reaction * program["peak"]

    def external(self) -> np.ndarray:
        """The external forces at the state's load, shape (n_unknowns,)."""
        return self.case.forces(self.state.load_factor)

    def evaluate(self, breaking: bool = False) -> int:
        """The residual of the state, with or without breaking bonds; the number of bonds that broke."""
        state, case, program, external = self.state, self.case, self.state.program, self.external()
        broke = 0
        if breaking:
            broke = break_bonds(self.solve, self.failure, state, external, self.settings.eta, self.residual)
            program["released"] += self.failure.take_excess()
        else:
            self.forces.evaluate_surely(state.u, external, self.residual)
        resultants = support_resultants(self.forces, case, self.residual)
        program["reaction"] = reaction(case, resultants, state.load_factor)
        on_supports = self.residual[case.fixed]
        self.residual[case.fixed] = 0.0
        square, load, reactions = exact_dots(
            self.model.comm, [(self.residual, self.residual), (external, external), (on_supports, on_supports)]
        )
        self.reference = math.sqrt(max(load, reactions)) or 1.0
        program["relative"] = math.sqrt(square) / self.reference
        self.count()
        return broke

    def opening(self) -> float:
        """The controlled opening of the state. Collective."""
        return self.case.opening.read(self.model.comm, self.state.u)

    def excess(self) -> float:
        """What the load is divided by for the next state of the program, at the last evaluation. Collective.

        The largest stretch over its critical one, or the opening over the largest so far where that is less; at most
        the opening over that at which the run ends.
        """
        ratio = self.forces.largest_ratio(self.failure)
        if self.settings.control != "opening":
            return ratio
        opening, held = self.opening(), self.state.program["opening"]
        if held:
            ratio = min(ratio, opening / held)
        last = self.settings.end_opening
        return ratio if last is None else max(ratio, opening * self.model.units.length / last)

    def take_loads_off(self) -> bool:
        """Parts that hang together with nothing that could balance their loads carry none; whether loads changed."""
        before, known = self.case.forces(1.0), self.unsupported
        self.find_loads()
        changed = np.count_nonzero(self.case.forces(1.0) != before)
        if not sum_integers(self.model.comm, np.array([changed]))[0]:
            return False
        self.state.program["adrift"] = 0.0
        new = sorted(self.unsupported - known)
        for text in new[:NAMED]:
            self.solve.note(f"after {self.failure.count:,} broken bonds loads are off what came loose: {text}")
        if len(new) > NAMED:
            self.solve.note(f"and off {len(new) - NAMED:,} parts more")
        return True

    def find_loads(self) -> None:
        """The loads that are left: a function of the bonds that are, so that a run taken up again finds the same."""
        self.case, parts = without_loads_on_loose_parts(self.model, self.whole)
        self.reporter.case, self.unsupported = self.case, frozenset(part.text for part in parts)

    def prescribe(self) -> None:
        """Set the prescribed displacements of the state's load."""
        self.case.displace(self.state.u, self.state.load_factor)

    def stored(self) -> float:
        """Strain energy at the last evaluation."""
        return self.forces.stored_energy(self.state.u)

    def size(self, vector: np.ndarray) -> float:
        """Largest component of a vector over the unknowns. Collective."""
        return float(largest(self.model.comm, np.array([np.abs(vector).max(initial=0.0)]))[0])

    @property
    def stable_size(self) -> float:
        """Largest displacement when last stable; before that, of the first equilibrium. Collective."""
        return self.state.program["size"] or self.size(self.state.u)

    def _evaluations(self) -> int:
        return self.forces.evaluations + (self.tangent.evaluations if self.finite else 0)

    def count(self) -> None:
        """Book the sweeps since the last time."""
        self.state.program["sweeps"] += self._evaluations() - self.counted
        self.counted = self._evaluations()


def last_breaks(ledger: Ledger) -> str:
    """Where the bonds that broke last lie, in the deck's units. Collective."""
    failure, units = ledger.failure, ledger.model.units
    low, high = failure.last_extent * units.length + units.origin
    sides = (f"[{a:.6g}, {b:.6g}]" for a, b in zip(low, high, strict=True))
    return f"The last bonds broke in {' x '.join(sides)}."


def remember_peak(ledger: Ledger, breaks: bool = True) -> None:
    """Book a state of equilibrium that has the largest reaction, or in which the first bond is about to break.

    Parameters
    ----------
    breaks : bool
        Whether a bond is about to break in it.
    """
    program, state = ledger.state.program, ledger.state
    names = ["first"] if breaks and not program["first_row"] else []
    if program["reaction"] > program["peak"]:
        program["peak"] = program["reaction"]
        names.append("peak")
    if names:
        reached = displacement(ledger.forces, ledger.whole, state)
    for name in names:
        program[f"{name}_displacement"], program[f"{name}_row"] = reached, state.step + 1.0
        if name == "first":
            program["first_reaction"] = program["reaction"]
