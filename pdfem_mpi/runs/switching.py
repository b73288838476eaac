"""A switch: elements are turned into bonds in the middle of a run, as if it went on from a checkpoint on another body.

What depends on the region is made anew, as a function of the deck, the mesh and the turned cells. The state goes along
by the numbers of cells and nodes in the mesh: points and nodes that stay keep their displacements, new points get those
of their element, broken bonds are broken again. The two descriptions differ in strain energy at the same displacements;
the difference is booked.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from pdfem_mpi.body.found_region import Turning
from pdfem_mpi.body.share import Share
from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.deck.table import SceneError
from pdfem_mpi.model.bounds import Bounds
from pdfem_mpi.model.model import Model
from pdfem_mpi.parallel.comm import broadcast, sum_integers
from pdfem_mpi.parallel.slabs import gather_pairs, redistribute
from pdfem_mpi.peridynamics.bonds import total_bonds
from pdfem_mpi.peridynamics.clusters import cluster_layout
from pdfem_mpi.peridynamics.failure import Failure
from pdfem_mpi.runs.memory_estimate import Need, check_model, estimate, fits_easily
from pdfem_mpi.runs.prepare import cut_share
from pdfem_mpi.solvers.convergence import NotConverged
from pdfem_mpi.stepping import arrest

if TYPE_CHECKING:
    from pdfem_mpi.runs.simulation import Simulation


def switch(simulation: Simulation, turning: Turning) -> None:
    """Turn cells into bonds, and go on from the state as it is. Collective.

    Raises
    ------
    NotConverged
        On all ranks: the region has become too large.
    """
    state = simulation.state
    before = _stored(simulation)
    count_bonds(simulation)
    share, need = _wider_share(simulation, turning)
    u_points, u_nodes = carry_over(simulation, share)
    broken = broken_bonds(simulation, share)
    books = Books.of(simulation.failure)
    simulation.let_go()
    simulation.need = need
    simulation.build(share, again=True)
    state.fields, state.bounds = {"u": np.zeros(simulation.model.n_unknowns)}, Bounds()
    unknowns = simulation.model.unknowns
    unknowns.of_points(state.u)[:] = cluster_layout(u_points)
    unknowns.of_nodes(state.u)[:] = u_nodes
    simulation.assemble()
    solver = simulation.prepare_solver()
    if books is not None:
        books.enter(simulation.model, simulation.failure, broken, solver)
    program = state.program
    arrest.forget(program)
    program["switched"] = program.get("switched", 0.0) + before - _stored(simulation)
    program["switches"] = program.get("switches", 0.0) + 1.0
    program["interpolated"] = program["fresh"] = 1.0
    count_bonds(simulation)
    for observer in simulation.observers:
        observer.take(simulation, came_back=False)


def count_bonds(simulation: Simulation) -> None:
    """Book how many bonds the run has, and for how many evaluations it had so many since the last time. Collective."""
    program, evaluations = simulation.state.program, float(simulation.forces.evaluations)
    bonds = float(total_bonds(simulation.comm, simulation.model.bonds))
    program.setdefault("bonds_first", bonds)
    program["bonds_largest"] = max(program.get("bonds_largest", 0.0), bonds)
    since = program.get("counted_at", 0.0)
    program["bond_sweeps"] = program.get("bond_sweeps", 0.0) + (evaluations - since) * bonds
    program["counted_at"] = evaluations


def _stored(simulation: Simulation) -> float:
    """Strain energy of the state."""
    u = simulation.state.u
    simulation.forces.evaluate_surely(u, np.zeros_like(u), np.empty_like(u))
    return simulation.forces.stored_energy(u)


def _wider_share(simulation: Simulation, turning: Turning) -> tuple[Share, Need]:
    """The rank's share of the body with more bonds, which may lie elsewhere, and what memory it takes. Collective.

    Raises
    ------
    NotConverged
        On all ranks.
    """
    scene, comm, settings = simulation.scene, simulation.comm, simulation.scene.adaptive
    with _refused():
        share = cut_share(scene, comm, turning, simulation.share)
    if share.mesh_sha256 != simulation.share.mesh_sha256:
        raise NotConverged(f"mesh.path = {scene.mesh.path} has changed since the run began.")
    bonds = bonds_of(scene, share, settings.max_bonds)
    if bonds > settings.max_bonds:
        raise NotConverged(
            f"the region of bonds would grow to about {bonds:.3g} bonds, and adaptive.max_bonds = "
            f"{settings.max_bonds:g} ends the run. Raise it, use larger cells, or let the region grow by less at a "
            "time: adaptive.growth."
        )
    if fits_easily(share, most_bonds(share)):
        return share, simulation.need
    with _refused():
        return share, check_model(scene, share, comm, simulation.need.bytes)


@contextmanager
def _refused() -> Iterator[None]:
    """What a scene would be refused for ends a run that has begun."""
    try:
        yield
    except SceneError as error:
        raise NotConverged(f"the region of bonds cannot grow: {' '.join(error.messages)}") from error


def bonds_of(scene: Scene, share: Share, matters: float) -> float:
    """Bonds of all ranks, about; a number that is too large where it is below what matters. Collective."""
    most = most_bonds(share)
    if most <= matters:
        return most
    return float(sum_integers(share.comm, np.array([int(estimate(scene, share).bonds)]))[0])


def most_bonds(share: Share) -> float:
    """More bonds than the body has."""
    within = (share.cutoff + 2.0 * share.typical_edge) / share.typical_edge
    return share.counts.point_cells * 32.0 * 4.0 / 3.0 * math.pi * within**3


def carry_over(simulation: Simulation, share: Share) -> tuple[np.ndarray, np.ndarray]:
    """Displacements of the free points, (n, 8, 3), and nodes, (m, 3), of a new share. Collective."""
    old, model, comm = simulation.share, simulation.model, simulation.comm
    foretelling = simulation.region_watch.foretelling
    rows = foretelling.place(simulation.state.u)
    wanted = share.mesh.cell_id[share.subdomain.free]
    u_points = redistribute(comm, old.mesh.cell_id[foretelling.cells], rows, wanted, old.counts.cells)
    own = old.mesh.node_id[old.subdomain.owned_nodes]
    u_nodes = model.unknowns.of_nodes(simulation.state.u)
    nodes = share.mesh.node_id[share.subdomain.owned_nodes]
    return u_points, redistribute(comm, own, u_nodes, nodes, old.counts.mesh_nodes)


@dataclass(frozen=True)
class Books:
    """What the books of broken bonds keep at a switch, beside which bonds they are."""

    digits: np.ndarray
    total: int
    last_extent: np.ndarray
    skipped: int

    @classmethod
    def of(cls, failure: Failure | None) -> Books | None:
        """Those of the body as it is; None where nothing breaks."""
        if failure is None:
            return None
        total, skipped = getattr(failure, "left", failure.count), getattr(failure, "skipped", 0)
        return cls(failure.dissipated_digits.copy(), total, failure.last_extent, skipped)

    def enter(self, model: Model, failure: Failure, broken: np.ndarray, solver: Any) -> None:
        """Break and soften the bonds again, and let the solver, or its preconditioner, know. Collective."""
        failure.restore(model.comm, model.points, model.bonds, broken, self.digits, self.total)
        failure.last_extent = self.last_extent
        if self.skipped:
            failure.skipped = self.skipped
        taken = failure.take()
        if self.total:
            solver.update_after_breaks(taken)


def broken_bonds(simulation: Simulation, share: Share) -> np.ndarray:
    """Ids of the broken bonds with an end in a cell of the new share, int64, shape (n, 2). Collective.

    Those that soften are there as well, with their teeth in a third column. A bond across a mirror plane has two names,
    that of either point with the image of the other; which of them is used may change with the region, so both are
    there.
    """
    failure, comm, cells = simulation.failure, simulation.comm, share.counts.cells
    pairs = failure.broken_pairs() if failure else np.empty((0, 2), np.int64)
    owned, found = share.mesh.cell_id[share.is_owned], [pairs[:0]]
    for some in gather_pairs(comm, pairs, 8 * cells):
        both = with_other_names(broadcast(comm, some), cells)
        if comm.size > 1:
            both = both[np.isin(both[:, :2] // 8 % cells, owned).any(axis=1)]
        found.append(both)
    return np.concatenate(found)


def with_other_names(pairs: np.ndarray, cells: int) -> np.ndarray:
    """Bonds by their global ids, those across a mirror plane by both of their names.

    Parameters
    ----------
    pairs : int64, shape (n, 2 or 3)
        Global ids (lower, higher), each bond once; with its teeth.
    cells : int
        Of the whole mesh.

    Returns
    -------
    int64, shape (m, 2 or 3)
    """
    across = pairs[pairs[:, 1] >= 8 * cells]
    ids = across[:, :2]
    reflection, number = np.divmod(ids // 8, cells)
    other = np.sort(8 * (number + cells * reflection[:, ::-1]) + ids % 8, axis=1)
    new = (other != ids).any(axis=1)  # a point and its own image have one name
    return np.concatenate([pairs, np.column_stack([other, across[:, 2:]])[new]])
