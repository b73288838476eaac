"""Slow answers to compare with: the whole stiffness matrix of a linear scene, solved directly, and bonds one by one.

What the program does by sweeps, clusters, integers and iterations is done here by a sparse matrix and a direct solver.
Shared with the program are the mesh, which cell carries what, and the reading of decks; not shared are forces,
loads, supports, solvers. Surface correction "none" only, where each bond's stiffness has a closed form.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import spsolve
from scipy.spatial import cKDTree

from pdfem_mpi.body.discretization import Discretization, discretize
from pdfem_mpi.body.materials import materials_of
from pdfem_mpi.deck.loads import BodyForce
from pdfem_mpi.deck.materials import Material
from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.mesh.layers import cells_near_face
from pdfem_mpi.mesh.rigid_motions import rigid_motions

CORNERS = np.array([(-1, -1, -1), (1, -1, -1), (1, 1, -1), (-1, 1, -1), (-1, -1, 1), (1, -1, 1), (1, 1, 1), (-1, 1, 1)])
GAUSS = np.array([(r, s, t) for t in (-1, 1) for s in (-1, 1) for r in (-1, 1)]) / math.sqrt(3.0)
#: As the program's: round-off of the cutoff radius decides no bond.
GUARD = 1e-6
#: A line is outside of the body if it is so for longer than this part of an edge.
OUTSIDE = 1e-5
#: Entries in a row from which on a matrix is solved as a dense one.
DENSE = 100


@dataclass(frozen=True)
class Body:
    """The unknowns of a scene (its own points, then its nodes) and what their positions are; deck units.

    Attributes
    ----------
    scene : Scene
    discretization : Discretization
    x : float64, shape (n_all_points, 3)
        Positions of all points, those of the overlap included.
    volume : float64, shape (n_all_points,)
    interpolation : sparse matrix, shape (n_all_points, n_unknown_places)
        From unknowns to points: 1 for a point of its own, shape functions in the overlap (25).
    cell : int64, shape (n_all_points,)
    n_free : int
        Points of their own.
    """

    scene: Scene
    discretization: Discretization
    x: np.ndarray
    volume: np.ndarray
    interpolation: sparse.csr_matrix
    cell: np.ndarray
    n_free: int


def shape(places: np.ndarray) -> np.ndarray:
    """Trilinear shape functions at reference places (n, 3), shape (n, 8)."""
    return np.prod(1.0 + places[:, None, :] * CORNERS, axis=2) / 8.0


def gradients(places: np.ndarray) -> np.ndarray:
    """Their derivatives, shape (n, 8, 3)."""
    factor = 1.0 + places[:, None, :] * CORNERS
    return np.stack([CORNERS[:, d] * np.prod(np.delete(factor, d, axis=2), axis=2) for d in range(3)], axis=2) / 8.0


def make_body(scene: Scene) -> Body:
    """Points, unknowns and what ties them, of a scene."""
    d = discretize(scene)
    nodes, cells = d.mesh.nodes, d.mesh.cells
    with_points = np.flatnonzero(d.has_points)
    corners = nodes[cells[with_points]]
    x = np.einsum("ga,nad->ngd", shape(GAUSS), corners).reshape(-1, 3)
    jacobian = np.einsum("gak,nad->ngkd", gradients(GAUSS), corners)
    volume = np.abs(np.linalg.det(jacobian)).reshape(-1)
    cell = np.repeat(with_points, 8)
    own = ~d.is_overlap[cell]
    n_free = int(own.sum())
    rows, columns, values = [np.flatnonzero(own)], [np.arange(n_free)], [np.ones(n_free)]
    tied = np.flatnonzero(~own)
    for a in range(8):
        rows.append(tied)
        columns.append(n_free + d.node_row[cells[cell[tied], a]])
        values.append(shape(GAUSS)[tied % 8, a])
    ties = sparse.csr_matrix(
        (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))), (len(x), n_free + d.n_nodes)
    )
    return Body(scene, d, x, volume, ties, cell, n_free)


def bonds(body: Body) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Ends i < j of all bonds, and their stiffness ``c exp(-(r/l)^2) w_i w_j`` (force over stretch, eq. 2)."""
    scene, edge = body.scene, body.scene.mesh.spacing or body.discretization.mesh.average_edge
    length, cutoff = scene.peridynamics.lengths(edge)
    if scene.peridynamics.surface_correction != "none":
        raise ValueError("the reference knows bonds without surface correction only")
    pairs = cKDTree(body.x).query_pairs(cutoff * (1.0 + GUARD), output_type="ndarray")
    pairs = pairs[~_leaves(body, *body.x[pairs].swapaxes(0, 1))]
    i, j = pairs.T
    _, shear = _lame(body)
    r = np.linalg.norm(body.x[j] - body.x[i], axis=1)
    c = 15.0 * np.minimum(shear[i], shear[j]) / (math.pi * length**4)  # 9 k / (pi l^4) at a Poisson's ratio of 1/4
    return i, j, c * np.exp(-((r / length) ** 2)) * body.volume[i] * body.volume[j]


