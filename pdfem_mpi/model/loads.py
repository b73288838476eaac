"""Loads and supports of a deck as vectors over the unknowns, and the rigid motions they leave free.

All vectors are in model units, at load factor 1. Nodal loads are summed on the global mesh in the order of cells,
so every rank finds the same bits.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from pdfem_mpi.body.discretization import Discretization
from pdfem_mpi.deck.loads import BodyForce, Traction
from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.deck.table import SceneError
from pdfem_mpi.kernels.hex8 import SHAPE_AT_GAUSS, gauss_volumes
from pdfem_mpi.kernels.simd import W
from pdfem_mpi.mesh import named_sets
from pdfem_mpi.mesh.rigid_motions import write_rigid_motion
from pdfem_mpi.model.model import Model
from pdfem_mpi.model.parts import Loose, Parts, find_loose, find_parts, settle, unbalanced, without_equilibrium
from pdfem_mpi.parallel.comm import sum_integers
from pdfem_mpi.parallel.sums import exact_dots
from pdfem_mpi.peridynamics.clusters import by_component, cluster_layout
from pdfem_mpi.peridynamics.fit.areas import face_shares

#: Loads work on a free rigid motion when this fraction of their absolute work is left over.
BALANCE_TOLERANCE = 1e-9
#: A rigid motion is free when the supports keep less than this fraction of what they keep of the best held one.
HELD = 1e-9

_FACE_POINTS = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) / math.sqrt(3.0)
_FACE_NODES = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])


@dataclass(frozen=True)
class LoadCase:
    """External forces and prescribed displacements at load factor 1.

    Attributes
    ----------
    external : float64, shape (n_unknowns,), dimension force
    fixed : bool, shape (n_unknowns,)
        Unknowns with a prescribed displacement, those normal to mirror planes included.
    prescribed : float64, shape (n_unknowns,), dimension length
        Their displacements; 0 elsewhere.
    volume : float64, shape (n_unknowns,), dimension length^3, or None
        Share of the body's volume that each unknown stands for, where some motion is free.
    free_motions : float64, shape (n_modes, 6)
        Rigid motions that no support and no mirror plane holds, as combinations of `rigid_modes`.
    rigid_gram : float64, shape (6, 6)
        Products of the rigid modes over the body's volume; empty where no motion is free.
    parts : Parts
        Which unknowns hang together.
    loose : tuple of Loose
        Parts with motions of their own that no support holds; empty for a body in one piece.
    held : tuple of three int64 arrays, for each support
        Unknowns that it prescribes along x, y and z.
    moves : tuple of bool
        Supports that prescribe something else than 0.
    reach : float, dimension length
        Largest prescribed displacement.
    load : float, dimension force
        Resultant of the external forces that push one way (those along the axes, or those against them).
    taken : float64, shape (3,), dimension force
        Sums of the forces along x, y and z that loads put on held places, where supports take them at once; NaN where
        there are none.
    """

    external: np.ndarray
    fixed: np.ndarray
    prescribed: np.ndarray
    volume: np.ndarray | None
    free_motions: np.ndarray
    rigid_gram: np.ndarray
    parts: Parts
    loose: tuple[Loose, ...]
    held: tuple[tuple[np.ndarray, ...], ...]
    moves: tuple[bool, ...]
    reach: float
    load: float
    taken: np.ndarray


def make_load_case(scene: Scene, discretization: Discretization, model: Model) -> LoadCase:
    """Assemble the deck's loads and supports for this rank, and check that free motions are balanced. Collective.

    Raises
    ------
    SceneError
        Selections without cells or nodes, tractions on peridynamic cells, supports that contradict each other,
        loads that are not in balance along a motion no support holds.
    """
    messages: list[str] = []
    on_cells = np.zeros((len(discretization.mesh.cells), 3))  # body force density
    on_nodes = np.zeros((len(discretization.nodes), 3))
    on_points = np.zeros((len(discretization.mesh.cells), 8, 3))  # forces
    fitted = scene.peridynamics.surface_correction == "fitted"
    for index, load in enumerate(scene.loads):
        try:
            if isinstance(load, BodyForce):
                on_cells += _density(discretization, load, f"loads.{index}", scene)
            else:
                nodal, of_points = _traction(discretization, load, f"loads.{index}", fitted)
                on_nodes += nodal
                on_points += of_points
        except SceneError as error:
            messages += error.messages
    prescription = _prescriptions(scene, discretization, messages)
    if messages:
        raise SceneError(messages)

    _lump_on_nodes(discretization, on_cells, on_nodes)
    on_free_points = _point_forces(discretization, model, on_cells)
    if model.points and fitted:
        on_free_points += cluster_layout(on_points[model.subdomain.free])
    external = _join(model, on_free_points, on_nodes)
    amounts, holders = (
        _join(model, _pick_points(discretization, model, on_cells), on_nodes) for on_cells, on_nodes in prescription
    )
    del on_free_points, prescription
    fixed = ~np.isnan(amounts)
    prescribed = np.zeros(model.n_unknowns)
    prescribed[fixed] = amounts[fixed]
    held = tuple(
        tuple(np.flatnonzero((holders == k) & (model.unknowns.components() == d)) for d in range(3))
        for k in range(len(scene.supports))
    )
    del amounts, holders
    taken = _on_held(model, external, fixed)
    external[fixed] = 0.0
    free, parts = free_motions(model, fixed), find_parts(model)
    loose = find_loose(model, parts, fixed) if parts.count > 1 else ()
    volume = _volume(discretization, model) if len(free) or loose else None
    case = LoadCase(
        external=external,
        fixed=fixed,
        prescribed=prescribed,
        volume=volume,
        free_motions=free,
        rigid_gram=_gram(model, volume, rigid_modes(model)) if len(free) else np.empty((0, 0)),
        parts=parts,
        loose=loose,
        held=held,
        moves=tuple(any((s.x, s.y, s.z)) for s in scene.supports),
        reach=max((abs(a) for s in scene.supports for a in (s.x, s.y, s.z) if a), default=0.0)
        / discretization.units.length,
        load=_one_way(model, external),
        taken=taken,
    )
    _check_balance(model, case)
    if messages := unbalanced(model, parts, loose, external):
        raise SceneError(messages)
    return case


def without_loads_on_loose_parts(model: Model, case: LoadCase) -> tuple[LoadCase, list[Loose]]:
    """The load case less the loads of parts that no equilibrium holds now; those parts. Collective."""
    rows, parts = without_equilibrium(model, case.fixed, case.external)
    external = np.where(rows, 0.0, case.external)
    return replace(case, external=external, load=_one_way(model, external)), parts


def _volume(discretization: Discretization, model: Model) -> np.ndarray:
    """Share of the body's volume that each unknown stands for; float64, shape (n_unknowns,)."""
    ones = np.ones((len(discretization.mesh.cells), 3))
    on_nodes = np.zeros((len(discretization.nodes), 3))
    _lump_on_nodes(discretization, ones, on_nodes)
    return _join(model, _point_forces(discretization, model, ones), on_nodes)


