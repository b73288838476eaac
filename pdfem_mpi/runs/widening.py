"""How far the load of the next break may be off: solved once more with a region that is three times as wide."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pdfem_mpi.body.found_region import Turning
from pdfem_mpi.body.share import Share
from pdfem_mpi.deck.table import SceneError
from pdfem_mpi.model.breaking import make_failure
from pdfem_mpi.model.forces import Forces
from pdfem_mpi.model.loads import make_load_case
from pdfem_mpi.model.model import build_model
from pdfem_mpi.model.not_finite import NotFinite
from pdfem_mpi.model.state import new_state
from pdfem_mpi.peridynamics.clusters import cluster_layout
from pdfem_mpi.runs.memory_estimate import fits, fits_easily
from pdfem_mpi.runs.prepare import cut_share
from pdfem_mpi.runs.switching import Books, bonds_of, broken_bonds, carry_over, most_bonds
from pdfem_mpi.solvers import cg
from pdfem_mpi.solvers.convergence import Breakdown, NotConverged
from pdfem_mpi.solvers.preconditioner.preconditioner import make_preconditioner
from pdfem_mpi.stepping.report import reaction, support_resultants

if TYPE_CHECKING:
    from pdfem_mpi.runs.simulation import Simulation

#: A region three times as wide finds 60 to 75 % of what bonds everywhere would change, with its sign.
OF_THE_CHANGE = 1.6
#: Relative residual of the wider body's equilibrium, which begins from that of the narrow one.
TOLERANCE = 1e-4


def estimate_error(simulation: Simulation, own: float) -> float | None:
    """Relative error of the reaction at which the next bond breaks; above 0 where it is told too high. Collective.

    The state is one in which a bond is about to break, and stays as it is.

    Parameters
    ----------
    own : float, dimension force
        Reaction there.

    Returns
    -------
    float or None
        None where a wider region would be too large, has no equilibrium, or loads stay that do not grow.
    """
    settings, found = simulation.scene.adaptive, simulation.share.found
    if simulation.case.constant is not None:
        return None
    width = 2.0 * max(settings.growth, settings.reach)
    try:
        share = cut_share(
            simulation.scene, simulation.comm, Turning(found.turned, found.turned, width), simulation.share
        )
    except SceneError:  # bonds would leave no element
        return None
    if bonds_of(simulation.scene, share, settings.max_bonds) > settings.max_bonds:
        return None
    if not fits_easily(share, most_bonds(share)) and not fits(simulation.scene, share, simulation.comm):
        return None
    reaction_of_wider = _reaction_at_break(simulation, share)
    return None if reaction_of_wider is None or own == 0.0 else OF_THE_CHANGE * (own - reaction_of_wider) / own


def _reaction_at_break(simulation: Simulation, share: Share) -> float | None:
    """Reaction at which the next bond of a wider region breaks. Collective."""
    scene, factor = simulation.scene, simulation.state.load_factor
    u_points, u_nodes = carry_over(simulation, share)
    model = build_model(scene, share, simulation.comm)
    case, state = make_load_case(scene, share, model), new_state(model)
    model.unknowns.of_points(state.u)[:] = cluster_layout(u_points)
    model.unknowns.of_nodes(state.u)[:] = u_nodes
    case.displace(state.u, factor)
    forces, failure = Forces(model, state.bounds), make_failure(scene, share, model)
    kept, most = simulation.solver.preconditioner.cycle, scene.solver.max_evaluations
    preconditioner = make_preconditioner(share, model, case, state.bounds, kept)
    Books.of(simulation.failure).enter(model, failure, broken_bonds(simulation, share), preconditioner)
    try:
        cg.solve(forces, state, case.forces(factor), case.fixed, TOLERANCE, most, preconditioner)
    except (Breakdown, NotConverged, NotFinite):
        return None
    residual = np.empty_like(state.u)
    forces.evaluate_surely(state.u, case.forces(factor), residual)
    ratio = forces.largest_ratio(failure)
    found = reaction(case, support_resultants(forces, case, residual), factor)
    return found / ratio if ratio > 0.0 else None
