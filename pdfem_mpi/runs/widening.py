"""How far the load of the next break may be off: solved once more with a region that is three times as wide.

The wider region stands beside the narrow one where that has few bonds. Else the narrow body goes before the wider one
is made, and is made again afterwards, as for a run that goes on from a checkpoint: two bodies are never there at once.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from pdfem_mpi.body.found_region import Turning
from pdfem_mpi.body.share import Share
from pdfem_mpi.deck.table import SceneError
from pdfem_mpi.model.breaking import make_failure
from pdfem_mpi.model.forces import Forces
from pdfem_mpi.model.loads import make_load_case
from pdfem_mpi.model.model import Model, build_model
from pdfem_mpi.model.not_finite import NotFinite
from pdfem_mpi.model.state import State, new_state
from pdfem_mpi.peridynamics.bonds import total_bonds
from pdfem_mpi.peridynamics.clusters import cluster_layout
from pdfem_mpi.runs.memory_estimate import check_model, fits_easily
from pdfem_mpi.runs.prepare import cut_share
from pdfem_mpi.runs.switching import Books, bonds_of, broken_bonds, carry_over, most_bonds
from pdfem_mpi.solvers import cg
from pdfem_mpi.solvers.convergence import Breakdown, NotConverged
from pdfem_mpi.solvers.preconditioner.cycle import Cycle
from pdfem_mpi.solvers.preconditioner.preconditioner import make_preconditioner
from pdfem_mpi.stepping.report import reaction, support_resultants
from pdfem_mpi.system.heap import APART_BESIDE_BONDS, give_back, large_arrays_apart

if TYPE_CHECKING:
    from pdfem_mpi.runs.simulation import Simulation

#: A region three times as wide finds 60 to 75 % of what bonds everywhere would change, with its sign.
OF_THE_CHANGE = 1.6
#: Relative residual of the wider body's equilibrium, which begins from that of the narrow one.
TOLERANCE = 1e-4
#: From so many bonds on the narrow body goes first. To make it again takes as long as a switch; fewer bonds are small
#: beside what the wider region takes.
MANY_BONDS = 5_000_000

_NOT_READ = np.empty(0)


def goes_first(simulation: Simulation) -> bool:
    """Whether the narrow body is let go before the wider one is made. Collective."""
    return total_bonds(simulation.comm, simulation.model.bonds) >= MANY_BONDS


def estimate_error(simulation: Simulation, own: float) -> float | None:
    """Relative error of the reaction at which the next bond breaks; above 0 where it is told too high. Collective.

    The state is one in which a bond is about to break, and stays as it is. Where `goes_first` says so, all but the
    state is made anew, and nobody else may hold parts of the simulation.

    Parameters
    ----------
    own : float, dimension force
        Reaction there.

    Returns
    -------
    float or None
        None where a wider region would be too large, has no equilibrium, or loads stay that do not grow.
    """
    alone = goes_first(simulation)
    share = _wider_share(simulation, alone)
    if share is None:
        return None
    carried = _Carried.of(simulation, share)
    if alone:
        narrow = _Narrow.let_go(simulation)
        simulation.share = share
        with large_arrays_apart():
            found = carried.reaction_at_break(simulation, share, simulation.kept_cycle)
        del share
        narrow.come_back(simulation)
    else:
        found = carried.reaction_at_break(simulation, share, simulation.solver.preconditioner.cycle)
    return None if found is None or own == 0.0 else OF_THE_CHANGE * (own - found) / own


def _wider_share(simulation: Simulation, alone: bool) -> Share | None:
    """The rank's share of the body with a region three times as wide; None where there can be none. Collective."""
    scene, comm, settings, found = simulation.scene, simulation.comm, simulation.scene.adaptive, simulation.share.found
    if simulation.case.constant is not None:
        return None
    width = 2.0 * max(settings.growth, settings.reach)
    try:
        share = cut_share(scene, comm, Turning(found.turned, found.turned, width), simulation.share)
    except SceneError:  # bonds would leave no element
        return None
    if bonds_of(scene, share, settings.max_bonds) > settings.max_bonds:
        return None
    if not alone and fits_easily(share, most_bonds(share)):
        return share
    narrow = simulation.need.bytes
    try:
        wider = check_model(scene, share, comm, narrow if alone else 0.0).bytes
    except SceneError:  # it does not fit into memory
        return None
    simulation.most_needed = max(simulation.most_needed, wider if alone else narrow + wider)
    return share