def _on_held(model: Model, external: np.ndarray, fixed: np.ndarray) -> np.ndarray:
    """Sums along x, y and z of forces on held unknowns, NaN where no load is; float64, shape (3,). Collective."""
    along, force = model.unknowns.components()[fixed], external[fixed]
    parts = [np.where(along == d, force, 0.0) for d in range(3)]
    ones = np.ones_like(force)
    sums = exact_dots(model.comm, [(values, ones) for part in parts for values in (part, np.abs(part))]).reshape(3, 2)
    return np.where(sums[:, 1] > 0.0, sums[:, 0], np.nan)


def _one_way(model: Model, external: np.ndarray) -> float:
    along = (model.unknowns.along(external, d) for d in range(3))
    ways = (np.maximum(sign * forces, 0.0) for forces in along for sign in (1.0, -1.0))
    sums = exact_dots(model.comm, ((way, np.ones_like(way)) for way in ways)).reshape(3, 2).T
    return max(math.sqrt(x * x + y * y + z * z) for x, y, z in sums.tolist())


def rigid_modes(model: Model, u: np.ndarray | None = None) -> Iterator[np.ndarray]:
    """Yield three translations and three rotations about the origin of the body displaced by ``u``; (n_unknowns,)."""
    unknowns, places = model.unknowns, []
    if model.points:
        places.append((lambda v: by_component(unknowns.of_points(v)), by_component(unknowns.of_points(model.points.x))))
    if model.nodes:
        places.append((unknowns.of_nodes, model.nodes.x[: model.nodes.n_owned]))
    if u is not None:
        places = [(part, x + part(u)) for part, x in places]
    for k in range(6):
        mode = np.zeros(model.n_unknowns)
        for part, x in places:
            write_rigid_motion(x, k, part(mode))
        yield mode


