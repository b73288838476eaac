"""From break to break: exact loads of first breaks, avalanches at constant load, and a closed ledger of energies.

Between breaks a linear body answers in proportion to the load, so one equilibrium gives the load at which the next
bond breaks. At that load all bonds within ``eta`` of their critical stretch break together, a few iterations of
conjugate gradients relax the rest, and so on until none is left to break: loosely while the avalanche runs, tightly
before a state counts as stable (`arrest`). In finite kinematics the load of the next break is found by bracketing.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

from pdfem_mpi.deck.programs import Events
from pdfem_mpi.model.loads import LoadCase, remove_rigid_motion
from pdfem_mpi.model.state import State
from pdfem_mpi.peridynamics.failure import Failure
from pdfem_mpi.solvers.convergence import NotConverged
from pdfem_mpi.solvers.equilibrium import EquilibriumSolver
from pdfem_mpi.stepping import arrest
from pdfem_mpi.stepping.avalanche import Avalanche
from pdfem_mpi.stepping.equilibria import BRACKET, bracket, equilibrate, scale, small_load
from pdfem_mpi.stepping.ledger import NUMBERS, Ledger, remember_peak
from pdfem_mpi.stepping.legs import follow_legs
from pdfem_mpi.stepping.report import Report

#: The first equilibrium is at least this tight: the load of the first break is read from it.
FIRST_TOLERANCE = 1e-8


def follow_events(
    settings: Events,
    solve: EquilibriumSolver,
    failure: Failure,
    state: State,
    case: LoadCase,
    watch: Callable,
) -> Iterator[Report]:
    """Yield a row at each critical state, arrest, switch and end, and every ``report_every`` batches. Collective.

    Where bonds soften, an arrest after fewer batches has no row: the next critical state is the same at another load.

    Raises
    ------
    NotConverged, NotFinite
        The state is left at the last batch.
    Stopped
        From ``solve.stop_requests``, between batches.
    """
    solve.stop_requests.between(state)
    ledger = Ledger(settings, solve, failure, state, case, watch)
    avalanche = Avalanche(ledger)
    if "stable" not in state.program:
        _start(ledger)
    program = state.program
    if program.get("interpolated"):
        avalanche.settle()
        program["interpolated"] = 0.0
        yield ledger.row("switch")
    if program["evaluated"]:
        _evaluate_again(ledger)
    while True:
        if program["stable"]:
            if settings.times is not None:
                yield from follow_legs(avalanche)
                goes_on = program["leg"] < len(settings.legs)
            else:
                goes_on = _load_to_break(avalanche)
            program["stable"], program["began"], program["evaluated"] = 0.0, program["batches"], 0.0
            if not goes_on:
                yield ledger.row("end")
                return
            every = program["batches"] % settings.report_every == 0
            if avalanche.overdue:
                if every:
                    yield ledger.row("batch")
            elif (every or settings.control != "energy") and not program["adrift"]:
                yield ledger.row("critical")
        broke = avalanche.batch()
        if avalanche.came_apart():
            yield ledger.row("end")
            return
        if settings.control != "load":
            program["stable"] = float(not program["adrift"])
        elif program["stable"]:
            if _tells_arrest(ledger):
                yield ledger.row("arrest")
        elif broke and program["batches"] % settings.report_every == 0:
            yield ledger.row("batch")
        ledger.pause()


def _tells_arrest(ledger: Ledger) -> bool:
    """Whether the arrest has a row; without one the last evaluation remains that of the state."""
    program, failure = ledger.state.program, ledger.failure
    few = program["batches"] - program["began"] < ledger.settings.report_every
    program["evaluated"] = float(few and failure.in_teeth)
    return not program["evaluated"]


def _evaluate_again(ledger: Ledger) -> None:
    """Evaluate the state of a run that was stopped after this evaluation had been counted."""
    program, forces = ledger.state.program, ledger.forces
    sweeps, before = program["sweeps"], forces.evaluations
    ledger.evaluate()
    ledger.counted -= forces.evaluations - before
    program["sweeps"], forces.evaluations = sweeps, before


def _start(ledger: Ledger) -> None:
    """Find the first equilibrium: at load factor 1 or, for finite kinematics, at a small load."""
    state = ledger.state
    state.program |= dict.fromkeys(NUMBERS, 0.0) | {"stable": 1.0, "fresh": 1.0}
    state.load_factor = 1.0
    if ledger.case.constant is not None:
        _check_constant_loads(ledger)
    if ledger.finite:
        state.load_factor = small_load(ledger)
    equilibrate(ledger, min(FIRST_TOLERANCE, ledger.solve.settings.tolerance))
    state.program["work"] = ledger.stored()


def _check_constant_loads(ledger: Ledger) -> None:
    """The constant loads alone must break nothing: the program begins beside them.

    Raises
    ------
    NotConverged
    """
    state = ledger.state
    factor, state.load_factor = state.load_factor, 0.0
    equilibrate(ledger, ledger.solve.settings.tolerance)
    ratio = ledger.forces.largest_ratio(ledger.failure)
    state.load_factor = factor
    if ratio >= 1.0:
        raise NotConverged(
            f"the loads with constant = true alone stretch a bond to {ratio:.6g} times its critical stretch, before "
            "anything grows. Lower them, or let them grow."
        )


def _excess(ledger: Ledger) -> float:
    """What the load is divided by, see `Ledger.excess`.

    Raises
    ------
    NotConverged
        The controlled opening closes while the load grows.
    """
    settings, length = ledger.settings, ledger.model.units.length
    if settings.control == "opening" and not (opening := ledger.opening()) > 0.0:
        raise NotConverged(
            f'the opening of the probe "{settings.opening}" is {opening * length:.6g} at load factor '
            f"{ledger.state.load_factor:.6g}: the load closes it. Reverse its direction, or measure elsewhere."
        )
    return ledger.excess()


def _describe_nothing_to_break(broken: int) -> str:
    """A sentence about a load that would never break another bond."""
    if not broken:
        return "the load stretches no bond that may break. Load the body otherwise."
    return (
        "the load stretches no bond that may break any more, and others hold the body together: bonds to cells with "
        "may_fail = false and between two points of the overlap never break. Make the region that shall part wider "
        "than twice the cutoff radius, or load the body otherwise."
    )


def _load_to_break(avalanche: Avalanche) -> bool:
    """Raise (or lower) the load until a bond is about to break; False if the program ends at or before that."""
    ledger = avalanche.ledger
    state, program, settings = ledger.state, ledger.state.program, ledger.settings
    if not program["evaluated"]:
        ledger.evaluate()
    avalanche.relax_to_rest()
    if program["apart"] or (program["fragments"] and ledger.carries_little()):
        return False
    if program["adrift"]:
        return True
    ratio = ledger.forces.largest_ratio(ledger.failure)
    if ratio == 0.0:
        if ledger.carries_little():  # apart since the relaxation: nothing is left to stretch
            return False
        raise NotConverged(_describe_nothing_to_break(ledger.failure.count))
    limit = math.inf if settings.end_load_factor is None else settings.end_load_factor
    excess = _excess(ledger)
    if ledger.finite or ledger.case.constant is not None:
        bracket(ledger, excess, limit)
    else:
        scale(ledger, min(state.load_factor / excess, limit))
    arrest.forget(program)
    remove_rigid_motion(ledger.model, ledger.case, state.u)
    program["size"] = ledger.size(state.u)  # first: a region that does not hold ends this state
    ledger.solve.look_at_region(state)
    ends = state.load_factor >= limit
    if settings.control == "opening":
        opening = ledger.opening()
        avalanche.overdue = opening <= program["opening"] * (1.0 + BRACKET)
        program["opening"] = max(program["opening"], opening)
        last = settings.end_opening
        ends = ends or bool(last and opening * ledger.model.units.length >= last * (1.0 - BRACKET))
        if avalanche.overdue:  # on the way between two stable states, whatever it carries
            return not ends
    if ledger.carries_little():
        return False
    remember_peak(ledger, breaks=not ends)
    return not ends
