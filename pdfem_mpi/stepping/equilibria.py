"""Equilibria of a program of events: at a load, at the load of the next break, and of parts that swing far."""

from __future__ import annotations

import math

import numpy as np

from pdfem_mpi.model.not_finite import NotFinite
from pdfem_mpi.parallel.comm import largest
from pdfem_mpi.parallel.sums import exact_dots
from pdfem_mpi.peridynamics.clusters import by_component
from pdfem_mpi.solvers import adr, cg
from pdfem_mpi.solvers.convergence import Breakdown, NotConverged
from pdfem_mpi.stepping.ledger import Ledger

#: A solve aims at this fraction of its tolerance.
SAFETY = 0.9
#: Finite kinematics: the first equilibrium is sought at a strain of about this size.
SMALL_STRAIN = 1e-6
#: Finite kinematics: the largest stretch is brought this near to critical, in at most so many equilibria.
BRACKET, MOST_EQUILIBRIA = 1e-6, 30
#: The same for linear kinematics beside constant loads, and the largest relative residual of these equilibria.
LINEAR_BRACKET, LINEAR_TOLERANCE = 1e-9, 1e-8


def find_rest(ledger: Ledger) -> bool:
    """Finite kinematics: equilibrium at the constant load by Newton's method or, where that breaks down, relaxation.

    A part that hangs on by little swings far before it rests, and straight steps along one tangent do not take it
    there. What the loads work beyond the energy that is stored then was taken out on the way. Whether it was found.
    """
    state, program, case = ledger.state, ledger.state.program, ledger.case
    stored, before, external = ledger.stored(), state.u.copy(), ledger.external()
    try:
        come_to_rest(ledger, SAFETY * ledger.settings.arrest_tolerance)
    except (NotConverged, NotFinite):
        state.u[:] = before
        ledger.evaluate()
        return False
    ledger.evaluate()
    (work,) = exact_dots(ledger.model.comm, [(external, state.u - before)])
    work = float(work) if case.load else 0.0
    program["work"] += work
    program["released"] += work - (ledger.stored() - stored)
    return True


def scale(ledger: Ledger, load_factor: float) -> None:
    """Linear kinematics: the state at another load."""
    state, program = ledger.state, ledger.state.program
    factor = load_factor / state.load_factor
    stored = program["work"] - program["released"] - ledger.failure.dissipated - program.get("switched", 0.0)
    program["work"] += (factor * factor - 1.0) * stored
    state.load_factor = load_factor
    program["reaction"] *= factor
    np.multiply(state.u, factor, out=state.u)
    ledger.prescribe()


def bracket(ledger: Ledger, ratio: float, limit: float) -> None:
    """The load at which the excess is 1 (the largest stretch critical), by secants within a bracket.

    For finite kinematics, and where constant loads stand beside those that grow.
    """
    state, program = ledger.state, ledger.state.program
    stored, solver = ledger.stored(), ledger.solve.settings.tolerance
    known: list[tuple[float, float]] = []  # loads and ratios of equilibria; the state to begin with is loose
    low, high = 0.0, math.inf
    target = state.load_factor / ratio
    near, tolerance = BRACKET, solver
    if not ledger.finite:  # as near as the residual lets it be seen
        tolerance = min(solver, LINEAR_TOLERANCE)
        near = max(LINEAR_BRACKET, tolerance)
    for _ in range(MOST_EQUILIBRIA):
        target = min(target, limit)
        np.multiply(state.u, target / state.load_factor, out=state.u)
        state.load_factor = target
        ledger.prescribe()
        equilibrate(ledger, tolerance)
        ratio = ledger.excess()
        if abs(ratio - 1.0) <= near or (target == limit and ratio < 1.0):
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
    program["work"] += ledger.stored() - stored


def equilibrate(ledger: Ledger, tolerance: float) -> None:
    """Equilibrium at the state's load; the table of the forces is left at it."""
    ledger.prescribe()
    come_to_rest(ledger, tolerance)
    ledger.evaluate()


def come_to_rest(ledger: Ledger, tolerance: float) -> None:
    """Equilibrium at the state's load by conjugate gradients; in finite kinematics, where these break down, by
    relaxation.
    """
    solve, state = ledger.solve, ledger.state
    common = (ledger.forces, state, ledger.external(), ledger.case.fixed, tolerance, solve.settings.max_evaluations)
    try:
        cg.solve(*common, solve.preconditioner, ledger.watch)
    except Breakdown:
        if not ledger.finite:
            raise
        state.iteration = state.spent = 0
        state.v[:] = 0.0
        adr.solve(*common, ledger.watch)


def small_load(ledger: Ledger) -> float:
    """A load factor at which strains are small, whatever the deck's loads are."""
    case, x = ledger.case, by_component(ledger.model.points.x)
    ends = np.stack([x.max(axis=(0, 2), initial=-np.inf), -x.min(axis=(0, 2), initial=np.inf)])
    size = float(largest(ledger.model.comm, ends).sum(axis=0).max())
    return SMALL_STRAIN / max(case.reach / size, case.load)
