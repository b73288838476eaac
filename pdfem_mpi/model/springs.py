"""Springs between the body and the ground: a stiffness of single unknowns, beside that of bonds and elements.

A spring on faces is spread over their nodes as a traction is. Of a peridynamic cell it takes the points beneath the
face: the functions through all eight points have weights below 0, and a spring has none.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pdfem_mpi.body.selection import ChosenSpots
from pdfem_mpi.body.share import Share
from pdfem_mpi.deck.restraints import Spring
from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.deck.table import SceneError
from pdfem_mpi.kernels.hex8 import SHAPE_AT_GAUSS
from pdfem_mpi.model.tractions import traction_forces
from pdfem_mpi.model.unknowns import Unknowns
from pdfem_mpi.parallel.sums import exact_dots
from pdfem_mpi.peridynamics.clusters import cluster_layout


@dataclass(frozen=True)
class Springs:
    """What they are on this rank, in model units.

    Attributes
    ----------
    index : int64, shape (n,)
        Unknowns with a spring.
    stiffness : float64, shape (n,), dimension force / length
        Of all springs at each.
    tables : tuple of pairs
        For each table and axis, its unknowns, int64, and their stiffness, float64: three pairs a table.
    nodes : int64, shape (m,)
        Nodes of the share with springs where points hand theirs to the nodes of their cells.
    of_nodes : float64, shape (m, 3), dimension force / length
        Whole at the nodes that the rank owns.
    """

    index: np.ndarray
    stiffness: np.ndarray
    tables: tuple[tuple[np.ndarray, np.ndarray], ...]
    nodes: np.ndarray
    of_nodes: np.ndarray

    def pull(self, u: np.ndarray, force: np.ndarray) -> None:
        """Add the springs' forces at displacements ``u`` to the forces on the unknowns, both (n_unknowns,)."""
        force[self.index] -= self.stiffness * u[self.index]

    def resultants(self, comm, u: np.ndarray) -> np.ndarray:
        """Forces of each table on the body, float64, shape (n_tables, 3). Collective."""
        return exact_dots(comm, [(u[index], -stiffness) for index, stiffness in self.tables]).reshape(-1, 3)

    def energy(self, comm, u: np.ndarray) -> float:
        """What is stored in them, dimension force length. Collective."""
        moved = u[self.index]
        (twice,) = exact_dots(comm, [(self.stiffness * moved, moved)])
        return 0.5 * float(twice)

    def rows(self, unknowns: Unknowns) -> np.ndarray:
        """Stiffness of points and nodes, in the order of `Unknowns.rows`; float64, shape (n_points + n_nodes, 3)."""
        whole = np.zeros(unknowns.size)
        whole[self.index] = self.stiffness
        return unknowns.rows(whole)

    def on_nodes(self, owned: np.ndarray, n_nodes: int) -> Springs:
        """The same for a model with nodes alone, which owns these of the share's ``n_nodes``."""
        whole = np.zeros((n_nodes, 3))
        whole[self.nodes] = self.of_nodes
        flat = whole[owned].reshape(-1)
        index = np.flatnonzero(flat)
        return Springs(index, flat[index], (), self.nodes, self.of_nodes)


def make_springs(scene: Scene, share: Share, unknowns: Unknowns) -> Springs | None:
    """The deck's springs on this rank; None without any. Collective.

    Tables whose places were not found are left out: `loads.make_load_case` refuses them.

    Raises
    ------
    SceneError
        On all ranks: faces on a mirror plane.
    """
    if not scene.springs:
        return None
    units, messages = share.units, []
    everywhere, tables = np.zeros(unknowns.size), []
    lumped = np.zeros((len(share.nodes), 3))
    along = unknowns.components()
    for index, (spring, chosen) in enumerate(zip(scene.springs, share.selections.springs, strict=True)):
        if chosen is None:
            tables += [(np.empty(0, np.int64), np.empty(0))] * 3
            continue
        try:
            on_nodes, on_points = _parts(share, spring, chosen, f"springs.{index}")
        except SceneError as error:
            messages += error.messages
            continue
        stiffness = units.numbers(np.array(spring.stiffness) * units.length / units.force)
        flat = np.zeros(unknowns.size)
        if unknowns.n_points:
            rows = on_points[share.subdomain.free].reshape(-1, 8, 1) * stiffness
            unknowns.of_points(flat)[:] = cluster_layout(rows)
        if unknowns.n_nodes:
            unknowns.of_nodes(flat)[:] = on_nodes[share.subdomain.owned_nodes, None] * stiffness
        everywhere += flat
        for d in range(3):
            places = np.flatnonzero((along == d) & (flat > 0.0))
            tables.append((places, flat[places]))
        lumped += _at_corners(share, on_nodes, on_points)[:, None] * stiffness
    if messages:
        raise SceneError(messages)
    places, nodes = np.flatnonzero(everywhere), np.flatnonzero(lumped.any(axis=1))
    return Springs(places, everywhere[places], tuple(tables), nodes, lumped[nodes])


def _parts(share: Share, spring: Spring, chosen, where: str) -> tuple[np.ndarray, np.ndarray]:
    """Parts of a spring at nodes (n_nodes,) and points (n_cells, 8), which sum to 1 over all ranks. Collective."""
    on_nodes, on_points = np.zeros(len(share.nodes)), np.zeros((len(share.mesh.cells), 8))
    if isinstance(chosen, ChosenSpots):
        on_nodes[chosen.nodes] += chosen.node_parts
        np.add.at(on_points, tuple(chosen.points.T), chosen.point_parts)
        return on_nodes, on_points
    nodal, of_points = traction_forces(share, spring.pull(share.units.force), chosen, where)
    cells = np.flatnonzero(of_points.any(axis=(1, 2)))
    near = np.maximum(of_points[cells, :, 0], 0.0)
    on_points[cells] = near * (of_points[cells, :, 0].sum(axis=1) / near.sum(axis=1))[:, None]
    return nodal[:, 0], on_points


def _at_corners(share: Share, on_nodes: np.ndarray, on_points: np.ndarray) -> np.ndarray:
    """What nodes have, and what points of cells give to their corners; float64, shape (n_nodes,)."""
    total = on_nodes.copy()
    cells = np.flatnonzero(on_points.any(axis=1))
    for p in range(8):
        np.add.at(total, share.mesh.cells[cells], SHAPE_AT_GAUSS[p] * on_points[cells, p, None])
    return total