def _leaves(body: Body, p: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Whether the straight lines from p to q, (n, 3), leave the body, where its cells are boxes; bool, shape (n,).

    Boxes share no inside, so what they hold of a line adds up. Bodies of other cells are convex in these tests.
    """
    mesh = body.discretization.mesh
    corners = mesh.nodes[mesh.cells]
    low, high = corners.min(axis=1), corners.max(axis=1)
    boxes = (np.isclose(corners, low[:, None]) | np.isclose(corners, high[:, None])).all()
    around = (high.max(axis=0) - low.min(axis=0)).prod()
    if not boxes or np.isclose((high - low).prod(axis=1).sum(), around):
        return np.zeros(len(p), bool)  # these cells fill the box around them
    way = q - p
    with np.errstate(divide="ignore", invalid="ignore"):
        inside = np.zeros(len(p))
        for a, b in zip(low, high, strict=True):
            enters, leaves = np.sort([(a - p) / way, (b - p) / way], axis=0)
            inside += np.maximum(np.minimum(leaves.min(axis=1), 1.0) - np.maximum(enters.max(axis=1), 0.0), 0.0)
    return np.linalg.norm(way, axis=1) * (1.0 - inside) > OUTSIDE * mesh.average_edge


def _lame(body: Body) -> tuple[np.ndarray, np.ndarray]:
    """Constants of Lame of all points."""
    tables = _tables(body)
    e, nu = (np.array([getattr(t, name) for t in tables])[body.cell] for name in ("youngs_modulus", "poissons_ratio"))
    return e * nu / ((1.0 + nu) * (1.0 - 2.0 * nu)), e / (2.0 * (1.0 + nu))


def _tables(body: Body) -> list[Material]:
    """The material of each cell."""
    of_region = [materials_of(body.scene)[region.material] for region in body.scene.regions]
    return [of_region[number] for number in body.discretization.region]


def stiffness(body: Body) -> sparse.csr_matrix:
    """Of all bonds and elements, linear kinematics, over the unknowns (three to a place)."""
    d, ties = body.discretization, sparse.kron(body.interpolation, sparse.identity(3), format="csr")
    i, j, k = bonds(body) if len(body.x) else (np.empty(0, int), np.empty(0, int), np.empty(0))
    xi = body.x[j] - body.x[i]
    # a bond is a spring: one row of B each, K = B^t (k / r) B
    direction = xi / np.linalg.norm(xi, axis=1)[:, None]
    number = np.repeat(np.arange(len(k)), 6)
    columns = np.concatenate([3 * i[:, None] + np.arange(3), 3 * j[:, None] + np.arange(3)], axis=1).reshape(-1)
    springs = sparse.csr_matrix(
        (np.concatenate([-direction, direction], axis=1).reshape(-1), (number, columns)), (len(k), 3 * len(body.x))
    )
    springs = springs @ ties
    total = springs.T @ sparse.diags(k / np.linalg.norm(xi, axis=1)) @ springs
    total = total + _volumetric(body, i, j, k, springs)
    elastic, tables = np.flatnonzero(d.has_stiffness), _tables(body)
    blocks = np.array([_element(d.mesh.nodes[d.mesh.cells[c]], tables[c]) for c in elastic]).reshape(-1, 24, 24)
    places = 3 * (body.n_free + d.node_row[d.mesh.cells[elastic]])[:, :, None] + np.arange(3)
    places = places.reshape(-1, 24)
    rows, columns = np.repeat(places, 24, axis=1).reshape(-1), np.tile(places, (1, 24)).reshape(-1)
    return (total + sparse.csr_matrix((blocks.reshape(-1), (rows, columns)), total.shape)).tocsr()


def _volumetric(body: Body, i, j, k, springs: sparse.csr_matrix) -> sparse.csr_matrix:
    """What the ratio of a material asks for beside its bonds: ``1/2 (lambda - mu) w theta^2`` of every point."""
    lam, mu = _lame(body)
    terms = k / (10.0 * np.minimum(mu[i], mu[j]))  # w theta = sum k e / (10 mu)
    places = np.concatenate([i, j]), np.tile(np.arange(len(k)), 2)
    divergence = sparse.csr_matrix((np.tile(terms, 2), places), (len(body.x), len(k))) @ springs
    return divergence.T @ sparse.diags((lam - mu) / body.volume) @ divergence


def _element(corners: np.ndarray, material: Material) -> np.ndarray:
    """Stiffness of one hexahedron, (24, 24), by its strain-displacement matrix in Voigt's order."""
    e, nu = material.youngs_modulus, material.poissons_ratio
    lam, mu = e * nu / ((1.0 + nu) * (1.0 - 2.0 * nu)), e / (2.0 * (1.0 + nu))
    elasticity = np.diag([2.0 * mu] * 3 + [mu] * 3)
    elasticity[:3, :3] += lam
    total = np.zeros((24, 24))
    for place in GAUSS:
        by_place = gradients(place[None])[0]
        jacobian = by_place.T @ corners
        slope = by_place @ np.linalg.inv(jacobian).T
        strain = np.zeros((6, 24))
        for d in range(3):
            strain[d, d::3] = slope[:, d]
        for row, (a, b) in enumerate(((1, 2), (0, 2), (0, 1)), start=3):
            strain[row, a::3], strain[row, b::3] = slope[:, b], slope[:, a]
        total += np.linalg.det(jacobian) * strain.T @ elasticity @ strain
    return total


def external_forces(body: Body) -> np.ndarray:
    """Body forces, and tractions on flat faces of elements, at load factor 1; shape (n_places, 3)."""
    d = body.discretization
    mesh = d.mesh
    force = np.zeros((body.interpolation.shape[1], 3))
    for load in body.scene.loads:
        if isinstance(load, BodyForce):
            chosen = _cells(body, load)
            corners = mesh.nodes[mesh.cells]
            volume = np.array([[abs(np.linalg.det(gradients(g[None])[0].T @ c)) for g in GAUSS] for c in corners])
            density = np.array(load.density or 0.0) if load.total is None else load.total / volume[chosen].sum()
            own = chosen[body.cell] & ~d.is_overlap[body.cell]
            force[: body.n_free] += (body.volume[:, None] * own[:, None] * density)[~d.is_overlap[body.cell]]
            for c in np.flatnonzero(chosen & d.has_nodes):
                for g in range(8):
                    places = body.n_free + d.node_row[mesh.cells[c]]
                    force[places] += np.outer(shape(GAUSS)[g], volume[c, g] * density)
            continue
        _, faces = mesh.faces_on_face(load.face)
        corners = mesh.nodes[faces]
        area = 0.5 * np.linalg.norm(np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1]), axis=1)
        if np.ptp(area) > 1e-9 * area.max():
            raise ValueError("the reference knows tractions on equal parallelograms only")
        traction = np.array(load.traction if load.total is None else load.total) / (
            area.sum() if load.total is not None else 1.0
        )
        for nodes in faces:  # a quarter of a parallelogram belongs to each of its nodes
            force[body.n_free + d.node_row[nodes]] += area[0] / 4.0 * traction
    return force


