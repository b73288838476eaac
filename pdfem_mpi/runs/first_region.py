"""The first region of bonds: elements everywhere, one equilibrium, and where it comes nearest to breaking."""

from __future__ import annotations

import numpy as np

from pdfem_mpi.body.found_region import Turning
from pdfem_mpi.body.share import Share
from pdfem_mpi.deck.programs import Steps
from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.deck.table import SceneError
from pdfem_mpi.measure.foretelling import Foretelling
from pdfem_mpi.model.forces import Forces
from pdfem_mpi.model.loads import make_load_case
from pdfem_mpi.model.model import build_model
from pdfem_mpi.model.not_finite import NotFinite
from pdfem_mpi.model.state import new_state
from pdfem_mpi.parallel.comm import largest, sum_integers
from pdfem_mpi.runs.pilot import broken_places
from pdfem_mpi.solvers import cg
from pdfem_mpi.solvers.convergence import Breakdown, NotConverged
from pdfem_mpi.solvers.preconditioner.cycle import Cycle
from pdfem_mpi.solvers.preconditioner.preconditioner import make_preconditioner

#: Relative residual of the first equilibrium: the places that come out near to breaking are found to some per cent.
TOLERANCE = 1e-6
#: The threshold is this far above the median of the body, at least: else the interface, which disturbs what is around
#: it, would turn the whole body.
LEAST_CONTRAST = 1.5


def first_turning(scene: Scene, share: Share) -> tuple[Turning, Cycle | None]:
    """Which cells are bonds at the beginning, and what the preconditioner has of the intact body. Collective.

    Parameters
    ----------
    share : Share
        Of the body with elements everywhere.

    Raises
    ------
    SceneError
        On all ranks: nothing is stretched, no place stands out, or the pilot run says nothing.
    """
    settings, none = scene.adaptive, np.empty(0, np.int64)
    places, distance = broken_places(scene, share) if settings.pilot else (None, 0.0)
    if scene.cracks:  # elements do not know them: what they say near a crack is not so
        return Turning(none, none, 0.0, places, distance, cracks=True), None
    hot, cycle = _hot_cells(scene, share)
    return Turning(none, hot, max(settings.growth, settings.reach), places, distance), cycle


def _hot_cells(scene: Scene, share: Share) -> tuple[np.ndarray, Cycle]:
    """Numbers of the cells that come nearest to breaking, rising, the same on all ranks. Collective."""
    comm, threshold = share.comm, scene.adaptive.threshold_with(scene.peridynamics.surface_correction)
    foretelling, u, cycle = _equilibrium(scene, share)
    turns = share.found.can_turn[foretelling.cells]
    top = foretelling.most_strained(u, turns)
    for fraction in (1.0, threshold / LEAST_CONTRAST):  # the largest, then all that are compared with it
        ratio = foretelling.ratios(u, np.where(turns, fraction * top, np.inf))
        top = max(top, float(largest(comm, np.array([ratio.max(initial=0.0)]))[0]))
    if not top > 0.0:
        raise SceneError([
            'the load stretches no cell that regions with model = "auto" could turn into bonds: nothing can break. '
            "Load the body otherwise."
        ])  # fmt: skip
    hot = ratio >= threshold * top
    contrast = ratio >= threshold / LEAST_CONTRAST * top
    asked = (share.found.can_turn & share.is_owned)[foretelling.cells]
    near, cells = sum_integers(comm, np.array([np.count_nonzero(contrast), np.count_nonzero(asked)])).tolist()
    if 2 * near > cells:
        raise SceneError([
            f"adaptive.threshold = {threshold:g} is below {LEAST_CONTRAST:g} times the median: {near:,} of {cells:,} "
            f"cells stretch by {threshold / LEAST_CONTRAST:.3g} of the most or more, so that no place stands out in "
            'which the first bond would break. Use a larger threshold, or describe the body by model = "peridynamics".'
        ])  # fmt: skip
    own = share.mesh.cell_id[foretelling.cells[hot]]
    return np.unique(np.concatenate(comm.allgather(own))), cycle


def _equilibrium(scene: Scene, share: Share) -> tuple[Foretelling, np.ndarray, Cycle]:
    """What elements alone foretell, their displacements under the load, and the preconditioner's cycle. Collective."""
    model = build_model(scene, share, share.comm)
    case, state = make_load_case(scene, share, model), new_state(model)
    forces = Forces(model, state.bounds)
    factor = 1.0
    if isinstance(scene.stepping, Steps):
        factor = max(scene.stepping.load_factors, key=abs)
    case.displace(state.u, factor)
    preconditioner, most = make_preconditioner(share, model, case, state.bounds), scene.solver.max_evaluations
    try:
        cg.solve(forces, state, case.forces(factor), case.fixed, TOLERANCE, most, preconditioner)
    except (Breakdown, NotConverged, NotFinite) as error:
        raise SceneError([f"the equilibrium of elements alone was not found, for the first region: {error}"]) from None
    return Foretelling(scene, share, model), state.u, preconditioner.cycle