@dataclass
class _Carried:
    """What a wider body takes over from a narrow one.

    Attributes
    ----------
    u_points, u_nodes : float64, shapes (n, 8, 3), (m, 3), dimension length, or None
        Displacements of its free points and its nodes; None once it has them.
    broken : int64, shape (k, 2 or 3)
        Broken bonds with an end on this rank.
    books : Books
    """

    u_points: np.ndarray | None
    u_nodes: np.ndarray | None
    broken: np.ndarray
    books: Books

    @classmethod
    def of(cls, simulation: Simulation, share: Share) -> _Carried:
        """What a share of the wider body takes over. Collective."""
        return cls(*carry_over(simulation, share), broken_bonds(simulation, share), Books.of(simulation.failure))

    def reaction_at_break(self, simulation: Simulation, share: Share, kept: Cycle) -> float | None:
        """Reaction at which the next bond of the wider body breaks; None where it has no equilibrium. Collective.

        Parameters
        ----------
        kept : Cycle
            The preconditioner's, of the intact body.
        """
        scene, factor = simulation.scene, simulation.state.load_factor
        model = build_model(scene, share, simulation.comm, without=("intact_weights", "own_energy"))
        case, state = make_load_case(scene, share, model), new_state(model)
        self._displace(model, state)
        case.displace(state.u, factor)
        forces, failure = Forces(model, state.bounds), make_failure(scene, share, model)
        preconditioner = make_preconditioner(share, model, case, state.bounds, kept)
        self.books.enter(model, failure, self.broken, preconditioner)
        preconditioner.of_points = None  # no other bond breaks here
        external, most = case.forces(factor), scene.solver.max_evaluations
        case = replace(case, external=external, prescribed=_NOT_READ)
        give_back()  # what set-up took
        try:
            cg.solve(forces, state, external, case.fixed, TOLERANCE, most, preconditioner)
        except (Breakdown, NotConverged, NotFinite):
            return None
        residual = np.empty_like(state.u)
        forces.evaluate_surely(state.u, external, residual)
        ratio = forces.largest_ratio(failure)
        found = reaction(case, support_resultants(forces, case, residual), factor)
        return found / ratio if ratio > 0.0 else None

    def _displace(self, model: Model, state: State) -> None:
        """Give a state the displacements, which are not kept here."""
        model.unknowns.of_points(state.u)[:] = cluster_layout(self.u_points)
        model.unknowns.of_nodes(state.u)[:] = self.u_nodes
        self.u_points = self.u_nodes = None


@dataclass(frozen=True)
class _Narrow:
    """What the narrow body needs to come back; displacements stay in the state.

    Attributes
    ----------
    turned : int64, shape (n,)
    broken : int64, shape (k, 2 or 3)
        The rank's broken bonds.
    books : Books
    bounds : dict
        As ``dataclasses.asdict`` has them.
    """

    turned: np.ndarray
    broken: np.ndarray
    books: Books
    bounds: dict[str, Any]

    @classmethod
    def let_go(cls, simulation: Simulation) -> _Narrow:
        """Let the body of a simulation go."""
        turned, bounds = simulation.share.found.turned, asdict(simulation.state.bounds)
        narrow = cls(turned, simulation.failure.broken_pairs(), Books.of(simulation.failure), bounds)
        simulation.let_go(comes_back=True)
        return narrow

    def come_back(self, simulation: Simulation) -> None:
        """Make the body of a simulation again. Collective.

        It has the same cells and nodes on every rank, in the same order: it is a function of the deck, the mesh and the
        turned cells.
        """
        with large_arrays_apart():
            again = Turning(self.turned, np.empty(0, np.int64))
            share, simulation.share = cut_share(simulation.scene, simulation.comm, again, simulation.share), None
            simulation.build(share, again=True)
            simulation.assemble()
        with large_arrays_apart(APART_BESIDE_BONDS):
            solver = simulation.prepare_solver()
        simulation.state.bounds.fill(self.bounds)
        self.books.enter(simulation.model, simulation.failure, self.broken, solver)
        for observer in simulation.observers:
            observer.take(simulation, came_back=True)