def prescribed(body: Body) -> np.ndarray:
    """Displacements that supports prescribe, at load factor 1; NaN elsewhere, shape (n_places, 3)."""
    d = body.discretization
    value = np.full((body.interpolation.shape[1], 3), np.nan)
    own_cell = body.cell[~d.is_overlap[body.cell]]
    for support in body.scene.supports:
        chosen = _cells(body, support)
        nodes = np.zeros(len(d.mesh.nodes), bool)
        nodes[d.mesh.cells[chosen & d.has_nodes]] = True
        if support.face is not None:
            nodes &= d.mesh.nodes_on_face(support.face)
        if support.set is not None:
            nodes &= np.isin(np.arange(len(nodes)), d.mesh.node_sets[support.set])
        places = np.concatenate([chosen[own_cell], nodes[d.node_row >= 0]])
        for axis, amount in enumerate((support.x, support.y, support.z)):
            if amount is not None:
                value[places, axis] = amount
    return value


def _cells(body: Body, entry) -> np.ndarray:
    d = body.discretization
    if entry.region is not None:
        return d.region == [region.name for region in body.scene.regions].index(entry.region)
    if entry.face is not None:
        return cells_near_face(d.mesh, entry.face, entry.layers)
    if entry.set is not None:
        return np.ones(len(d.mesh.cells), bool)
    return d.mesh.cells_in_box(entry.lower, entry.upper)


