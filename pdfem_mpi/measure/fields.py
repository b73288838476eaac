"""Displacements of the whole body, gathered on rank 0 in global order and in the deck's units."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from pdfem_mpi.body.share import Share
from pdfem_mpi.measure.field_values import gather_mechanics
from pdfem_mpi.measure.recovered import Recovered
from pdfem_mpi.model.forces import Forces
from pdfem_mpi.model.model import Model
from pdfem_mpi.model.thermal import Thermal
from pdfem_mpi.parallel.slabs import gather_rows, gather_slabs
from pdfem_mpi.peridynamics.damage import Remaining, local_damage, softened_and_gone
from pdfem_mpi.peridynamics.failure import Failure

if TYPE_CHECKING:
    from pdfem_mpi.measure.probed import ProbeReader


@dataclass(frozen=True)
class Fields:
    """Displacements of all points and nodes; None for a part the scene does not have.

    Attributes
    ----------
    u_points : float64, shape (n_points, 3), dimension length
        Cells with points in the order of the mesh, the overlap included; eight points each.
    u_nodes : float64, shape (n_nodes, 3), dimension length
        Nodes of elements and overlap, in the order of the mesh.
    of_points, of_cells : dict of float64 arrays
        What was asked for beside them, by name; see `field_values.gather_mechanics`.
    probed : dict
        What the mechanical probes found, by their names.
    """

    u_points: np.ndarray | None
    u_nodes: np.ndarray | None
    of_points: dict[str, np.ndarray] = field(default_factory=dict)
    of_cells: dict[str, np.ndarray] = field(default_factory=dict)
    probed: dict[str, Any] = field(default_factory=dict)


def gather_fields(
    share: Share,
    forces: Forces,
    u: np.ndarray,
    names: Iterable[str] = (),
    reader: ProbeReader | None = None,
    thermal: Thermal | None = None,
) -> Fields | None:
    """Collect the displacements at the forces' last evaluation; None except on rank 0. Collective.

    Parameters
    ----------
    u : float64, shape (n_unknowns,)
        The displacements of that evaluation, model units.
    names : of `MECHANICAL_FIELDS` and `GAUSS_FIELDS`
        What else is wanted.
    reader : ProbeReader, optional
        Of mechanical probes that are wanted.
    thermal : Thermal, optional
        At the load of that evaluation.
    """
    model, length = forces.model, share.units.length
    u_points = u_nodes = None
    if model.points:
        rows = forces.point_displacements().reshape(-1, 8, 3)
        gathered = gather_rows(model.comm, share.own_point_rows, rows, share.counts.point_cells)
        u_points = None if gathered is None else gathered.reshape(-1, 3) * length
    if model.nodes:
        rows = model.unknowns.of_nodes(u)
        gathered = gather_rows(model.comm, share.own_node_rows, rows, share.counts.nodes)
        u_nodes = None if gathered is None else gathered * length
    recovered = Recovered(share, forces, thermal)
    more = gather_mechanics(recovered, names)
    probed = reader.read(recovered, u) if reader else {}
    return Fields(u_points, u_nodes, *more, probed) if model.comm.rank == 0 else None


@dataclass(frozen=True)
class NodalForces:
    """Forces on all points and nodes, in the order of `Fields`; None for a part the scene does not have.

    Attributes
    ----------
    points : float64, shape (n_points, 3), dimension force
    nodes : float64, shape (n_nodes, 3), dimension force
    """

    points: np.ndarray | None
    nodes: np.ndarray | None


def gather_forces(share: Share, model: Model, force: np.ndarray) -> NodalForces | None:
    """Collect forces over the unknowns, shape (n_unknowns,), model units; None except on rank 0. Collective."""
    of_points = of_nodes = None
    if model.points:
        rows = np.zeros((model.points.n_owned, 8, 3))
        rows[: model.points.n_free] = model.unknowns.rows(force)[: model.unknowns.n_points].reshape(-1, 8, 3)
        of_points = gather_rows(model.comm, share.own_point_rows, rows, share.counts.point_cells)
    if model.nodes:
        of_nodes = gather_rows(model.comm, share.own_node_rows, model.unknowns.of_nodes(force), share.counts.nodes)
    if model.comm.rank > 0:
        return None
    unit = share.units.force
    return NodalForces(
        None if of_points is None else of_points.reshape(-1, 3) * unit, None if of_nodes is None else of_nodes * unit
    )


def gather_damage(
    share: Share,
    model: Model,
    remaining: Remaining | None = None,
    failure: Failure | None = None,
    parts: bool = False,
) -> np.ndarray | None:
    """Local damage (eq. 5) of all points in global order; None except on rank 0, or if not asked for. Collective.

    Parameters
    ----------
    remaining : Remaining, optional
        Of the calls before: without it all bonds are swept.
    failure : Failure, optional
        Its books say which bonds broke since the last call; without it none did.
    parts : bool
        Where bonds soften, also the shares of those that have softened, and that are gone.

    Returns
    -------
    float64, shape (n_points,) or, with parts, (n_points, 3), dimension 1
    """
    if model.intact_weights is None:
        return None
    body = model.comm, model.points, model.bonds
    now = None
    if remaining is not None:
        now = remaining.without(*body, failure.take_pairs() if failure else np.empty((0, 2), np.int64))
    rows = local_damage(*body, model.intact_weights, now)
    parts = parts and model.bonds.softened is not None
    if parts:
        rows = np.concatenate([rows[:, :, None], softened_and_gone(*body, model.intact_weights, now)], axis=2)
    gathered = gather_rows(model.comm, share.own_point_rows, rows, share.counts.point_cells)
    if gathered is None:
        return None
    return gathered.reshape(-1, 3) if parts else gathered.reshape(-1)


def fields_sha256(fields: Fields) -> str:
    """Digest of the displacement fields: equal on any number of ranks if and only if their bits are."""
    total = hashlib.sha256()
    for array in (fields.u_points, fields.u_nodes):
        if array is not None:
            total.update(f"{array.shape}".encode() + array.tobytes())
    return total.hexdigest()


def digest_fields(share: Share, forces: Forces, u: np.ndarray) -> str | None:
    """`fields_sha256` of what `gather_fields` would collect, a slab at a time; None except on rank 0. Collective."""
    model, length = forces.model, share.units.length
    total = hashlib.sha256()
    parts = []
    if model.points:
        n_cells = share.counts.point_cells
        parts.append((share.own_point_rows, forces.point_displacements().reshape(-1, 8, 3), n_cells, (8 * n_cells, 3)))
    if model.nodes:
        rows = model.unknowns.of_nodes(u)
        n_nodes = share.counts.nodes
        parts.append((share.own_node_rows, rows, n_nodes, (n_nodes, 3)))
    for ids, rows, n, shape in parts:
        total.update(f"{shape}".encode())
        for _, slab in gather_slabs(model.comm, ids, rows, n):
            if slab is not None:
                slab *= length
                total.update(slab)
    return total.hexdigest() if model.comm.rank == 0 else None