def free_motions(model: Model, fixed: np.ndarray) -> np.ndarray:
    """Combinations of the rigid modes that move neither fixed unknowns nor mirror planes, (n_modes, 6). Collective."""
    kept = model.mirrors.kept_motions
    if not sum_integers(model.comm, np.array([np.count_nonzero(fixed)]))[0]:
        return np.eye(6)[kept]
    held = [mode[fixed] for mode in rigid_modes(model)]
    whole = exact_dots(model.comm, ((mode, mode) for mode in rigid_modes(model)))
    scale = 1.0 / np.sqrt(np.maximum(whole, 1e-300))
    gram = np.zeros((6, 6))
    gram[np.tril_indices(6)] = exact_dots(model.comm, ((a, b) for i, a in enumerate(held) for b in held[: i + 1]))
    gram = np.tril(gram) + np.tril(gram, -1).T
    values, vectors = np.linalg.eigh((scale[:, None] * gram * scale)[np.ix_(kept, kept)])
    free = np.zeros((np.count_nonzero(values <= HELD * values.max(initial=0.0)), 6))
    free[:, kept] = vectors[:, values <= HELD * values.max(initial=0.0)].T
    return free * scale


def remove_rigid_motion(model: Model, case: LoadCase, u: np.ndarray) -> None:
    """Take the free rigid motions out of a displacement: its mean over the volume vanishes, or that of each part that
    is loose. Collective.

    Parameters
    ----------
    u : float64, shape (n_unknowns,)
        Overwritten.
    """
    if case.parts.count > 1:
        settle(model, case.parts, case.loose, case.volume, u)
        return
    if not len(case.free_motions):
        return
    weighted = case.volume * u
    work = exact_dots(model.comm, ((weighted, mode) for mode in rigid_modes(model)))
    motions = case.free_motions
    u -= _combined(model, np.linalg.solve(motions @ case.rigid_gram @ motions.T, motions @ work) @ motions)


def _gram(model: Model, weight: np.ndarray, modes: Iterable[np.ndarray]) -> np.ndarray:
    """Products ``sum weight a b`` of vectors over the unknowns, symmetric. Collective."""
    vectors = list(modes)
    pairs = ((weight * a, b) for i, a in enumerate(vectors) for b in vectors[: i + 1])
    gram = np.zeros((len(vectors), len(vectors)))
    gram[np.tril_indices(len(vectors))] = exact_dots(model.comm, pairs)
    return gram + np.tril(gram, -1).T


def _combined(model: Model, motion: np.ndarray) -> np.ndarray:
    """A combination of the rigid modes, summed in their order, shape (n_unknowns,)."""
    result = np.zeros(model.n_unknowns)
    for amount, mode in zip(motion, rigid_modes(model), strict=True):
        if amount:
            result += amount * mode
    return result


def _check_balance(model: Model, case: LoadCase) -> None:
    if not len(case.free_motions):
        return

    def works():
        for motion in case.free_motions:
            mode = _combined(model, motion)
            yield case.external, mode
            yield np.abs(case.external), np.abs(mode)

    net, gross = exact_dots(model.comm, works()).reshape(-1, 2).T
    if (np.abs(net) <= BALANCE_TOLERANCE * gross.max()).all():
        return
    worst = int(np.argmax(np.abs(net)))
    force = exact_dots(model.comm, ((case.external, mode) for mode in rigid_modes(model)))
    units = model.units
    net_force = ", ".join(f"{f:.6g}" for f in force[:3] * units.force)
    net_moment = ", ".join(f"{m:.6g}" for m in force[3:] * units.force * units.length)
    raise SceneError(
        [
            f"loads are not in balance: their sum is a force of ({net_force}) and a moment of ({net_moment}) about the "
            f"centre of the body, and no support holds {_describe(case.free_motions[worst])}. Balance the loads, "
            "or add a table [[supports]]."
        ]
    )


