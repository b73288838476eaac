"""Each rank's share, cut out of the whole body or out of what the rank sees of it."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import suppress
from typing import TYPE_CHECKING

import numpy as np

from pdfem_mpi.body.boundaries import Boundaries
from pdfem_mpi.body.counts import Counts, count
from pdfem_mpi.body.digests import digests_in_part, digests_of_whole
from pdfem_mpi.body.discretization import Discretization, discretize, number_among
from pdfem_mpi.body.found_region import Turning, WholeRegion, cut_around, turn
from pdfem_mpi.body.overlap import describe_cracked_elements, describe_cracked_overlap
from pdfem_mpi.body.partitioning import count_neighbours, partition
from pdfem_mpi.body.probing import place_probes
from pdfem_mpi.body.selection import select_places
from pdfem_mpi.body.share import Share
from pdfem_mpi.body.sight import Sight, is_seen_in_part, see, surroundings
from pdfem_mpi.body.softening_cells import cube_edges, softening_cells
from pdfem_mpi.body.subdomain import by_places, cut_out, node_owners
from pdfem_mpi.body.surface import surface_near
from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.mesh.doubled import doubled_faces
from pdfem_mpi.mesh.everywhere import SeenInPart
from pdfem_mpi.mesh.hexmesh import HexMesh
from pdfem_mpi.mesh.part import MeshPart, take_part
from pdfem_mpi.mesh.pieces import block_of

if TYPE_CHECKING:
    from mpi4py.MPI import Intracomm

#: What a share has of each cell of the whole body.
OF_CELLS = ("region", "material", "is_peridynamic", "has_points", "is_overlap", "has_stiffness", "body")


def share_of(
    scene: Scene,
    comm: Intracomm,
    mesh: HexMesh | None = None,
    turning: Turning | None = None,
    before_whole: Callable[[], None] | None = None,
    before: Share | None = None,
) -> Share:
    """This rank's share of a scene's body, see `discretize`, with cells that are turned, see `turn`. Collective.

    Parameters
    ----------
    before_whole : callable, optional
        Called before every rank makes a whole body of which it should see a part: something is wrong with it.
    before : Share, optional
        Of the same scene, with bonds elsewhere.

    Raises
    ------
    SceneError
        All that `discretize` refuses; more ranks than cells.
    """
    if mesh is None and is_seen_in_part(scene, comm):
        with suppress(SeenInPart):
            sight = see(scene, comm)
            return _cut(scene, comm, sight.body, sight.owner, sight=sight)
        if before_whole:
            before_whole()
    known = before.found.before if before else None
    whole = known.elements if known else discretize(scene, mesh, comm)
    if not scene.is_adaptive:
        return make_share(scene, whole, comm)
    region = turn(scene, whole, turning, comm.size, known)
    return make_share(scene, region.whole, comm, region)


def cells_seen(scene: Scene, comm: Intracomm) -> int:
    """Cells of a mesh that is made which this rank will make at a time, about: its own, and those around them."""
    n_cells = math.prod(scene.mesh.n_cells)
    if not is_seen_in_part(scene, comm):
        return n_cells
    ends = np.array([scene.mesh.lower, scene.mesh.upper])
    block = np.clip(block_of(*ends, comm.rank, comm.size), *ends)
    sides = np.minimum(block[1] - block[0] + 2.0 * surroundings(scene), ends[1] - ends[0])
    return math.ceil(float(np.prod(sides / scene.mesh.spacing)))


def make_share(scene: Scene, whole: Discretization, comm: Intracomm, region: WholeRegion | None = None) -> Share:
    """Cut a rank's share out of the whole body. Collective.

    Parameters
    ----------
    region : WholeRegion, optional
        Of the whole body, where the run finds where bonds are needed.

    Raises
    ------
    SceneError
        More ranks than cells.
    """
    return _cut(scene, comm, whole, partition(whole, comm.size, count_neighbours(whole, comm)), region)


def _cut(
    scene: Scene,
    comm: Intracomm,
    body: Discretization,
    owner: np.ndarray,
    region: WholeRegion | None = None,
    sight: Sight | None = None,
) -> Share:
    """The share of a rank that sees the whole body, or what its cells depend on. Collective."""
    found = cut_out(body, owner, comm.rank)
    seen = body.mesh.neighbours(owner == comm.rank)
    seen[found.ghosts] = True
    around = cut_around(body, owner, comm.rank) if region else None
    if around:
        seen[around.ghosts] = True
    mesh = take_part(body.mesh, seen)
    everywhere = body.mesh.everywhere
    centred = body.units.places(np.array([body.mesh.lower, body.mesh.upper]))
    sha256 = digests_of_whole(body, comm) if sight is None else digests_in_part(sight)

    def of_cells(values: np.ndarray) -> np.ndarray:
        return values if len(mesh.cells) == len(values) else values[seen]

    def regions_of(cells: np.ndarray) -> np.ndarray:
        chosen = body.region[everywhere.mine(cells)]
        return np.flatnonzero(everywhere.total(*np.bincount(chosen, minlength=len(scene.regions))))

    return Share(
        comm=comm,
        mesh=mesh,
        subdomain=by_places(found, body.mesh, mesh),
        cell_owner=of_cells(owner),
        units=body.units,
        nodes=body.nodes if len(mesh.nodes) == len(body.nodes) else body.units.places(mesh.nodes),
        lower=centred[0],
        upper=centred[1],
        materials=body.materials,
        **{name: of_cells(getattr(body, name)) for name in OF_CELLS},
        **_rows(body, mesh, of_cells, sight),
        cutoff=body.cutoff,
        mirrors=body.mirrors,
        reflections=body.reflections,
        **_faces(scene, body, owner == comm.rank, region is not None),
        counts=_count(body, sight),
        typical_edge=_typical_edge(body),
        softening_cells=softening_cells(scene, body, region.rows.can_turn if region else None),
        joint_regions=regions_of(body.is_peridynamic & body.is_overlap),
        overlap_regions=regions_of(body.is_overlap),
        quality=body.quality,
        notes=body.notes,
        crack_notes=tuple(_crack_notes(scene, body, region)),
        mesh_sha256=sha256[0],
        body_sha256=sha256[1],
        probes=place_probes(scene, body),
        selections=select_places(scene, body).part(mesh),
        boundaries=Boundaries.of(scene, body, mesh),
        found=region.rows.part(mesh, by_places(around, body.mesh, mesh)) if region else None,
    )


def _crack_notes(scene: Scene, body: Discretization, region: WholeRegion | None) -> Iterator[str]:
    """What a user should know of initial cracks through cells whose points follow nodes, or that have none."""
    yield from describe_cracked_overlap(scene, body)
    if region is None or not scene.cracks:
        return
    may_have_bonds = region.rows.can_turn
    for _ in range(scene.adaptive.buffer_layers):
        may_have_bonds = body.mesh.neighbours(may_have_bonds)
    yield from describe_cracked_elements(scene, body, may_have_bonds)


def _rows(body: Discretization, mesh: MeshPart, of_cells: Callable, sight: Sight | None) -> dict[str, np.ndarray]:
    """Numbers of cells and nodes of the share among those of a kind of the whole body. Collective."""
    if sight is None:
        rows, nodes = {name: of_cells(number_among(cells)) for name, cells in body.numbered.items()}, body.node_row
        return rows | {"node_row": nodes if len(mesh.nodes) == len(nodes) else nodes[mesh.node_id]}
    rows = {name: sight.rows_of_cells(cells, mesh.cell_id) for name, cells in body.numbered.items()}
    return rows | {"node_row": sight.rows_of_nodes(body.has_nodes, mesh.node_id)}


def _count(body: Discretization, sight: Sight | None) -> Counts:
    """Sizes of the whole body. Collective, if each rank sees a part of it."""
    if sight is None:
        return count(body, body.n_nodes, len(body.mesh.nodes))
    everywhere = body.mesh.everywhere
    owner_of_node = node_owners(body.mesh, body.has_nodes, sight.owner)
    (nodes,) = everywhere.total(np.count_nonzero(owner_of_node == everywhere.comm.rank))
    return count(body, nodes, sight.n_nodes)


def _faces(scene: Scene, body: Discretization, mine: np.ndarray, turnable: bool) -> dict[str, np.ndarray]:
    """Faces at one place, where the deck keeps them as a crack, and the surface near some cells, bool (n_cells,)."""
    doubled = np.empty((0, 4, 3))
    if getattr(scene.mesh, "doubled_nodes", "refuse") == "crack":
        doubled = (doubled_faces(body.mesh)[0] - body.units.origin) / body.units.length
    return {"doubled": doubled, "surface": surface_near(scene, body, mine, turnable)}


def _typical_edge(body: Discretization) -> float:
    """Median over the body of the edges of cells, taken as cubes; model units. Collective, if ranks see parts."""
    everywhere = body.mesh.everywhere
    return everywhere.median(cube_edges(body.nodes, everywhere.rows(body.mesh.cells)))