def solve(scene: Scene) -> tuple[np.ndarray | None, np.ndarray | None]:
    """Displacements of all points and of all nodes at load factor 1, as the program's fields: (n, 3) or None.

    Without supports the six rigid motions of the places are taken out.
    """
    body = make_body(scene)
    matrix, force, value = stiffness(body), external_forces(body).reshape(-1), prescribed(body).reshape(-1)
    fixed = ~np.isnan(value)
    u = np.where(fixed, value, 0.0)
    free = np.flatnonzero(~fixed)
    known = force[free] - (matrix @ u)[free]
    inner = matrix[free][:, free]
    if fixed.any():
        u[free] = _solve(inner, known)
    else:
        nodes = body.discretization.mesh.nodes[body.discretization.node_row >= 0]
        places = np.concatenate([body.x[~body.discretization.is_overlap[body.cell]], nodes])
        modes = sparse.csr_matrix(rigid_motions(places - places.mean(axis=0)).reshape(6, -1))
        u[free] = _solve(sparse.bmat([[inner, modes.T], [modes, None]]), np.append(known, np.zeros(6)))[:-6]
    u = u.reshape(-1, 3)
    points = body.interpolation @ u if len(body.x) else None
    return points, u[body.n_free :] if body.discretization.n_nodes else None


def _solve(matrix: sparse.spmatrix, known: np.ndarray) -> np.ndarray:
    """By elimination; matrices of bonds fill up, and dense elimination is then the faster one."""
    if matrix.nnz > DENSE * len(known):
        return np.linalg.solve(matrix.toarray(), known)
    return spsolve(matrix.tocsc(), known)


def without_rigid_motion(x: np.ndarray, u: np.ndarray) -> np.ndarray:
    """A displacement field, (n, 3), less the rigid motion nearest to it."""
    modes = rigid_motions(x - x.mean(axis=0)).reshape(6, -1)
    amounts, *_ = np.linalg.lstsq(modes.T, u.reshape(-1), rcond=None)
    return u - (amounts @ modes).reshape(-1, 3)


def finite_forces(body: Body, u: np.ndarray) -> np.ndarray:
    """Forces of all bonds on the points at displacements ``u``, eq. (2) as printed, with square roots; (n, 3).

    ``c exp(-(r/l)^2) w_i w_j s`` along the deformed bond, ``s`` the change of length over the length (3).
    """
    i, j, k = bonds(body)
    before = np.linalg.norm(body.x[j] - body.x[i], axis=1)
    y = body.x[j] + u[j] - body.x[i] - u[i]
    after = np.linalg.norm(y, axis=1)
    pull = (k * (after - before) / before / after)[:, None] * y
    total = np.zeros_like(u)
    np.add.at(total, i, pull)
    np.add.at(total, j, -pull)
    return total
