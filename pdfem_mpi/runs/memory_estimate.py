"""Whether a scene fits into memory, asked before anything large is allocated.

A rank's need is counted, not guessed: its cells, ghosts and nodes are known exactly, and the rows of bonds come from a
sample of its cells whose families are searched in full. What a scene's arrays take was read off the code, what a run
takes beside them was measured on bodies of a few cells, and both together were compared with peaks of private memory
(docs/needs.md).
"""

from __future__ import annotations

import math
import platform
from dataclasses import dataclass

import numpy as np
import psutil

from pdfem_mpi.body.share import Share
from pdfem_mpi.deck.meshes import FileMesh
from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.deck.table import SceneError
from pdfem_mpi.kernels.hex8 import gauss_positions
from pdfem_mpi.parallel.comm import agree, largest, node_communicator, sum_integers
from pdfem_mpi.parallel.slabs import SLAB
from pdfem_mpi.solvers.preconditioner.nested_grids import grid_counts, halved
from pdfem_mpi.system.process_limits import Limit, group_limit, own_limit

#: Cells of a rank whose families are searched.
SAMPLE = 128
#: Bytes of a row: the place of its cluster, and four slots of one or two float32.
ROW_BYTES = {"linear": 4 + 16, "finite": 4 + 32}
#: Every rank holds the mesh: bytes of a cell that stay, and of the largest intermediate arrays while it is cut up.
CELL_BYTES, CELL_PEAK_BYTES = 190, 400
#: Intermediate arrays of a cell of the share with nodes, while loads are lumped on nodes.
NODAL_CELL_BYTES = 1700
#: Positions, weights, table, counts and correction vectors of a point, ghosts included.
POINT_BYTES = 170
#: Dilatations of a point, ghosts included, where Poisson's ratio is not 1/4: of the forces, and of a tangent twice.
DILATATION_BYTES = 25
#: Fitted weights of a row's slots in the dilatations of both ends.
WEIGHT_BYTES = 32
#: Vectors over the unknowns of a point or node while a load case is made: state, loads, one rigid mode at a time; and
#: those that stay.
MOTION_BYTES, KEPT_BYTES = 330, 130
#: Blocks, corners, weights and vectors of conjugate gradients, for a point; its intact model, for a cell; rows of the
#: rank's part of the coarse grid, for a node of it.
GRADIENT_POINT_BYTES, GRADIENT_CELL_BYTES, GRID_NODE_BYTES = 272, 676, 6_000
#: What rank 0 makes of the last grid: moments of a cell; a number of its matrix, 81 a row, with half of them as entries
#: of the band; a number of the band; and of the columns of the band that are in double precision at a time.
MOMENT_BYTES, ENTRY_BYTES, BAND_BYTES, WINDOW_BYTES = 2_600, 30, 4, 8
#: Rank 0 gathers fields a slab of cells at a time, for their digest and for checkpoints: rows as they come, in order,
#: and two of the writer's.
SLAB_CELL_BYTES = 4 * 8 * 24
#: What a run takes whatever its body is: Python's objects, and the files that are written. Fitted to cubes of 216
#: cells a rank: on one rank; more on several, for their messages; and for each other rank that one exchanges with.
OBJECT_BYTES, MESSAGE_BYTES, NEIGHBOUR_BYTES = 1.1 * 2**20, 0.2 * 2**20, 0.02 * 2**20
#: Table, vectors, blocks and multipliers of a point while bond factors are fitted.
FIT_POINT_BYTES = 1700
#: Matrix and factors of the fit's grid on every rank, for a cell with points, and at most.
FIT_GRID_CELL_BYTES, FIT_GRID_BYTES = 8_000, 2e8

#: More than a bond takes, and than a cell takes beside its bonds: what is below with these need not be counted.
MOST_BOND_BYTES, MOST_CELL_BYTES = 20, 20_000


@dataclass(frozen=True)
class Need:
    """What one rank will allocate.

    Attributes
    ----------
    bonds : float
        Undirected bonds on this rank, about.
    bytes : float
    """

    bonds: float
    bytes: float


def check_mesh(scene: Scene, n_cells: int, comm, seen: int | None = None) -> None:
    """Refuse a mesh that would not fit, before it is made or, from a file, given to all ranks. Collective.

    Parameters
    ----------
    seen : int, optional
        Cells that this rank makes; all, if not given.

    Raises
    ------
    SceneError
    """
    needed = (n_cells if seen is None else seen) * (CELL_BYTES + CELL_PEAK_BYTES)
    _refuse(scene, comm, needed, f"the mesh of {n_cells:,} cells")


