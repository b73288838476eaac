"""From break to break: exact loads of first breaks, avalanches at held load, and a closed ledger of energies.

Between breaks a linear body answers in proportion to the load, so one equilibrium gives the load at which the next
bond breaks. At that load all bonds within ``eta`` of their critical stretch break together, a few iterations of
conjugate gradients relax the rest, and so on until none is left to break: loosely while the avalanche runs, tightly
before a state counts as stable (`arrest`). In finite kinematics the load of the next break is found by bracketing.

The ledger is ``W = U + D + X``: work of loads and supports, strain energy, energy of the bonds when they broke, energy
that relaxation took out. ``W``, ``D`` and ``X`` are summed as they arise (``X`` from each step of the relaxation, by
`cg.improve`), ``U`` is measured by a sweep of its own at every row.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

import numpy as np

from pdfem_mpi.deck.programs import Events
from pdfem_mpi.model.forces import Forces
from pdfem_mpi.model.loads import LoadCase, remove_rigid_motion, without_loads_on_loose_parts
from pdfem_mpi.model.not_finite import NotFinite
from pdfem_mpi.model.parts import NAMED, describe_motion
from pdfem_mpi.model.state import State
from pdfem_mpi.parallel.comm import largest, sum_integers
from pdfem_mpi.parallel.sums import exact_dots
from pdfem_mpi.peridynamics.clusters import by_component
from pdfem_mpi.peridynamics.failure import Failure
from pdfem_mpi.solvers import adr, cg
from pdfem_mpi.solvers.convergence import Breakdown, Convergence, NotConverged, Progress
from pdfem_mpi.solvers.equilibrium import EquilibriumSolver
from pdfem_mpi.stepping import arrest
from pdfem_mpi.stepping.report import Report, Reporter, reaction, support_resultants
from pdfem_mpi.stepping.steps import break_bonds

#: The first equilibrium is at least this tight: the load of the first break is read from it.
FIRST_TOLERANCE = 1e-8
#: A solve aims at this fraction of its tolerance.
SAFETY = 0.9
#: Under a held force, pieces that came off move away for ever: a step this many times the displacements of the last
#: stable state tells.
SEPARATED = 10.0
#: Finite kinematics: a step larger than the displacements when last stable is halved, at most so often, until it
#: stretches no bond more than this many times its critical stretch.
MOST_STRETCH, MOST_HALVINGS = 2.0, 60
#: So many steps in a row are cut in this way before a run gives up.
MOST_CUTS = 100
#: What moves that far so many times in a row, and breaks nothing, does so without end.
MOST_ADRIFT = 3
#: Sweeps of a relaxation that goes to the end, before breaks are looked for again; its residual must at least halve.
MOST_SWEEPS, STAGNATION = 200, 0.5
#: Finite kinematics: the first equilibrium is sought at a strain of about this size.
SMALL_STRAIN = 1e-6
#: Finite kinematics: the largest stretch is brought this near to critical, in at most so many equilibria.
BRACKET, MOST_EQUILIBRIA = 1e-6, 30
#: What ``state.program`` keeps.
NUMBERS = (
    "work", "released", "peak", "stable", "batches", "relative", "reaction", "sweeps", "told_sweeps", "size", "adrift",
    "cuts", "apart", "fragments", "fresh", *arrest.NUMBERS,
)  # fmt: skip


def follow_events(
    settings: Events,
    solve: EquilibriumSolver,
    failure: Failure,
    state: State,
    case: LoadCase,
    watch: Callable,
) -> Iterator[Report]:
    """Yield a row at each critical state, arrest and end, and every ``report_every`` batches. Collective.

    Raises
    ------
    NotConverged, NotFinite
        The state is left at the last batch.
    Stopped
        From ``solve.pauses``, between batches.
    """
    solve.pauses.between(state)
    events = _Events(settings, solve, failure, state, case, watch)
    if "stable" not in state.program:
        events.start()
    program = state.program
    while True:
        if program["stable"]:
            goes_on = events.load_to_break()
            program["stable"] = 0.0
            if not goes_on:
                yield events.row("end")
                return
            told = settings.control == "load" or program["batches"] % settings.report_every == 0
            if told and not program["adrift"]:
                yield events.row("critical")
        broke = events.batch()
        if events.came_apart():
            yield events.row("end")
            return
        if settings.control == "energy":
            program["stable"] = float(not program["adrift"])
        elif program["stable"]:
            yield events.row("arrest")
        elif broke and program["batches"] % settings.report_every == 0:
            yield events.row("batch")
        events.pause()


class _Events:
    """The books of one run; ``state.program`` keeps all that a later continuation needs.

    Its numbers: external ``work`` and energy ``released`` by relaxation so far; ``peak`` of the reaction over stable
    states; whether the state is ``stable``; ``batches`` of broken bonds; ``relative`` residual and ``reaction`` at the
    last evaluation; ``sweeps`` so far, and ``told_sweeps`` at the last row; ``size`` of the displacements when last
    stable; how often in a row something went ``adrift`` without breaking a bond, and steps were ``cuts``; whether the
    body came ``apart`` under a held force; whether parts ran away under their own loads before, so that such
    ``fragments`` are looked for; and whether the last batch broke bonds, loads were taken off since or a step was cut
    (``fresh``).
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
        self.residual, self.step = np.empty_like(state.u), np.zeros_like(state.u)
        self.counted = self._evaluations()
        self.loose: frozenset[str] = frozenset()
        if "stable" in state.program:  # a checkpoint may be older than some of the numbers
            state.program |= dict.fromkeys(NUMBERS, 0.0) | state.program
        if state.program.get("fragments"):
            self._find_loads()

    def start(self) -> None:
        """Find the first equilibrium: at load factor 1 or, for finite kinematics, at a small load."""
        state = self.state
        state.program |= dict.fromkeys(NUMBERS, 0.0) | {"stable": 1.0, "fresh": 1.0}
        state.load_factor = 1.0
        if self.finite:
            state.load_factor = self._small_load()
        self._equilibrate(min(FIRST_TOLERANCE, self.solve.settings.tolerance))
        state.program["work"] = self._stored()

    def load_to_break(self) -> bool:
        """Raise (or lower) the load until a bond is about to break; False if the program ends at or before that."""
        state, program, settings = self.state, self.state.program, self.settings
        self._evaluate()
        self._settle()
        if program["apart"] or (program["fragments"] and self._carries_little()):
            return False
        if program["adrift"]:
            return True
        ratio = self.forces.largest_ratio(self.failure)
        if ratio == 0.0:
            raise NotConverged("the load stretches no bond that may break. Load the body otherwise.")
        limit = math.inf if settings.end_load_factor is None else settings.end_load_factor
        if self.finite:
            self._bracket(ratio, limit)
        else:
            self._scale(min(state.load_factor / ratio, limit))
        arrest.forget(program)
        remove_rigid_motion(self.model, self.case, state.u)
        program["size"] = self._size(state.u)
        if state.load_factor >= limit:
            return False
        if self._carries_little():
            return False
        program["peak"] = max(program["peak"], program["reaction"])
        return True

    def batch(self) -> int:
        """Break what is (nearly) critical and relax the rest for a while; the number of bonds that broke."""
        program, settings = self.state.program, self.settings
        stalled = program["relative"]
        broke = self._evaluate(breaking=True)
        program["batches"] += broke > 0
        self.watch(Progress(int(program["batches"]), program["relative"], 0.0, (self,)))
        by_load = settings.control == "load"
        if not broke and (self._is_settled() if by_load else program["relative"] <= settings.arrest_tolerance):
            program["stable"] = 1.0
            return 0
        if not broke and not program["fresh"]:
            self._refuse_stagnation(stalled)
        program["fresh"] = float(broke > 0)
        if broke:
            program["adrift"] = program["cuts"] = 0.0
        elif program["adrift"] >= MOST_ADRIFT:
            program["apart"] = 1.0
            return 0
        if broke and program["fragments"] and self._take_loads_off():
            self._evaluate()
        loosely = broke and by_load
        if broke:
            arrest.forget(program)
        if not (program["goal"] or loosely):
            program["goal"] = self._next_goal()
        self._relax(settings.inner_iterations - 1 if loosely else MOST_SWEEPS)
        return broke

    def came_apart(self) -> bool:
        """Whether the body does not carry the held load any more."""
        apart = bool(self.state.program["apart"])
        return apart or (self.settings.control == "load" and self._carries_little())

    def row(self, event: str) -> Report:
        """Describe the state."""
        program = self.state.program
        self.state.step += 1
        self._count()
        sweeps = int(program["sweeps"] - program["told_sweeps"])
        program["told_sweeps"] = program["sweeps"]
        row = self.reporter.report(
            self.state, event, Convergence(sweeps, program["relative"]), program["work"], program["released"]
        )
        self._count()
        return row

    def pause(self) -> None:
        """Keep a checkpoint or stop, if asked to: the books are complete here."""
        self._count()
        self.solve.pauses.between(self.state)

    def _carries_little(self) -> bool:
        program = self.state.program
        return program["reaction"] < self.settings.end_reaction * program["peak"]

    # --- steps -------------------------------------------------------------------------------------------------

    def _external(self) -> np.ndarray:
        return self.state.load_factor * self.case.external

    def _evaluate(self, breaking: bool = False) -> int:
        """The residual of the state, with or without breaking bonds; the number of bonds that broke."""
        state, case, program, external = self.state, self.case, self.state.program, self._external()
        broke = 0
        if breaking:
            broke = break_bonds(self.solve, self.failure, state, external, self.settings.eta, self.residual)
        else:
            self.forces.evaluate_surely(state.u, external, self.residual)
        resultants = support_resultants(self.forces, case, self.residual)
        program["reaction"] = reaction(case, resultants, state.load_factor)
        held = self.residual[case.fixed]
        self.residual[case.fixed] = 0.0
        square, load, reactions = exact_dots(
            self.model.comm, [(self.residual, self.residual), (external, external), (held, held)]
        )
        self.reference = math.sqrt(max(load, reactions)) or 1.0
        program["relative"] = math.sqrt(square) / self.reference
        self._count()
        return broke

    def _relax(self, sweeps: int) -> None:
        """Some iterations of conjugate gradients; what they release is booked."""
        state, program, case = self.state, self.state.program, self.case
        if self.finite:
            self.tangent.linearise(state.u, self.forces.bounds.bond)
        goal = SAFETY * (program["goal"] or arrest.LOOSE) * self.reference
        try:
            first, last = cg.improve(
                self.tangent, self.residual, case.fixed, goal, max(sweeps, 1), self.solve.preconditioner, self.step
            )
        except (Breakdown, NotFinite) as error:
            self._count()
            if not case.load:
                raise NotConverged(f"{error} {self._last_breaks()}") from error
            if not self._let_go():
                program["apart"] = 1.0
            return
        self._count()
        fraction, runs_away = 1.0, False
        if case.load:
            reach, size = SEPARATED * program["size"], self._size(self.step)
            if size <= reach:
                program["adrift"] = 0.0
            elif self._let_go():
                return
            elif not size < math.inf:
                program["apart"] = 1.0
                return
            else:  # it still hangs on something, which that distance may break
                fraction, runs_away = reach / size, True
        wanted, fraction = fraction, self._bearable(fraction) if self.finite else fraction
        program["cuts"] = program["cuts"] + 1.0 if fraction < wanted else 0.0
        if program["cuts"]:
            program["fresh"] = 1.0  # no sign of stagnation
            self._refuse_small_steps()
        elif runs_away:
            program["adrift"] += 1.0
        if fraction < 1.0:
            np.multiply(self.step, fraction, out=self.step)
        if case.load:
            (work,) = exact_dots(self.model.comm, [(self._external(), self.step)])
            program["work"] += float(work)
        np.add(state.u, self.step, out=state.u)
        program["released"] += fraction * first - 0.5 * fraction * fraction * (first - last)

    def _bearable(self, fraction: float) -> float:
        """Finite kinematics: the fraction of a large step, at most ``fraction``, that bonds can bear. Collective.

        What hangs on by little turns far, and a straight step far along a rotation stretches all its bonds.
        """
        state, failure = self.state, self.failure
        if self._size(self.step) * fraction <= state.program["size"]:
            return fraction
        limit = max(MOST_STRETCH, self.forces.largest_ratio(failure))
        force, external = np.empty_like(state.u), self._external()
        for _ in range(MOST_HALVINGS):
            self.forces.evaluate_surely(state.u + fraction * self.step, external, force)
            if self.forces.largest_ratio(failure) <= limit:
                break
            fraction *= 0.5
        self._count()
        return fraction

    def _refuse_small_steps(self) -> None:
        if self.state.program["cuts"] > MOST_CUTS:
            raise NotConverged(
                f"after {self.failure.count:,} broken bonds some part turns or moves so far that {MOST_CUTS} steps in "
                f"a row had to be cut, and breaks nothing. {self._last_breaks()}"
            )

    def _let_go(self) -> bool:
        """Something runs away under a held force: loose parts lose their loads; whether there are any."""
        self.state.program["fragments"] = self.state.program["fresh"] = 1.0
        return self._take_loads_off()

    def _take_loads_off(self) -> bool:
        """Parts that hang together with nothing that could balance their loads carry none; whether loads changed."""
        before, told = self.case.external, self.loose
        self._find_loads()
        changed = np.count_nonzero(self.case.external != before)
        if not sum_integers(self.model.comm, np.array([changed]))[0]:
            return False
        self.state.program["adrift"] = 0.0
        new = sorted(self.loose - told)
        for text in new[:NAMED]:
            self.solve.note(f"after {self.failure.count:,} broken bonds loads are off what came loose: {text}")
        if len(new) > NAMED:
            self.solve.note(f"and off {len(new) - NAMED:,} parts more")
        return True

    def _find_loads(self) -> None:
        """The loads that are left: a function of the bonds that are, so that a run taken up again finds the same."""
        self.case, parts = without_loads_on_loose_parts(self.model, self.whole)
        self.reporter.case, self.loose = self.case, frozenset(part.text for part in parts)

    def _settle(self) -> None:
        """Relax until the state is in equilibrium; the table of the forces is left at it."""
        program, tolerance = self.state.program, self.settings.arrest_tolerance
        looks = self.settings.control == "energy" and not self.finite  # else looked at before, or bracketed afterwards
        while not program["apart"] and not program["adrift"]:
            if self._is_settled() if looks else program["relative"] <= tolerance:
                return
            if not looks:
                program["goal"] = self._next_goal()
            stalled, program["fresh"] = program["relative"], 0.0
            self._relax(MOST_SWEEPS)
            self._evaluate()
            if not program["apart"] and not program["fresh"]:
                self._refuse_stagnation(stalled)

    def _is_settled(self) -> bool:
        """Whether what the residual leaves open does not matter at the state of the last evaluation. Collective."""
        failure, below = self.failure, 1.0 - self.settings.eta
        ratio = self.forces.largest_ratio(failure)

        def decides(change: float) -> bool:
            if self.settings.control == "load":  # at this load: does a bond break?
                return ratio + change > below
            # at the load that makes the largest critical: which bonds break with it?
            return self.forces.largest_ratio(failure, below * ratio + change) > below * ratio - change

        return arrest.is_settled(
            self.state.program, ratio, self.settings.arrest_tolerance, self._first_look, decides
        )

    def _next_goal(self) -> float:
        return arrest.next_goal(self.state.program["relative"], self.settings.arrest_tolerance, self._first_look)

    @property
    def _first_look(self) -> float:
        return arrest.LOOSE if self.settings.control == "load" else arrest.FIRST_LOOK

    def _refuse_stagnation(self, before: float) -> None:
        """Give up where relaxation to the end did not halve a residual that is too large."""
        relative, goal = self.state.program["relative"], self.settings.arrest_tolerance
        if relative > goal and relative > STAGNATION * before:
            if self.case.load and self._take_loads_off():
                self.state.program["fragments"] = 1.0
                self._evaluate()
                return
            place = describe_motion(self.model, self.step)
            if self.finite and self._find_rest():
                return
            raise NotConverged(
                f"after {self.failure.count:,} broken bonds the relative residual stagnates at {relative:.3g}, above "
                f"stepping.arrest_tolerance = {goal:.3g}: some part may have come loose under a load. Still moving: "
                f"{place}. {self._last_breaks()}"
            )

    def _find_rest(self) -> bool:
        """Finite kinematics: equilibrium at the held load by Newton's method or, where that breaks down, relaxation.

        A part that hangs on by little swings far before it rests, and straight steps along one tangent do not take it
        there. What the loads work beyond the energy that is stored then was taken out on the way. Whether it was found.
        """
        state, program, case = self.state, self.state.program, self.case
        stored, before, external = self._stored(), state.u.copy(), self._external()
        try:
            self._come_to_rest(SAFETY * self.settings.arrest_tolerance)
        except (NotConverged, NotFinite):
            state.u[:] = before
            self._evaluate()
            return False
        self._evaluate()
        (work,) = exact_dots(self.model.comm, [(external, state.u - before)])
        work = float(work) if case.load else 0.0
        program["work"] += work
        program["released"] += work - (self._stored() - stored)
        return True

    def _scale(self, load_factor: float) -> None:
        """Linear kinematics: the state at another load."""
        state, program = self.state, self.state.program
        factor = load_factor / state.load_factor
        stored = program["work"] - program["released"] - self.failure.dissipated
        program["work"] += (factor * factor - 1.0) * stored
        state.load_factor = load_factor
        program["reaction"] *= factor
        np.multiply(state.u, factor, out=state.u)
        self._prescribe()

    def _bracket(self, ratio: float, limit: float) -> None:
        """Finite kinematics: the load at which the largest stretch is critical, by secants within a bracket."""
        state, program = self.state, self.state.program
        stored = self._stored()
        known: list[tuple[float, float]] = []  # loads and ratios of equilibria; the state to begin with is loose
        low, high = 0.0, math.inf
        target = state.load_factor / ratio
        for _ in range(MOST_EQUILIBRIA):
            target = min(target, limit)
            np.multiply(state.u, target / state.load_factor, out=state.u)
            state.load_factor = target
            self._prescribe()
            self._equilibrate(self.solve.settings.tolerance)
            ratio = self.forces.largest_ratio(self.failure)
            if abs(ratio - 1.0) <= BRACKET or (target == limit and ratio < 1.0):
                break
            low, high = (target, high) if ratio < 1.0 else (low, target)
            known = [*known[-1:], (target, ratio)]
            (before, at) = known[0]
            slope = (ratio - at) / (target - before) if target != before else 0.0
            target += (1.0 - ratio) / slope if slope > 0.0 else target * (1.0 / ratio - 1.0)
            if not low < target < high:
                target = 0.5 * (low + high) if high < math.inf else 2.0 * low
        else:
            raise NotConverged(f"no load was found at which the next bond breaks, between {low:.6g} and {high:.6g}.")
        program["work"] += self._stored() - stored

    def _equilibrate(self, tolerance: float) -> None:
        """Equilibrium at the state's load; the table of the forces is left at it."""
        self._prescribe()
        self._come_to_rest(tolerance)
        self._evaluate()

    def _come_to_rest(self, tolerance: float) -> None:
        """Equilibrium at the state's load by conjugate gradients; in finite kinematics, where these break down, by
        relaxation.
        """
        solve, state = self.solve, self.state
        common = (self.forces, state, self._external(), self.case.fixed, tolerance, solve.settings.max_evaluations)
        try:
            cg.solve(*common, solve.preconditioner, self.watch)
        except Breakdown:
            if not self.finite:
                raise
            state.iteration = state.spent = 0
            state.v[:] = 0.0
            adr.solve(*common, self.watch)

    def _small_load(self) -> float:
        """A load factor at which strains are small, whatever the deck's loads are."""
        case, x = self.case, by_component(self.model.points.x)
        ends = np.stack([x.max(axis=(0, 2), initial=-np.inf), -x.min(axis=(0, 2), initial=np.inf)])
        size = float(largest(self.model.comm, ends).sum(axis=0).max())
        return SMALL_STRAIN / max(case.reach / size, case.load)

    def _prescribe(self) -> None:
        fixed = self.case.fixed
        self.state.u[fixed] = self.state.load_factor * self.case.prescribed[fixed]

    def _stored(self) -> float:
        """Strain energy at the last evaluation."""
        return self.forces.stored_energy(self.state.u)

    def _size(self, vector: np.ndarray) -> float:
        return float(largest(self.model.comm, np.array([np.abs(vector).max(initial=0.0)]))[0])

    def _evaluations(self) -> int:
        return self.forces.evaluations + (self.tangent.evaluations if self.finite else 0)

    def _count(self) -> None:
        self.state.program["sweeps"] += self._evaluations() - self.counted
        self.counted = self._evaluations()

    def _last_breaks(self) -> str:
        """Where the bonds that broke last lie, in the deck's units. Collective."""
        failure, units = self.failure, self.model.units
        low, high = failure.last_extent * units.length + units.origin
        sides = (f"[{a:.6g}, {b:.6g}]" for a, b in zip(low, high, strict=True))
        return f"The last bonds broke in {' x '.join(sides)}."
