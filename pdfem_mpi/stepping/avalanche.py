"""An avalanche at one load: bonds break in batches, and conjugate gradients relax the rest between them.

Under a force that stays, pieces that came off would move away for ever: steps are cut, and loads are taken off what
hangs together with nothing that could balance them.
"""

from __future__ import annotations

import math

import numpy as np

from pdfem_mpi.model.mechanisms import describe_motion
from pdfem_mpi.model.not_finite import NotFinite
from pdfem_mpi.parallel.sums import exact_dots
from pdfem_mpi.solvers import cg
from pdfem_mpi.solvers.convergence import Breakdown, NotConverged, Progress
from pdfem_mpi.stepping import arrest
from pdfem_mpi.stepping.equilibria import SAFETY, find_rest
from pdfem_mpi.stepping.ledger import Ledger, last_breaks

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
#: Where bonds soften, a relaxation between two batches ends once the residual has fallen to this part: an avalanche has
#: many batches, each of which lets go of little.
FALLEN = 0.3


class Avalanche:
    """What breaks bonds and relaxes the rest, on the books of a ledger; all methods are collective.

    Attributes
    ----------
    ledger : Ledger
    step : float64, shape (n_unknowns,), dimension length
        What the last relaxation moved the state by.
    overdue : bool
        Under opening control: at the largest opening so far more is critical than the next bond.
    """

    def __init__(self, ledger: Ledger):
        self.ledger, self.step = ledger, np.zeros_like(ledger.state.u)
        self.overdue = False

    def batch(self) -> int:
        """Break what is (nearly) critical and relax the rest for a while; the number of bonds that broke."""
        ledger = self.ledger
        program, settings = ledger.state.program, ledger.settings
        stalled = program["relative"]
        broke = ledger.evaluate(breaking=True)
        program["batches"] += broke > 0
        ledger.watch(Progress(int(program["batches"]), program["relative"], 0.0, (self,)))
        by_load = settings.control == "load"
        if not broke:
            enough = program["relative"] <= settings.arrest_tolerance
            if _is_settled(ledger, at_this_load=True) if by_load else enough:
                program["stable"] = 1.0
                return 0
            if not program["fresh"]:
                _refuse_stagnation(ledger, self.step, stalled)
        program["fresh"] = float(broke > 0)
        if broke:
            program["adrift"] = program["cuts"] = 0.0
        elif program["adrift"] >= MOST_ADRIFT:
            program["apart"] = 1.0
            return 0
        if broke and program["fragments"] and ledger.take_loads_off():
            ledger.evaluate()
        loosely = broke and by_load
        if broke:
            arrest.forget(program)
        if not (program["goal"] or loosely):
            program["goal"] = _next_goal(ledger)
        fallen = FALLEN if loosely and ledger.failure.in_teeth else 0.0
        self._relax(settings.inner_iterations - 1 if loosely else MOST_SWEEPS, fallen)
        return broke

    def settle(self) -> None:
        """Relax without breaking, after elements were turned: nothing may break on what was only interpolated.

        A stable state comes to rest again: no arrest has looked at it on the new region, and the load of the next break
        is read from it.
        """
        ledger = self.ledger
        ledger.evaluate()
        self._relax(ledger.settings.inner_iterations)
        ledger.evaluate()
        if ledger.state.program["stable"]:
            self.relax_to_rest(anew=True)

    def came_apart(self) -> bool:
        """Whether the body does not carry the load any more."""
        ledger = self.ledger
        apart = bool(ledger.state.program["apart"])
        return apart or (ledger.settings.control == "load" and ledger.carries_little())

    def _relax(self, sweeps: int, fallen: float = 0.0) -> None:
        """Some iterations of conjugate gradients, until the residual has fallen to that part of what it is at most;
        what they release is booked.
        """
        ledger = self.ledger
        state, program, case = ledger.state, ledger.state.program, ledger.case
        if ledger.finite:
            ledger.tangent.linearise(state.u, ledger.forces.bounds.bond)
        goal = max(SAFETY * (program["goal"] or arrest.LOOSE), fallen * program["relative"]) * ledger.reference
        try:
            tangent, preconditioner = ledger.tangent, ledger.solve.preconditioner
            first, last = cg.improve(
                tangent, ledger.residual, case.fixed, goal, max(sweeps, 1), preconditioner, self.step
            )
        except (Breakdown, NotFinite) as error:
            ledger.count()
            if not case.load:
                raise NotConverged(f"{error} {last_breaks(ledger)}") from error
            if not self._let_go():
                program["apart"] = 1.0
            return
        ledger.count()
        fraction, runs_away = 1.0, False
        if case.load:
            reach, size = SEPARATED * ledger.stable_size, ledger.size(self.step)
            if size <= reach:
                program["adrift"] = 0.0
            elif self._let_go():
                return
            elif not size < math.inf:
                program["apart"] = 1.0
                return
            else:  # it still hangs on something, which that distance may break
                fraction, runs_away = reach / size, True
        wanted, fraction = fraction, _bearable(ledger, self.step, fraction) if ledger.finite else fraction
        program["cuts"] = program["cuts"] + 1.0 if fraction < wanted else 0.0
        if program["cuts"]:
            program["fresh"] = 1.0  # no sign of stagnation
            _refuse_small_steps(ledger)
        elif runs_away:
            program["adrift"] += 1.0
        if fraction < 1.0:
            np.multiply(self.step, fraction, out=self.step)
        if case.load:
            (work,) = exact_dots(ledger.model.comm, [(ledger.external(), self.step)])
            program["work"] += float(work)
        np.add(state.u, self.step, out=state.u)
        program["released"] += fraction * first - 0.5 * fraction * fraction * (first - last)

    def _let_go(self) -> bool:
        """Something runs away under a constant force: unsupported parts lose their loads; whether there are any."""
        ledger = self.ledger
        ledger.state.program["fragments"] = ledger.state.program["fresh"] = 1.0
        return ledger.take_loads_off()

    def relax_to_rest(self, anew: bool = False) -> None:
        """Relax until the state is in equilibrium; the table of the forces is left at it.

        Parameters
        ----------
        anew : bool
            No arrest has looked at the state; under load control one has otherwise.
        """
        ledger = self.ledger
        program, tolerance = ledger.state.program, ledger.settings.arrest_tolerance
        # in finite kinematics and beside constant loads it is bracketed afterwards
        looks = (anew or ledger.settings.control != "load") and not ledger.finite and ledger.case.constant is None
        while not program["apart"] and not program["adrift"]:
            if _is_settled(ledger, at_this_load=False) if looks else program["relative"] <= tolerance:
                return
            if not looks:
                program["goal"] = _next_goal(ledger)
            stalled, program["fresh"] = program["relative"], 0.0
            self._relax(MOST_SWEEPS)
            ledger.evaluate()
            if not program["apart"] and not program["fresh"]:
                _refuse_stagnation(ledger, self.step, stalled)