def check_model(scene: Scene, share: Share, comm, held: float = 0.0) -> Need:
    """Refuse a scene whose model and solver would not fit, before they are made. Collective.

    Parameters
    ----------
    held : float
        Bytes that this rank lets go before.

    Returns
    -------
    Need
        Of this rank.

    Raises
    ------
    SceneError
        On all ranks.
    """
    need = estimate(scene, share)
    bonds = sum_integers(comm, np.array([int(need.bonds)]))[0]
    what = f"the scene with about {bonds:.2g} bonds" if bonds else "the scene"
    _refuse(scene, comm, max(need.bytes - held, 0.0), what)
    return need


def fits(scene: Scene, share: Share, comm) -> bool:
    """Whether a scene's model and solver fit into memory beside what there is. Collective."""
    try:
        check_model(scene, share, comm)
    except SceneError:
        return False
    return True


def fits_easily(share: Share, most_bonds: float) -> bool:
    """Whether a body with at most so many bonds would fit into what is free, had one rank all of it. Collective."""
    most = MOST_BOND_BYTES * most_bonds + MOST_CELL_BYTES * share.counts.cells
    limits = [limit.bytes for limit in (group_limit(), own_limit()) if limit]
    free = min([float(psutil.virtual_memory().available), *limits])
    return not largest(share.comm, np.array([float(most > free)]))[0]


def estimate(scene: Scene, share: Share) -> Need:
    """What a rank with this share will have taken at most at a time, beyond Python, libraries and kernels."""
    subdomain = share.subdomain
    cells = np.concatenate([subdomain.free, subdomain.overlap])
    rows, bonds = _count_bonds(share, cells)
    n_nodes = len(subdomain.owned_nodes) + len(subdomain.ghost_nodes)
    total = rows * ROW_BYTES[scene.kinematics] + len(share.mesh.cells) * CELL_BYTES + _apart_from_the_body(share)
    if share.found and share.found.before and share.comm.size > 1:
        total += share.counts.cells * CELL_BYTES  # the body without bonds
    n_cells = len(cells) + len(subdomain.ghosts) + len(subdomain.images)
    total += (8 * n_cells + 0.5 * n_nodes) * POINT_BYTES
    if bonds and scene.has_volumetric_part:
        fitted = scene.peridynamics.surface_correction == "fitted"
        total += 8 * n_cells * DILATATION_BYTES + rows * (WEIGHT_BYTES if fitted else 0)
    places = 8 * len(subdomain.free) + len(subdomain.owned_nodes)
    later = places * MOTION_BYTES + np.count_nonzero(share.has_nodes) * NODAL_CELL_BYTES
    gathers = share.comm.rank == 0 < share.comm.size - 1
    slab = SLAB_CELL_BYTES * min(share.counts.point_cells, SLAB) if gathers else 0
    if scene.has_cycle:
        solver = places * KEPT_BYTES + 8 * len(subdomain.free) * GRADIENT_POINT_BYTES
        solver += (len(cells) + len(subdomain.elements)) * GRADIENT_CELL_BYTES
        later = max(later, solver + max(_of_coarse_grid(share), slab))  # one after the other
    else:
        later += slab
    fit = 0.0
    if bonds and scene.peridynamics.surface_correction == "fitted":
        fit = 8 * (len(cells) + len(subdomain.ghosts)) * FIT_POINT_BYTES
        fit += min(FIT_GRID_BYTES, FIT_GRID_CELL_BYTES * share.counts.point_cells)
    return Need(bonds, total + max(later, fit))  # one after the other


def _apart_from_the_body(share: Share) -> float:
    """Bytes of a rank's objects and messages, which depend on no size of the body but on how many ranks are near."""
    if share.comm.size == 1:
        return OBJECT_BYTES
    others = np.unique(np.concatenate([share.subdomain.ghost_owner, share.subdomain.ghost_node_owner]))
    return OBJECT_BYTES + MESSAGE_BYTES + len(others) * NEIGHBOUR_BYTES


def _of_coarse_grid(share: Share) -> float:
    """Bytes of a rank's part of the coarse grid: of the levels that are dealt out as of the body, and of the last."""
    counts, n_halvings = grid_counts(share)
    part = np.count_nonzero(share.is_owned) / share.counts.cells
    dealt_out = sum(float(np.prod(halved(counts, k) + 1)) for k in range(n_halvings))
    last = _of_last_grid(halved(counts, n_halvings)) if share.comm.rank == 0 else 0.0
    return part * dealt_out * GRID_NODE_BYTES + last


