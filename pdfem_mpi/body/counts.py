"""Sizes of the whole body, which every rank knows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pdfem_mpi.body.discretization import Discretization


@dataclass(frozen=True)
class Counts:
    """Sizes of the whole body: all cells, cells with points, with free points, elements, overlap; nodes in use."""

    cells: int
    point_cells: int
    free_cells: int
    elements: int
    overlap_cells: int
    node_cells: int
    nodes: int
    mesh_nodes: int
    bodies: int


def count(whole: Discretization) -> Counts:
    """Count the whole body."""
    return Counts(
        cells=len(whole.mesh.cells),
        point_cells=whole.n_point_cells,
        free_cells=int(np.count_nonzero(whole.has_points & ~whole.is_overlap)),
        elements=int(np.count_nonzero(whole.has_stiffness)),
        overlap_cells=int(np.count_nonzero(whole.is_overlap)),
        node_cells=int(np.count_nonzero(whole.has_nodes)),
        nodes=whole.n_nodes,
        mesh_nodes=len(whole.mesh.nodes),
        bodies=whole.n_bodies,
    )


def too_many_ranks(n_parts: int, n_cells: int) -> str:
    """A sentence about more ranks than cells."""
    return f"{n_parts} ranks cannot share {n_cells} cells. Use at most {n_cells} ranks, or a finer mesh."
