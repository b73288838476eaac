"""Prescribed displacements of a deck, on cells with points and on nodes."""

from __future__ import annotations

import numpy as np

from pdfem_mpi.body.share import Share
from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.parallel.comm import sum_integers


def prescribe(scene: Scene, share: Share, messages: list[str]):
    """Prescribed displacements, model units, and the supports that prescribe them; NaN where free. Collective.

    Both for the points of the share's cells (n_cells, 3) and for its nodes (n_nodes, 3).
    """
    on_cells = np.full((len(share.mesh.cells), 3), np.nan)
    on_nodes = np.full((len(share.nodes), 3), np.nan)
    by_cells, by_nodes = on_cells.copy(), on_nodes.copy()
    mirrored = share.plane_components
    own_nodes = np.zeros(len(share.nodes), bool)
    own_nodes[share.subdomain.owned_nodes] = True
    for index, (support, chosen) in enumerate(zip(scene.supports, share.selections.supports, strict=True)):
        where = f"supports.{index}"
        messages += share.selections.problems_of_supports[index]
        if chosen is None:
            continue
        cells, nodes = chosen.cells[~share.has_nodes[chosen.cells]], chosen.nodes
        for d, amount in enumerate((support.x, support.y, support.z)):
            if amount is None:
                continue
            displacement = float(share.units.numbers(amount / share.units.length))
            through = _count(share, own_nodes[nodes] & mirrored[nodes, d]) if amount and share.mirrors else 0
            if through:
                messages.append(
                    f"{where}.{'xyz'[d]} = {amount:.6g} moves {through} nodes out of a mirror plane (mesh.symmetry). "
                    "Keep the support off the plane, or remove the mirror."
                )
            for table, holder, places, owned, numbers in (
                (on_cells, by_cells, cells, share.is_owned, share.mesh.cell_id),
                (on_nodes, by_nodes, nodes, own_nodes, share.mesh.node_id),
            ):
                before = table[places, d]
                other = owned[places] & ~np.isnan(before) & (before != displacement)
                if count := _count(share, other):
                    value = _first(share, numbers[places[other]], before[other]) * share.units.length
                    messages.append(
                        f"{where}.{'xyz'[d]} = {amount:.6g} contradicts {value:.6g}, prescribed by an earlier support "
                        f"at {count} of the same places. Keep one of them."
                    )
                table[places, d] = displacement
                holder[places, d] = index
    on_nodes[mirrored] = 0.0
    return (on_cells, on_nodes), (by_cells, by_nodes)


def _count(share: Share, chosen: np.ndarray) -> int:
    return int(sum_integers(share.comm, np.array([np.count_nonzero(chosen)]))[0])


def _first(share: Share, numbers: np.ndarray, values: np.ndarray) -> float:
    """The value at the lowest number on all ranks. Collective."""
    own = (int(numbers[0]), float(values[0])) if len(numbers) else None
    return min(found for found in share.comm.allgather(own) if found)[1]