def _describe(motion: np.ndarray) -> str:
    """The motion by name: a rotation wherever it has a part in it, since a lever arm looks like a translation."""
    translation, rotation = np.abs(motion).reshape(2, 3)
    if rotation.max() > 1e-6 * translation.max():
        return f"the rotation about {'xyz'[int(np.argmax(rotation))]}"
    return f"the translation along {'xyz'[int(np.argmax(translation))]}"


def _select_cells(discretization: Discretization, entry, where: str, scene: Scene) -> np.ndarray:
    """Cells a load or support speaks of; bool, shape (n_cells,)."""
    mesh = discretization.mesh
    if entry.region is not None:
        names = [region.name for region in scene.regions]
        chosen = discretization.region == names.index(entry.region)
    elif entry.face is not None:
        chosen = mesh.cells_near_face(entry.face, entry.layers)
    elif entry.set is not None:
        chosen = named_sets.cells_of(mesh, entry, where)
    else:
        chosen = mesh.cells_in_box(entry.lower, entry.upper)
    if not chosen.any() and entry.set is None:
        raise SceneError(
            [
                f"{where} selects no cell of the mesh, whose cells are {mesh.largest_edge:.6g} wide. Widen its box."
            ]
        )
    return chosen


def _density(discretization: Discretization, load: BodyForce, where: str, scene: Scene) -> np.ndarray:
    """Body force per volume on each cell, shape (n_cells, 3), model units."""
    chosen = _select_cells(discretization, load, where, scene)
    units = discretization.units
    if load.density is not None:
        density = np.array(load.density) * (units.length / units.stress)
    else:
        corners = discretization.nodes[discretization.mesh.cells[chosen]]
        density = np.array(load.total) / units.force / math.fsum(gauss_volumes(corners).reshape(-1))
    return np.where(chosen[:, None], density, 0.0)


