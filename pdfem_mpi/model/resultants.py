"""The force of one load of a deck, and where it acts."""

from __future__ import annotations

import numpy as np

from pdfem_mpi.body.share import Share
from pdfem_mpi.deck.loads import BodyForce, Force
from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.kernels.hex8 import gauss_volumes
from pdfem_mpi.model.body_forces import density
from pdfem_mpi.model.tractions import traction_forces
from pdfem_mpi.parallel.sums import exact_dots


def resultant_of(scene: Scene, share: Share, index: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The force of one load of the deck, and where it is; `loads.make_load_case` has checked it. Collective.

    Returns
    -------
    float64, shape (3,), dimension force
        Of all ranks, each component rounded once; model units.
    bool, shapes (n_cells,) and (n_nodes,)
        This rank's cells with a force per volume or on their points, and its nodes with a force.
    """
    load, chosen = scene.loads[index], share.selections.loads[index]
    on_cells, on_nodes = np.zeros((len(share.mesh.cells), 3)), np.zeros((len(share.nodes), 3))
    on_points = np.zeros((len(share.mesh.cells), 8, 3))
    if isinstance(load, BodyForce):
        on_cells[chosen.cells] += density(share, load, chosen.cells)
    elif isinstance(load, Force):
        force = share.units.numbers(np.array(load.total) / share.units.force)
        on_nodes[chosen.nodes] += chosen.node_parts[:, None] * force
        np.add.at(on_points, tuple(chosen.points.T), chosen.point_parts[:, None] * force)
    else:
        on_nodes, on_points = traction_forces(share, load, chosen, f"loads.{index}")
    own_nodes = np.zeros(len(share.nodes), bool)
    own_nodes[share.subdomain.owned_nodes] = True
    cells = np.flatnonzero(on_cells.any(axis=1) & share.is_owned)
    volumes = gauss_volumes(share.nodes[share.mesh.cells[cells]]).sum(axis=1)
    of_cells, ones = on_cells[cells], np.ones(np.count_nonzero(own_nodes))
    of_points = on_points[share.is_owned].reshape(-1, 3)
    total = [
        exact_dots(
            share.comm,
            [
                (volumes, of_cells[:, d]),
                (ones, on_nodes[own_nodes, d]),
                (np.ones(len(of_points)), of_points[:, d]),
            ],
        ).sum()
        for d in range(3)
    ]
    has_force = (on_cells.any(axis=1) | on_points.any(axis=(1, 2))) & share.is_owned
    return np.array(total), has_force, on_nodes.any(axis=1) & own_nodes
