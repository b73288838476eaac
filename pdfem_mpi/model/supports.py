"""Prescribed displacements of a deck, on cells with points and on nodes."""

from __future__ import annotations

import numpy as np

from pdfem_mpi.body.discretization import Discretization
from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.deck.table import SceneError
from pdfem_mpi.mesh import named_sets
from pdfem_mpi.model.selection import select_cells


def prescribe(scene: Scene, discretization: Discretization, messages: list[str]):
    """Prescribed displacements, model units, and the supports that prescribe them; NaN where free.

    Both for the points of cells (n_cells, 3) and for nodes (n_mesh_nodes, 3).
    """
    mesh, units = discretization.mesh, discretization.units
    on_cells = np.full((len(mesh.cells), 3), np.nan)
    on_nodes = np.full((len(mesh.nodes), 3), np.nan)
    by_cells, by_nodes = on_cells.copy(), on_nodes.copy()
    mirrored = discretization.plane_components
    for index, support in enumerate(scene.supports):
        where = f"supports.{index}"
        try:
            cells = select_cells(discretization, support, where, scene)
        except SceneError as error:
            messages += error.messages
            continue
        nodes = np.zeros(len(mesh.nodes), bool)
        nodes[mesh.cells[cells & discretization.has_nodes]] = True
        if support.face is not None:
            nodes &= mesh.nodes_on_face(support.face)
        if support.set is not None:
            nodes, stray = _nodes_of_set(discretization, support, where, cells)
            messages += stray
        for d, amount in enumerate((support.x, support.y, support.z)):
            if amount is None:
                continue
            displacement = float(units.numbers(amount / units.length))
            through = np.count_nonzero(nodes & mirrored[:, d])
            if through and amount:
                messages.append(
                    f"{where}.{'xyz'[d]} = {amount:.6g} moves {through} nodes out of a mirror plane (mesh.symmetry). "
                    "Keep the support off the plane, or remove the mirror."
                )
            for table, holder, chosen in (
                (on_cells, by_cells, cells & ~discretization.has_nodes),
                (on_nodes, by_nodes, nodes),
            ):
                other = chosen & ~np.isnan(table[:, d]) & (table[:, d] != displacement)
                if other.any():
                    before = table[np.flatnonzero(other)[0], d] * units.length
                    messages.append(
                        f"{where}.{'xyz'[d]} = {amount:.6g} contradicts {before:.6g}, prescribed by an earlier support "
                        f"at {np.count_nonzero(other)} of the same places. Keep one of them."
                    )
                table[chosen, d] = displacement
                holder[chosen, d] = index
    on_nodes[mirrored] = 0.0
    return (on_cells, on_nodes), (by_cells, by_nodes)


def _nodes_of_set(discretization: Discretization, support, where: str, cells: np.ndarray):
    """Nodes of elements that a support's set holds, bool, (n_nodes,), and what it holds where nothing can be."""
    mesh = discretization.mesh
    wanted = named_sets.nodes_of(mesh, support, where)
    chosen = wanted & (discretization.node_number >= 0)
    wanted[mesh.cells[cells]] = False
    stray = np.flatnonzero(wanted & ~chosen)
    if not len(stray):
        return chosen, []
    place = ", ".join(f"{c:.6g}" for c in mesh.nodes[stray[0]])
    return chosen, [
        f"{where}.set = {support.set} has {len(stray)} nodes of peridynamic cells that make up no face of one, the "
        f"first at ({place}): peridynamic points are held beneath faces or in cells. Use such a set."
    ]
