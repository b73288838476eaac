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


def count(body: Discretization, nodes: int, mesh_nodes: int) -> Counts:
    """Count the whole body. Collective, if each rank sees a part of it.

    Parameters
    ----------
    nodes, mesh_nodes : int
        Of the whole body: those with unknowns, and all.
    """
    points, overlap = body.has_points, body.is_overlap
    cells, of_points, free, elements, both, of_nodes = body.mesh.everywhere.count(
        np.ones(len(points), bool), points, points & ~overlap, body.has_stiffness, overlap, body.has_nodes
    )
    # of several bodies every rank sees the whole
    bodies = body.n_bodies if body.mesh.everywhere.own is None else int(of_points > 0)
    return Counts(cells, of_points, free, elements, both, of_nodes, nodes, mesh_nodes, bodies)


def too_many_ranks(n_parts: int, n_cells: int) -> str:
    """A sentence about more ranks than cells."""
    return f"{n_parts} ranks cannot share {n_cells} cells. Use at most {n_cells} ranks, or a finer mesh."
