"""Digests of the mesh and of the body: of the whole on one rank, or a slab at a time of what ranks see in part."""

from __future__ import annotations

import hashlib
from typing import TYPE_CHECKING

import numpy as np

from pdfem_mpi.body.discretization import Discretization
from pdfem_mpi.body.sight import Sight
from pdfem_mpi.body.subdomain import node_owners
from pdfem_mpi.parallel.comm import broadcast
from pdfem_mpi.parallel.slabs import gather_slabs

if TYPE_CHECKING:
    from mpi4py.MPI import Intracomm


def digests_of_whole(whole: Discretization, comm: Intracomm) -> tuple[str, str]:
    """Digests of the mesh and of the body, of which rank 0 makes them. Collective."""
    return broadcast(comm, (whole.mesh.sha256(), whole.sha256()) if comm.rank == 0 else None)


def digests_in_part(sight: Sight) -> tuple[str, str]:
    """What `HexMesh.sha256` and `Discretization.sha256` are of the whole body, a slab of it at a time. Collective."""
    body, mesh, comm = sight.body, sight.body.mesh, sight.body.mesh.everywhere.comm
    own, of_mesh, of_body = mesh.everywhere.own, hashlib.sha256(), hashlib.sha256()
    nodes = node_owners(mesh, np.ones(len(own), bool), sight.owner) == comm.rank
    for number, ids, rows, n in (
        (0, mesh.node_id[nodes], mesh.nodes[nodes], sight.n_nodes),
        (1, mesh.cell_id[own], mesh.node_id[mesh.cells[own]].astype(np.int32), sight.n_cells),
        (2, mesh.cell_id[own], body.region[own], sight.n_cells),
    ):
        shape = (n, *rows.shape[1:])
        of_body.update(f"{rows.dtype.str}{shape}".encode())
        if number < 2:
            of_mesh.update(f"{shape} ".encode())
        for _, slab in gather_slabs(comm, ids, rows, n):
            if slab is not None:
                of_body.update((body.units.places(slab) if number == 0 else slab).tobytes())
                if number < 2:
                    of_mesh.update(slab.tobytes())
    return broadcast(comm, (of_mesh.hexdigest(), of_body.hexdigest()))