def _refuse_stagnation(ledger: Ledger, step: np.ndarray, before: float) -> None:
    """Give up where relaxation to the end did not halve a residual that is too large."""
    relative, goal = ledger.state.program["relative"], ledger.settings.arrest_tolerance
    if relative > goal and relative > STAGNATION * before:
        if ledger.case.load and ledger.take_loads_off():
            ledger.state.program["fragments"] = 1.0
            ledger.evaluate()
            return
        place = describe_motion(ledger.model, step)
        if ledger.finite and find_rest(ledger):
            return
        raise NotConverged(
            f"after {ledger.failure.count:,} broken bonds the relative residual stagnates at {relative:.3g}, above "
            f"stepping.arrest_tolerance = {goal:.3g}: some part may have come loose under a load. Still moving: "
            f"{place}. {last_breaks(ledger)}"
        )


def _refuse_small_steps(ledger: Ledger) -> None:
    if ledger.state.program["cuts"] > MOST_CUTS:
        raise NotConverged(
            f"after {ledger.failure.count:,} broken bonds some part turns or moves so far that {MOST_CUTS} steps "
            f"in a row had to be cut, and breaks nothing. {last_breaks(ledger)}"
        )


def _bearable(ledger: Ledger, step: np.ndarray, fraction: float) -> float:
    """Finite kinematics: the fraction of a large step, at most ``fraction``, that bonds can bear. Collective.

    What hangs on by little turns far, and a straight step far along a rotation stretches all its bonds.
    """
    state, failure = ledger.state, ledger.failure
    if ledger.size(step) * fraction <= ledger.stable_size:
        return fraction
    limit = max(MOST_STRETCH, ledger.forces.largest_ratio(failure))
    force, external = np.empty_like(state.u), ledger.external()
    for _ in range(MOST_HALVINGS):
        ledger.forces.evaluate_surely(state.u + fraction * step, external, force)
        if ledger.forces.largest_ratio(failure) <= limit:
            break
        fraction *= 0.5
    ledger.count()
    return fraction


def _is_settled(ledger: Ledger, at_this_load: bool) -> bool:
    """Whether what the residual leaves open does not matter at the state of the last evaluation. Collective.

    Parameters
    ----------
    at_this_load : bool
        The state is asked whether a bond breaks; else, which bonds break at the load that makes the largest critical.
    """
    failure, below = ledger.failure, 1.0 - ledger.settings.eta
    ratio = ledger.excess()

    def decides(change: float) -> bool:
        if at_this_load:
            return ratio + change > below
        return ledger.forces.largest_ratio(failure, below * ratio + change) > below * ratio - change

    return arrest.is_settled(
        ledger.state.program, ratio, ledger.settings.arrest_tolerance, _first_look(ledger), decides
    )


def _next_goal(ledger: Ledger) -> float:
    return arrest.next_goal(ledger.state.program["relative"], ledger.settings.arrest_tolerance, _first_look(ledger))


def _first_look(ledger: Ledger) -> float:
    return arrest.LOOSE if ledger.settings.control == "load" else arrest.FIRST_LOOK
