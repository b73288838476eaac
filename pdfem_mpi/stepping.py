"""The load program: equilibrium at each load factor, and what each equilibrium balances."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from time import perf_counter

import numpy as np

from pdfem_mpi.discretization import Discretization
from pdfem_mpi.forces import Forces
from pdfem_mpi.loading import LoadCase, exact_dots, remove_rigid_motion, rigid_modes
from pdfem_mpi.scene import Scene
from pdfem_mpi.solvers import adr, cg
from pdfem_mpi.solvers.convergence import Breakdown, Convergence, Progress
from pdfem_mpi.solvers.multilevel import make_preconditioner
from pdfem_mpi.state import State


@dataclass(frozen=True)
class Equilibrium:
    """One equilibrium of the load program.

    Attributes
    ----------
    step : int
        From 1.
    load_factor : float
    convergence : Convergence
    reaction : float64, shape (3,), dimension force
        Sum of the forces of the supports, model units.
    force_balance, moment_balance : float, dimension 1
        Net internal force and moment, relative to the sums of their magnitudes.
    seconds : float
    """

    step: int
    load_factor: float
    convergence: Convergence
    reaction: np.ndarray
    force_balance: float
    moment_balance: float
    seconds: float


def make_solver(
    scene: Scene, discretization: Discretization, forces: Forces, case: LoadCase, note: Callable[[str], None]
) -> Callable:
    """The scene's solver as ``solve(state, external, watch) -> Convergence``. Collective.

    Where conjugate gradients break down, relaxation goes on from there, and ``note`` is told.
    """
    settings = scene.solver
    common = (case.fixed, settings.tolerance, settings.max_evaluations)

    def relax(state, external, watch):
        state.iteration = 0
        state.fields["v"][:] = 0.0
        return adr.solve(forces, state, external, *common, watch)

    if settings.kind == "adr":
        return relax
    preconditioner = make_preconditioner(discretization, forces.model, case)

    def solve(state, external, watch):
        try:
            return cg.solve(forces, state, external, *common, preconditioner, watch)
        except Breakdown as error:
            note(f"conjugate gradients broke down: {error} Going on with adaptive dynamic relaxation.")
            return relax(state, external, watch)

    return solve


def follow_load_program(
    scene: Scene,
    solve: Callable,
    forces: Forces,
    state: State,
    case: LoadCase,
    watch: Callable[[int, Progress], None],
):
    """Yield the equilibrium at each load factor. Collective.

    Raises
    ------
    NotConverged, NotFinite
        From the solver.
    """
    for step, factor in enumerate(scene.stepping.load_factors[state.step :], start=state.step + 1):
        start = perf_counter()
        external = factor * case.external
        state.u[case.fixed] = factor * case.prescribed[case.fixed]
        convergence = solve(state, external, partial(watch, step))
        remove_rigid_motion(forces.model, case, state.u)
        state.step, state.load_factor = step, factor
        reaction, force_balance, moment_balance = _balance(forces, state, case)
        yield Equilibrium(
            step, factor, convergence, reaction, force_balance, moment_balance, perf_counter() - start
        )


def _balance(forces: Forces, state: State, case: LoadCase):
    """Reactions, and how well internal forces sum to nothing: exact sums of one more evaluation."""
    model = forces.model
    internal = np.empty_like(state.u)
    forces.evaluate_surely(state.u, np.zeros_like(state.u), internal)
    finite = model.bonds is not None and model.bonds.finite
    reactions = np.where(case.fixed, internal, 0.0)
    size = np.abs(internal)

    def pairs():
        for k, mode in enumerate(rigid_modes(model, state.u if finite else None)):
            if k < 3:
                yield -reactions, mode
            yield internal, mode
            yield size, np.abs(mode)

    dots = exact_dots(model.comm, pairs())
    reaction, net, gross = dots[0:9:3], np.append(dots[1:9:3], dots[9::2]), np.append(dots[2:9:3], dots[10::2])

    def ratio(d):
        whole = float(gross[d].max())
        return float(np.abs(net[d]).max()) / whole if whole > 0.0 else 0.0

    return reaction, ratio(slice(0, 3)), ratio(slice(3, 6))
