"""Nodes of a rank, and sums of what cells give to their nodes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pdfem_mpi.body.share import Share, Subdomain
from pdfem_mpi.kernels.node_table import add_rounded_rows
from pdfem_mpi.kernels.rounding import pattern_for
from pdfem_mpi.parallel.comm import largest
from pdfem_mpi.parallel.halo import Halo, build_halo


@dataclass(frozen=True)
class Nodes:
    """Nodes of the owned elements and overlap cells, owned nodes first.

    Attributes
    ----------
    n_owned : int
    number : int64, shape (n_nodes,)
        Number of each node in the mesh.
    x : float64, shape (n_nodes, 3), dimension length
    halo : Halo
    """

    n_owned: int
    number: np.ndarray
    x: np.ndarray
    halo: Halo


def local_nodes(share: Share, subdomain: Subdomain | None = None) -> np.ndarray:
    """Place of each node of the share among the `Nodes` of the rank, -1 for others; int32, shape (n_nodes,)."""
    subdomain = subdomain or share.subdomain
    local = np.full(len(share.nodes), -1, np.int32)
    seen = np.concatenate([subdomain.owned_nodes, subdomain.ghost_nodes])
    local[seen] = np.arange(len(seen))
    return local


def make_nodes(share: Share, comm) -> Nodes:
    """The nodes that a rank sees. Collective."""
    number, subdomain = share.mesh.node_id, share.subdomain
    owned, ghosts = subdomain.owned_nodes, subdomain.ghost_nodes
    local = np.concatenate([owned, ghosts])
    return Nodes(
        n_owned=len(owned),
        number=number[local],
        x=share.nodes[local],
        halo=build_halo(comm, number[owned], number[ghosts], subdomain.ghost_node_owner),
    )


def assemble(comm, nodes: Nodes, contributions, width: int) -> np.ndarray:
    """Sum numbers of cells at their nodes, in any order to the same bits. Collective.

    Parameters
    ----------
    contributions : callable
        Gives, each time anew, pairs of int32 (n, 8) and float64 (n, 8, width): local nodes of some cells, and a row of
        numbers for each.

    Returns
    -------
    float64, shape (n_owned, width)
    """
    top = max((float(np.abs(numbers).max(initial=0.0)) for _, numbers in contributions()), default=0.0)
    quantum, _ = pattern_for(float(largest(comm, np.array([top]))[0]))
    total = np.zeros((len(nodes.number), width), np.int64)
    for where, numbers in contributions():
        rows = np.ascontiguousarray(numbers).reshape(-1, width)
        add_rounded_rows(np.ascontiguousarray(where).reshape(-1), rows, quantum, total)
    nodes.halo.scatter_reverse(total)
    return total[: nodes.n_owned] * quantum
