"""The unknowns as tables in global order: from the ranks to a checkpoint, and back to any number of ranks."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from pdfem_mpi.body.share import Share
from pdfem_mpi.model.model import Model
from pdfem_mpi.model.state import State
from pdfem_mpi.parallel.comm import broadcast, sum_integers
from pdfem_mpi.parallel.slabs import gather_pairs, gather_slabs, scatter_slabs
from pdfem_mpi.peridynamics.clusters import cluster_layout, point_rows
from pdfem_mpi.system import faults

if TYPE_CHECKING:
    from pdfem_mpi.results.checkpoint import Reader, Writer

BROKEN, TURNED = "broken", "turned"
#: Pairs that rank 0 reads at a time.
PAIRS = 1 << 18


@dataclass(frozen=True)
class Layout:
    """Which rows of the tables are this rank's.

    Attributes
    ----------
    n_cells, n_nodes : int
        Cells with free points, and nodes with unknowns, of the whole body.
    n_points : int
        Eight times the cells of the mesh: the lower ids of bonds are below it.
    columns : int
        Of the table of broken bonds: two ids, and a tooth where bonds soften.
    cells, nodes : int64
        Global numbers of this rank's, in the order of its unknowns.
    """

    n_cells: int
    n_nodes: int
    n_points: int
    cells: np.ndarray
    nodes: np.ndarray
    columns: int

    def tables(self, n_broken: int, wide: bool, fields: Iterable[str]) -> dict[str, tuple[int, int, np.dtype]]:
        """Names, rows, columns and types of all tables of a file; ``wide``: ids of broken bonds need 64 bits."""
        double = np.dtype("<f8")
        names = tuple(fields)
        tables = {f"points/{name}": (8 * self.n_cells, 3, double) for name in names}
        tables |= {f"nodes/{name}": (self.n_nodes, 3, double) for name in names}
        return tables | {BROKEN: (n_broken, self.columns, np.dtype("<u8" if wide else "<u4"))}


def make_layout(share: Share, columns: int = 2) -> Layout:
    """Which rows are this rank's: cells with free points, and nodes with unknowns, in the order of the mesh.

    ``columns`` are those of broken bonds, see `columns_of_broken`.
    """
    counts = share.counts
    return Layout(
        n_cells=counts.free_cells,
        n_nodes=counts.nodes,
        n_points=8 * counts.cells,
        cells=share.free_row[share.subdomain.free],
        nodes=share.own_node_rows,
        columns=columns,
    )


def turned_cells(share: Share) -> np.ndarray | None:
    """Numbers of the cells that a run has turned into bonds by itself, int64; None where the deck says which are."""
    return share.found.turned if share.found else None


def columns_of_broken(model: Model) -> int:
    """Columns of the table of broken bonds: two ids and, where bonds soften, a tooth."""
    return 3 if model.bonds and model.bonds.softened else 2


def write_tables(
    model: Model,
    layout: Layout,
    fields: dict[str, np.ndarray],
    broken: np.ndarray,
    writer: Writer | None,
) -> None:
    """Gather the unknowns and broken bonds a slab at a time, and write them. Collective.

    Parameters
    ----------
    fields : dict of float64 arrays, shape (n_unknowns,)
        Those of the state.
    broken : int64, shape (n, layout.columns)
        Global ids ``i < j`` of the broken bonds that this rank computes, each bond on one rank; their teeth.
    writer : Writer or None
        Rank 0's, which keeps its errors to itself.
    """
    unknowns = model.unknowns
    for k, (name, values) in enumerate(fields.items()):
        points = point_rows(unknowns.of_points(values)).reshape(-1, 8, 3)
        for first, slab in gather_slabs(model.comm, layout.cells, points, layout.n_cells):
            if writer:
                writer.write_rows(f"points/{name}", 8 * first, slab.reshape(-1, 3))
        if k == len(fields) // 2:
            faults.begin("write")
        for first, slab in gather_slabs(model.comm, layout.nodes, unknowns.of_nodes(values), layout.n_nodes):
            if writer:
                writer.write_rows(f"nodes/{name}", first, slab)
    done = 0
    for pairs in gather_pairs(model.comm, broken, layout.n_points):
        if writer:
            writer.write_rows(BROKEN, done, pairs)
            done += len(pairs)


def total_broken(model: Model, broken: np.ndarray) -> tuple[int, bool]:
    """Number of broken bonds on all ranks, and whether an id of theirs needs 64 bits. Collective."""
    wide = bool((broken >= 2**32).any())
    total, wides = sum_integers(model.comm, np.array([len(broken), wide]))
    return int(total), bool(wides)


def read_fields(model: Model, layout: Layout, state: State, reader: Reader | None) -> None:
    """Fill the fields that the state has, wherever their rows were when they were written. Collective.

    Raises
    ------
    OSError
        On all ranks.
    """
    unknowns = model.unknowns
    for name, values in state.fields.items():

        def points(first, last, name=f"points/{name}"):
            return reader.read_rows(name, 8 * first, 8 * last).reshape(-1, 8, 3)

        def nodes(first, last, name=f"nodes/{name}"):
            return reader.read_rows(name, first, last)

        rows = scatter_slabs(model.comm, layout.cells, layout.n_cells, points, np.empty((0, 8, 3)))
        unknowns.of_points(values)[:] = cluster_layout(rows)
        rows = scatter_slabs(model.comm, layout.nodes, layout.n_nodes, nodes, np.empty((0, 3)))
        unknowns.of_nodes(values)[:] = rows


def read_broken(share: Share, model: Model, reader: Reader | None, schema: int) -> np.ndarray:
    """Broken bonds with an end in a cell of this rank, int64, shape (n, columns); one may be on two ranks. Collective.

    Parameters
    ----------
    schema : int
        Of the checkpoint: ids of schema 1 count cells with points, see `renumber`.

    Raises
    ------
    OSError
        On all ranks.
    """
    comm = model.comm
    total, columns = broadcast(comm, reader.shape(BROKEN) if reader else (0, 0))
    if not total or not model.points:
        return np.empty((0, columns), np.int64)
    own_cells = model.points.cell_number[: model.points.n_owned]
    owned = np.sort(share.own_point_rows if schema == 1 else own_cells)

    def ours(ids):
        return np.isin(ids // 8, owned)

    found = []
    for first in range(0, total, PAIRS):
        pairs, message = np.empty((min(PAIRS, total - first), columns), np.int64), None
        if reader:
            try:
                pairs[:] = reader.read_rows(BROKEN, first, first + len(pairs))
            except (OSError, RuntimeError) as error:
                message = str(error)
        if message := broadcast(comm, message):
            raise OSError(message)
        comm.Bcast(pairs)
        found.append(pairs[ours(pairs[:, 0]) | ours(pairs[:, 1])])
    pairs = np.concatenate(found)
    if schema == 1:
        pairs[:, :2] = renumber(pairs[:, :2], share)
    return pairs


def renumber(ids: np.ndarray, share: Share) -> np.ndarray:
    """Ids of points that this rank sees, from counts over the cells with points to numbers in the mesh.

    Checkpoints of schema 1 have the former; an image's cell is counted on by the number of all of them for each
    reflection. A point that the rank does not see gets an id that no point has.
    """
    number, point = np.divmod(ids, 8)
    reflection, row = np.divmod(number, share.counts.point_cells)
    order = np.argsort(share.point_row, kind="stable")
    place = np.minimum(np.searchsorted(share.point_row, row, sorter=order), len(order) - 1)
    cell = order[place]
    known = share.point_row[cell] == row
    found = 8 * (share.mesh.cell_id[cell] + share.counts.cells * reflection) + point
    return np.where(known, found, -1)
