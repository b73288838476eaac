"""From break to break along a way of the load: up, down, to the other side and up again, in linear kinematics.

Between breaks displacements are in proportion to the load, so broken bonds retrace the secant to nothing, and along a
straight part of the way the largest stretch is at its end. Where it is beyond critical there, a bond breaks on the way.
"""

from __future__ import annotations

from collections.abc import Iterator

from pdfem_mpi.model.loads import remove_rigid_motion
from pdfem_mpi.parallel.sums import exact_dots
from pdfem_mpi.stepping import arrest
from pdfem_mpi.stepping.avalanche import Avalanche
from pdfem_mpi.stepping.equilibria import equilibrate, scale
from pdfem_mpi.stepping.ledger import Ledger, remember_peak
from pdfem_mpi.stepping.report import Report


def follow_legs(avalanche: Avalanche) -> Iterator[Report]:
    """Follow the way to where a bond is about to break, or to its end; yield a row at each turning point. Collective.

    ``state.program["leg"]`` counts the parts that are done: all of them at the end, or where the body came apart.
    """
    ledger = avalanche.ledger
    state, program, legs = ledger.state, ledger.state.program, ledger.settings.legs
    while program["leg"] < len(legs):
        number = int(program["leg"])
        time, target, shown = legs[number]
        if state.load_factor:
            ledger.evaluate()
            avalanche.relax_to_rest()
        if program["apart"] or program["fragments"] or program["adrift"]:
            program["leg"] = float(len(legs))
            return
        _go_to(ledger, target)
        ratio = ledger.forces.largest_ratio(ledger.failure) if target else 0.0
        breaks = ratio > 1.0
        if breaks:
            scale(ledger, target / ratio)
            ledger.evaluate()
        elif target:
            _come_to_rest(ledger)
        program["time"] = _time_at(legs, number, state.load_factor) if breaks else time
        arrest.forget(program)
        remove_rigid_motion(ledger.model, ledger.case, state.u)
        program["size"] = max(program["size"], ledger.size(state.u))
        remember_peak(ledger, breaks)
        if breaks:
            return
        program["leg"] += 1.0
        if shown and program["leg"] < len(legs):
            yield ledger.row("turn")


def _go_to(ledger: Ledger, target: float) -> None:
    """The equilibrium at another load; the table of the forces is left at it."""
    state, program = ledger.state, ledger.state.program
    if state.load_factor:
        scale(ledger, target)
        ledger.evaluate()
        return
    state.load_factor = target
    if target:
        equilibrate(ledger, ledger.solve.settings.tolerance)
        program["work"] += ledger.stored()


def _come_to_rest(ledger: Ledger) -> None:
    """Lower what an arrest left of the residual to the solver's tolerance; what that takes out is booked."""
    state, program, case = ledger.state, ledger.state.program, ledger.case
    stored, before = ledger.stored(), state.u.copy()
    equilibrate(ledger, ledger.solve.settings.tolerance)
    (work,) = exact_dots(ledger.model.comm, [(ledger.external(), state.u - before)])
    work = float(work) if case.load else 0.0
    program["work"] += work
    program["released"] += work - (ledger.stored() - stored)


def _time_at(legs: list[tuple[float, float, bool]], number: int, load_factor: float) -> float:
    """When the load has this value on a part of the way."""
    before, begin, _ = legs[number - 1] if number else (0.0, 0.0, True)
    after, end, _ = legs[number]
    return before + (after - before) * (load_factor - begin) / (end - begin)
