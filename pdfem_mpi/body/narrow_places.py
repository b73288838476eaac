"""Places narrower than a cell: the node at a point, nodes on a line, nodes in a box, and peridynamic points there.

A roller or a pin must not clamp the rotation about it. Nodes on a line do not. Of the points of bonds, which lie inside
of cells, only one row is taken: two rows, on both sides of the line, would.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from pdfem_mpi.body.discretization import Discretization
from pdfem_mpi.body.on_lines import from_line, points_at, share_line
from pdfem_mpi.deck.table import SceneError
from pdfem_mpi.kernels.hex8 import gauss_positions
from pdfem_mpi.mesh.part import MeshPart

#: A node is on a point or a line within this part of the shortest edge.
NEAR = 1e-3
NO_POINTS = np.empty((0, 2), np.int64)


def is_narrow(entry: Any) -> bool:
    """Whether a support speaks of nodes and points by themselves."""
    return any(getattr(entry, name, None) is not None for name in ("point", "line")) or (
        getattr(entry, "of", "cells") == "nodes"
    )


def select_narrow(whole: Discretization, entry: Any, where: str) -> tuple[np.ndarray, np.ndarray]:
    """Nodes with unknowns, rising, and rows of cell and Gauss point, int64, shape (n, 2): numbers in the whole mesh.

    Raises
    ------
    SceneError
        Nothing is there.
    SeenInPart
        The same, where each rank sees a part of the mesh.
    """
    if entry.point is None and entry.line is None:
        return _in_box(whole, entry, where)
    nodes, _, points, _ = _on_line(_around_line(whole, entry), entry, where)
    return nodes, points


def _line_of(entry: Any) -> Any:
    """The ends of a line; of a point they are one."""
    return (entry.point, entry.point) if entry.line is None else entry.line


def _around_line(body: Discretization, entry: Any) -> Discretization:
    """The body, or, where each rank sees a part of it, all cells with a node on a line, on every rank. Collective.

    Raises
    ------
    SeenInPart
        There is none.
    """
    mesh, everywhere = body.mesh, body.mesh.everywhere
    if everywhere.own is None:
        return body
    on = from_line(mesh.nodes, *_line_of(entry))[0] <= NEAR * mesh.smallest_edge
    cells = np.flatnonzero(on[mesh.cells].any(axis=1) & everywhere.own)
    everywhere.refused(everywhere.total(len(cells))[0] == 0)
    ids, corners, x, points, overlap, carries = (
        everywhere.joined(rows)
        for rows in (
            mesh.cell_id[cells], mesh.node_id[mesh.cells[cells]], mesh.nodes[mesh.cells[cells]],
            body.has_points[cells], body.is_overlap[cells], body.carries[mesh.cells[cells]],
        )
    )  # fmt: skip
    order = np.argsort(ids, kind="stable")
    numbers, first, place = np.unique(corners[order], return_index=True, return_inverse=True)
    near = MeshPart(
        x[order].reshape(-1, 3)[first], place.reshape(-1, 8), measures=mesh.measures, cell_id=ids[order],
        node_id=numbers,
    )  # fmt: skip
    carried = carries[order].reshape(-1)[first]
    return replace(body, mesh=near, has_points=points[order], is_overlap=overlap[order], carries=carried)


def _on_line(whole: Discretization, entry: Any, where: str):
    """Nodes and points on a line, each with its length of it, of the body or of the cells with a node there."""
    mesh, free = whole.mesh, whole.has_points & ~whole.is_overlap
    near = NEAR * mesh.smallest_edge
    distance, _ = from_line(mesh.nodes, *_line_of(entry))
    on = distance <= near
    if not on.any():
        first = int(np.argmin(distance))
        place = ", ".join(f"{c:.6g}" for c in mesh.nodes[first])
        key = "point" if entry.line is None else "line"
        raise SceneError(
            [
                f"{where}.{key} has no node of the mesh on it; the nearest is {distance[first]:.3g} away, at ({place})."
                ' Give a place where nodes are, or a box with of = "nodes".'
            ]
        )
    if entry.line is None:
        of_nodes = on.astype(np.float64)
        points = points_at(mesh, np.flatnonzero(free & on[mesh.cells].any(axis=1)), entry.point)
        of_points = np.ones(len(points))
    else:
        of_nodes, points, of_points = share_line(mesh, on, whole.carries, free, entry.line, near)
    nodes = np.flatnonzero(on & whole.carries)
    if not len(nodes) and not len(points):
        raise SceneError(
            [
                f"{where}.line has no peridynamic point along it: in bonds a line runs along edges or diagonals of "
                'cells. Turn it, or use a box with of = "nodes".'
            ]
        )
    points = np.column_stack([mesh.cell_id[points[:, 0]], points[:, 1]])
    return mesh.node_id[nodes], of_nodes[nodes], points, of_points


def spread(whole: Discretization, entry: Any, where: str) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Nodes and points of a force, as `select_narrow` finds them, each with its part: its length of the line.

    Returns
    -------
    nodes, parts of nodes, points, parts of points
    """
    nodes, of_nodes, points, of_points = _on_line(_around_line(whole, entry), entry, where)
    whole_length = float(of_nodes.sum() + of_points.sum())
    return nodes, of_nodes / whole_length, points, of_points / whole_length


def _in_box(whole: Discretization, entry: Any, where: str) -> tuple[np.ndarray, np.ndarray]:
    """Nodes with unknowns and free points that lie in a closed box."""
    mesh, free = whole.mesh, whole.has_points & ~whole.is_overlap
    lower = np.full(3, -np.inf) if entry.lower is None else np.array(entry.lower) - mesh.tolerance
    upper = np.full(3, np.inf) if entry.upper is None else np.array(entry.upper) + mesh.tolerance

    def inside(x: np.ndarray) -> np.ndarray:
        return ((x >= lower) & (x <= upper)).all(axis=-1)

    nodes = inside(mesh.nodes) & whole.carries
    corners = mesh.nodes[mesh.cells]
    reached = (corners.max(axis=1) >= lower).all(axis=1) & (corners.min(axis=1) <= upper).all(axis=1)
    cells = np.flatnonzero(free & reached)
    cell, g = np.nonzero(inside(gauss_positions(corners[cells])))
    there = nodes[mesh.cells].any(axis=1)
    there[cells[cell]] = True
    if mesh.everywhere.lacks(there):
        raise SceneError(
            [f"{where} has no node of elements and no peridynamic point in its box. Widen it, or leave out of."]
        )
    return mesh.node_id[nodes], np.column_stack([mesh.cell_id[cells[cell]], g])