def _of_last_grid(counts: np.ndarray) -> float:
    """Bytes while the last grid is made: of the moments of its cells, its matrix and the band of its factor."""
    n_cells, nodes = float(np.prod(counts)), np.sort(counts + 1)
    unknowns = 3.0 * float(np.prod(nodes))
    # from a node to the last one beside it, the longest axis outermost
    reach = 3.0 * float(nodes[0] * nodes[1] + nodes[0] + 2)
    window = 2.0 * reach * reach * WINDOW_BYTES
    return n_cells * MOMENT_BYTES + unknowns * (81 * ENTRY_BYTES + reach * BAND_BYTES) + window


def _count_bonds(share: Share, cells: np.ndarray) -> tuple[float, float]:
    """Rows and bonds of some cells' points: those of a sample, times the cells it stands for.

    Half the rows of a cell against others and images are its own, and so are half of its bonds with them. Within a cell
    each of 28 bonds is counted once, in 10 rows.
    """
    if not len(cells):
        return 0.0, 0.0
    sample = cells[np.linspace(0, len(cells) - 1, min(SAMPLE, len(cells))).astype(np.int64)]
    mesh, nodes, subdomain = share.mesh, share.nodes, share.subdomain
    half_edges = 0.5 * mesh.largest_edge / share.units.length * math.sqrt(3.0)
    with_points = subdomain.point_cells
    sign, shift = (
        np.concatenate([np.full((len(with_points) - len(subdomain.images), 3), same), rows[subdomain.reflection - 1]])
        for same, rows in zip((1.0, 0.0), share.reflections, strict=True)
    )
    n_real = len(with_points) - len(subdomain.images)
    centroids = (mesh.centroids - share.units.origin) / share.units.length
    centres = sign * centroids[with_points] + shift
    reach = share.cutoff + 2.0 * half_edges
    rows = bonds = 0
    for cell in sample:
        found = np.flatnonzero(np.abs(centres[:, 0] - centroids[cell, 0]) <= reach)
        found = found[((centres[found] - centroids[cell]) ** 2).sum(axis=1) <= reach**2]
        others = np.array([other for other in found if other >= n_real or with_points[other] != cell], np.int64)
        others = others[share.body[with_points[others]] == share.body[cell]]
        x = gauss_positions(nodes[mesh.cells[[cell]]]).reshape(8, 3).T[:, :, None]
        y = gauss_positions(nodes[mesh.cells[with_points[others]]])
        y = np.ascontiguousarray((sign[others, None] * y + shift[others, None]).reshape(-1, 3).T)[:, None]
        family = ((y - x) ** 2).sum(axis=0) <= share.cutoff**2
        bonds += np.count_nonzero(family)
        rows += np.count_nonzero(family.reshape(8, -1, 4).any(axis=2))
    scale = len(cells) / len(sample)
    return (0.5 * rows + 10 * len(sample)) * scale, (0.5 * bonds + 28 * len(sample)) * scale


def _refuse(scene: Scene, comm, needed: float, what: str) -> None:
    """Compare the needs of a node's ranks with the memory that they may still take. Collective.

    What is free, and what a container or job allows, are shared by all; limits of a process are its own.
    """
    node = node_communicator(comm)
    whole = float(sum_integers(node, np.array([math.ceil(needed)]))[0])
    most = float(largest(node, np.array([needed]))[0])
    free = Limit(float(psutil.virtual_memory().available), "")
    shared = min(free, group_limit() or free)
    available = -float(largest(node, np.array([-shared.bytes]))[0])
    first, ranks = node.rank == 0, node.size
    node.Free()
    messages = []
    own = own_limit()
    if own and needed > own.bytes:
        messages = [_too_large(scene, what, needed, "", own)]
    elif whole > available and first:
        shares = f" for {ranks} ranks, {show_bytes(most)} for the largest" if ranks > 1 else ""
        messages = [_too_large(scene, what, whole, shares, Limit(available, shared.what))]
    if messages := agree(comm, messages):
        raise SceneError(messages)


def _too_large(scene: Scene, what: str, needed: float, shares: str, limit: Limit) -> str:
    """A sentence about a scene that needs more than a limit leaves."""
    is_file = isinstance(scene.mesh, FileMesh)
    mesh = f"mesh.path = {scene.mesh.path}" if is_file else f"mesh.spacing = {scene.mesh.spacing:g}"
    where = limit.what or platform.node() or "this computer"
    remedy = ", raise the limit" if limit.what else ""
    return (
        f"{mesh} does not fit into memory: {what} needs {show_bytes(needed)}{shares}, and {where} has "
        f"{show_bytes(limit.bytes)} available. Use larger cells, a smaller peridynamic region{remedy}, or more "
        "computers."
    )


def show_bytes(n: float) -> str:
    """A number of bytes in MiB or GiB."""
    return f"{n / 2**30:.1f} GiB" if n >= 2**30 else f"{n / 2**20:.0f} MiB"