def _traction(
    discretization: Discretization, load: Traction, where: str, fitted: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Forces of a traction: on nodes (n_mesh_nodes, 3), and on the points of free cells (n_cells, 8, 3); model units.

    Points take ``int L_i dA`` of their cell's face, as in the equilibrium that fitted bond factors are made for.
    """
    if load.set is None:
        (cells, faces), key, name = discretization.mesh.faces_on_face(load.face), "face", load.face
    else:
        (cells, faces), key, name = named_sets.faces_of(discretization.mesh, load, where), "set", load.set
    of_points = discretization.has_points[cells] & ~discretization.is_overlap[cells]
    if discretization.has_points[cells].any() and (not fitted or (load.nodal == "equal" and of_points.any())):
        count = np.count_nonzero(discretization.has_points[cells])
        reason, remedy = "a traction gives no force (sec. 2.2)", f'Use kind = "body_force" with {key} = "{name}".'
        if fitted:
            reason, remedy = "there are no nodes to share it equally", 'Use nodal = "consistent".'
        raise SceneError(
            [
                f"{where}.{key} = {name} has {count} of {len(cells)} faces on peridynamic cells, where {reason}. "
                f"{remedy}"
            ]
        )
    corners = discretization.nodes[faces]
    flat = np.ptp(corners, axis=1) <= discretization.mesh.tolerance / discretization.units.length
    mirrored = (flat & discretization.plane_components[faces].all(axis=1)).any(axis=1)
    if mirrored.any():
        raise SceneError(
            [
                f"{where}.{key} = {name} has {np.count_nonzero(mirrored)} of {len(faces)} faces on a mirror plane "
                "(mesh.symmetry), which lies inside of the whole body. Pull elsewhere, or remove the mirror."
            ]
        )
    areas = np.zeros(len(faces))
    nodal = np.zeros((len(discretization.nodes), 3))
    shares = np.zeros((len(faces), 4))
    for r, s in _FACE_POINTS:
        shape = (1 + _FACE_NODES[:, 0] * r) * (1 + _FACE_NODES[:, 1] * s) / 4
        along_r, along_s = np.zeros((len(faces), 3)), np.zeros((len(faces), 3))
        for a in range(4):
            along_r += _FACE_NODES[a, 0] * (1 + _FACE_NODES[a, 1] * s) / 4 * corners[:, a]
            along_s += _FACE_NODES[a, 1] * (1 + _FACE_NODES[a, 0] * r) / 4 * corners[:, a]
        normal = np.cross(along_r, along_s)
        area = np.sqrt(normal[:, 0] ** 2 + normal[:, 1] ** 2 + normal[:, 2] ** 2)
        areas += area
        shares += shape * area[:, None]
    units = discretization.units
    whole = math.fsum(areas)
    if load.traction is not None:
        traction = np.array(load.traction) / units.stress
    else:
        traction = np.array(load.total) / units.force / whole
    on_points = np.zeros((len(discretization.mesh.cells), 8, 3))
    if load.nodal == "equal":
        nodes = np.unique(faces)
        # a node on a mirror plane is shared with the other side
        share = 0.5 ** np.count_nonzero(discretization.plane_components[nodes], axis=1)
        nodal[nodes] = share[:, None] * (traction * whole / share.sum())
    else:
        for a in range(4):
            np.add.at(nodal, faces[~of_points, a], shares[~of_points, a, None] * traction)
        mesh = discretization.mesh
        shares_of_points = face_shares(mesh, discretization.nodes, cells[of_points], faces[of_points])
        on_points[cells[of_points]] = shares_of_points[:, :, None] * traction
    return nodal, on_points


def _prescriptions(scene: Scene, discretization: Discretization, messages: list[str]):
    """Prescribed displacements, model units, and the supports that prescribe them; NaN where free.

    Both for the points of cells (n_cells, 3) and for nodes (n_mesh_nodes, 3).
    """
    mesh = discretization.mesh
    on_cells = np.full((len(mesh.cells), 3), np.nan)
    on_nodes = np.full((len(mesh.nodes), 3), np.nan)
    by_cells, by_nodes = on_cells.copy(), on_nodes.copy()
    mirrored = discretization.plane_components
    for index, support in enumerate(scene.supports):
        where = f"supports.{index}"
        try:
            cells = _select_cells(discretization, support, where, scene)
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
            displacement = amount / discretization.units.length
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
                    before = table[np.flatnonzero(other)[0], d] * discretization.units.length
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


def _lump_on_nodes(discretization: Discretization, on_cells: np.ndarray, on_nodes: np.ndarray) -> None:
    """Add the body force of elements and overlap cells to their nodes (26)."""
    cells = np.flatnonzero(discretization.has_nodes & (on_cells != 0).any(axis=1))
    corners = discretization.mesh.cells[cells]
    volumes = gauss_volumes(discretization.nodes[corners])
    for a in range(8):
        share = np.zeros(len(cells))
        for p in range(8):
            share += SHAPE_AT_GAUSS[p, a] * volumes[:, p]
        np.add.at(on_nodes, corners[:, a], share[:, None] * on_cells[cells])


def _point_forces(discretization: Discretization, model: Model, on_cells: np.ndarray) -> np.ndarray:
    """Body force times volume of the free points, flat in cluster layout."""
    if not model.points or not on_cells.any():
        return np.zeros(3 * model.unknowns.n_points)
    density = _pick_points(discretization, model, on_cells)
    return density * np.repeat(model.points.volume[: model.unknowns.n_points].reshape(-1, 1, W), 3, axis=1).reshape(-1)


def _pick_points(discretization: Discretization, model: Model, on_cells: np.ndarray) -> np.ndarray:
    """Values of the free cells, repeated for their points, flat in cluster layout."""
    if not model.points:
        return np.empty(0)
    return cluster_layout(np.repeat(on_cells[model.subdomain.free][:, None, :], 8, axis=1))


def _join(model: Model, on_points: np.ndarray, on_nodes: np.ndarray) -> np.ndarray:
    """The flat vector over the unknowns; where there is nothing but zeros, no page of it is written."""
    joined = np.zeros(model.n_unknowns)
    if on_points.any():
        model.unknowns.of_points(joined)[:] = on_points
    if model.nodes:
        model.unknowns.of_nodes(joined)[:] = on_nodes[model.subdomain.owned_nodes]
    return joined
