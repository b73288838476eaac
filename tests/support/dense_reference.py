"""Another evaluation of a small body: every bond by itself, dense arrays, deck units, no clusters, integers or float32.

Shared with the program are the reading of decks, the mesh, and which cell carries what (`discretize`). Not shared are
the search for bonds, their constants and surface corrections, mirror images, forces, energies, loads, supports. Factors
of `surface_correction = "fitted"` are the solution of a large problem of their own and are taken from the program.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np

from pdfem_mpi.body.discretization import Discretization, discretize
from pdfem_mpi.body.materials import materials_of
from pdfem_mpi.deck.loads import BodyForce
from pdfem_mpi.deck.meshes import FileMesh
from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.mesh.layers import cells_near_face

CORNERS = np.array([(-1, -1, -1), (1, -1, -1), (1, 1, -1), (-1, 1, -1), (-1, -1, 1), (1, -1, 1), (1, 1, 1), (-1, 1, 1)])
GAUSS = np.array([(r, s, t) for t in (-1, 1) for s in (-1, 1) for r in (-1, 1)]) / math.sqrt(3.0)
#: Round-off of the cutoff radius decides no bond: the program's rule.
GUARD = 1e-6
NU = 0.25  # of bonds alone
SWEEPS = 20  # of both surface corrections
#: Force density of half an infinite body per unit strain over k / l: eq. (A5) in closed form.
HALF_SPACE = 9.0 * (1.0 - NU) * math.sqrt(math.pi) / 4.0


def shapes(places: np.ndarray) -> np.ndarray:
    """Trilinear shape functions at reference places (n, 3), shape (n, 8)."""
    return np.prod(1.0 + places[:, None, :] * CORNERS, axis=2) / 8.0


def slopes(places: np.ndarray) -> np.ndarray:
    """Their derivatives by the reference coordinates, shape (n, 8, 3)."""
    factor = 1.0 + places[:, None, :] * CORNERS
    return np.stack([CORNERS[:, d] * np.prod(np.delete(factor, d, axis=2), axis=2) for d in range(3)], axis=2) / 8.0


def element_response(gradient, volume, u, lam, mu, finite):
    """Nodal forces (n, 8, 3) and energies (n,) of elements: the one place that knows their law.

    Parameters
    ----------
    gradient : float64, shape (n, 8, 8, 3)
        Of the shape functions by position: element, Gauss point, node, axis.
    volume : float64, shape (n, 8)
    u : float64, shape (n, 8, 3)
    lam, mu : float64, shape (n,)
    finite : bool
        Kinematics of the scene.
    """
    h = np.einsum("eai,egaj->egij", u, gradient)
    strain = 0.5 * (h + h.swapaxes(2, 3))
    if finite:
        strain = strain + 0.5 * np.einsum("egki,egkj->egij", h, h)
    trace = np.einsum("egii->eg", strain)
    stress = lam[:, None, None, None] * trace[:, :, None, None] * np.eye(3) + 2.0 * mu[:, None, None, None] * strain
    energy = 0.5 * np.einsum("egij,egij,eg->e", stress, strain, volume)
    if finite:
        stress = np.einsum("egik,egkj->egij", np.eye(3) + h, stress)
    return -np.einsum("egij,egaj,eg->eai", stress, gradient, volume), energy


@dataclass(frozen=True)
class Pairs:
    """Directed bonds: from point ``i`` to the image ``image`` of point ``j``; every bond of the part stands here twice.

    Attributes
    ----------
    i, j : int64, shape (n,)
    sign : float64, shape (n, 3)
        Displacements of the image are ``sign`` times those of ``j``.
    xi : float64, shape (n, 3)
        From i to the image.
    stiffness : float64, shape (n,)
        Force over stretch, without correction.
    mirrored : bool, shape (n,)
        Across a mirror plane.
    weight : float64, shape (n,)
        ``1 / (10 mu)``: of the bond's force per stretch in the dilatation of its points.
    """

    i: np.ndarray
    j: np.ndarray
    sign: np.ndarray
    xi: np.ndarray
    stiffness: np.ndarray
    mirrored: np.ndarray
    weight: np.ndarray

    def only(self, chosen: np.ndarray) -> Pairs:
        """Some of them."""
        return Pairs(*(getattr(self, name)[chosen] for name in self.__dataclass_fields__))


class DenseBody:
    """A scene's body; unknowns are places: own points (cell by cell), then nodes, (n_places, 3).

    Attributes
    ----------
    x, volume, cell : of all points, those of the overlap included
    own : bool
        Points that are places.
    pairs : Pairs
    factor : float64
        Of each directed bond, from the surface correction.
    """

    def __init__(self, scene: Scene, fitted: np.ndarray | None = None):
        self.scene, self.d = scene, discretize(scene)
        d, mesh = self.d, self.d.mesh
        self.finite = scene.kinematics == "finite"
        cells = np.flatnonzero(d.has_points)
        corners = mesh.nodes[mesh.cells]
        jacobian = np.einsum("gak,cad->cgkd", slopes(GAUSS), corners)
        self.cell_volume = np.linalg.det(jacobian)
        self.gradient = np.einsum("cgdk,gak->cgad", np.linalg.inv(jacobian), slopes(GAUSS))
        self.x = np.einsum("ga,cad->cgd", shapes(GAUSS), corners[cells]).reshape(-1, 3)
        self.volume, self.cell = self.cell_volume[cells].reshape(-1), np.repeat(cells, 8)
        self.own = ~d.is_overlap[self.cell]
        self.n_own = int(self.own.sum())
        self.n_places = self.n_own + d.n_nodes
        table = [materials_of(scene)[region.material] for region in scene.regions]
        self.materials = [table[number] for number in d.region]
        self.names = np.array([region.material for region in scene.regions])[d.region]
        if len(self.x):
            edge = _cell_edge(scene, d)
            self.length, self.cutoff = scene.peridynamics.lengths(edge)
            self.pairs = self._cut(self._find_pairs())
            self.factor = self._corrected() if fitted is None else fitted[self.pairs.i, self.pairs.j]

    # Bonds

    def _images(self):
        """Signs and shifts of the identity and of all products of reflections that may reach the body."""
        mesh, along = self.d.mesh, []
        for axis, name in enumerate("xyz"):
            low, high = mesh.nodes[:, axis].min(), mesh.nodes[:, axis].max()
            planes = [p for face, p in ((f"{name}-", low), (f"{name}+", high)) if face in self.scene.mesh.symmetry]
            found = {(1.0, 0.0)}
            reach = self.cutoff * (1.0 + GUARD)
            grown = True
            while grown:  # reflect what is there at every plane until nothing new comes near
                new = {(-s, 2.0 * p - t) for s, t in found for p in planes} - found
                ends = {e: sorted((e[0] * low + e[1], e[0] * high + e[1])) for e in new}
                size = 1e-9 * (high - low)
                new = {e for e in new if ends[e][0] <= high + reach and ends[e][1] >= low - reach}
                new = {e for e in new if all(e[0] != f[0] or abs(e[1] - f[1]) > size for f in found)}
                found |= new
                grown = bool(new)
            along.append(sorted(found, key=lambda e: (e != (1.0, 0.0), e)))
        for choice in itertools.product(*along):
            sign, shift = np.array(choice).T
            yield sign, shift

    def _find_pairs(self) -> Pairs:
        found, n = [], len(self.x)
        shear = self._bond_shear()
        for k, (sign, shift) in enumerate(self._images()):
            xi = (sign * self.x + shift)[None] - self.x[:, None]
            r = np.sqrt((xi**2).sum(axis=2))
            near = r <= self.cutoff * (1.0 + GUARD)
            if k == 0:
                near &= ~np.eye(n, dtype=bool)
            near &= r > 0.0
            body = self.d.body[self.cell]
            near &= body[:, None] == body[None]
            i, j = np.nonzero(near)
            c = 15.0 * shear[i, j] / (math.pi * self.length**4)  # 9 k / (pi l^4) at a Poisson's ratio of 1/4
            stiffness = c * np.exp(-((r[i, j] / self.length) ** 2)) * self.volume[i] * self.volume[j]
            sums = (i, j, np.tile(sign, (len(i), 1)), xi[i, j], stiffness, np.full(len(i), k > 0))
            found.append((*sums, 0.1 / self._own_shear()[i]))
        return Pairs(*(np.concatenate(parts) for parts in zip(*found, strict=True)))

    def _of_points(self) -> tuple[np.ndarray, np.ndarray]:
        """Young's modulus and Poisson's ratio of every point's material."""
        of_cells = [(self.materials[c].youngs_modulus, self.materials[c].poissons_ratio) for c in self.cell]
        return tuple(np.array(of_cells).T)

    def _own_shear(self) -> np.ndarray:
        """Shear modulus of every point's material."""
        modulus, nu = self._of_points()
        return modulus / (2.0 * (1.0 + nu))

    def _bond_shear(self) -> np.ndarray:
        """Shear modulus of the bonds between any two points, (n, n): that of the softer."""
        nu, own, names = self._of_points()[1], self._own_shear(), self.names[self.cell]
        shear = np.minimum(own[:, None], own[None])
        softer = np.where(own[:, None] <= own[None], nu[:, None], nu[None])
        for interface in self.scene.interfaces:
            if interface.youngs_modulus is not None:
                one, two = (names == name for name in interface.between)
                chosen = np.outer(one, two) | np.outer(two, one)
                shear[chosen] = interface.youngs_modulus / (2.0 * (1.0 + softer[chosen]))
        return shear

    def dilatation(self, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Dilatation ``theta`` of all points, and the modulus ``M = lambda - mu`` that answers it."""
        pairs, (modulus, nu) = self.pairs, self._of_points()
        extension = self.stretches(u) * np.sqrt((pairs.xi**2).sum(axis=1))
        terms = pairs.weight * pairs.stiffness * self.factor * extension
        lacks = modulus * nu / ((1.0 + nu) * (1.0 - 2.0 * nu)) - modulus / (2.0 * (1.0 + nu))
        return np.bincount(pairs.i, terms, len(self.x)) / self.volume, lacks

    def _cut(self, pairs: Pairs) -> Pairs:
        """Without the bonds through cracks and through their mirror images."""
        start = self.x[pairs.i]
        crossed = np.zeros(len(pairs.i), bool)
        for crack in self.scene.cracks:
            for sign, shift in self._images():
                crossed |= crosses(np.array(crack.polygon) * sign + shift, start, start + pairs.xi)
        self.n_cut = self._undirected(pairs.only(crossed))
        return pairs.only(~crossed)

    def _undirected(self, pairs: Pairs) -> int:
        """Bonds, as the program counts them: one and its mirror image are one, one to the own image is one."""
        itself = np.count_nonzero(pairs.mirrored & (pairs.i == pairs.j))
        return (len(pairs.i) - itself) // 2 + itself

    @property
    def n_bonds(self) -> int:
        """Undirected bonds after the cracks."""
        return self._undirected(self.pairs) if len(self.x) else 0

    def _corrected(self) -> np.ndarray:
        """Factor of each directed bond by appendix A (A1)-(A12), or by the virial stress in the same iteration."""
        kind, pairs = self.scene.peridynamics.surface_correction, self.pairs
        if kind == "none":
            return np.ones(len(pairs.i))
        whole = self._find_pairs() if self.scene.cracks else pairs  # bodies are corrected before they are cut
        vector = np.ones_like(self.x)
        modulus, nu = self._of_points()
        modulus = modulus * (1.0 + NU) / (1.0 + nu)  # of bonds alone with this shear modulus
        target = modulus if kind == "virial" else HALF_SPACE * modulus / (3.0 * (1.0 - 2.0 * NU)) / self.length
        r = np.sqrt((whole.xi**2).sum(axis=1))
        n = whole.xi / r[:, None]
        measure = 0.5 * r[:, None] * n**2 if kind == "virial" else np.abs(n)
        strain = (1.0 + NU) * n**2 - NU
        for _ in range(SWEEPS):
            pull = (whole.stiffness * _ellipsoid(vector, whole))[:, None] * measure * strain
            response = np.stack([np.bincount(whole.i, pull[:, d], len(self.x)) for d in range(3)], axis=1)
            response /= self.volume[:, None]
            vector *= np.where(response > 0.0, target[:, None] / np.where(response > 0.0, response, 1.0), 1.0)
        return _ellipsoid(vector, pairs)

    # Places, loads and supports

    def places_of(self, u_points: np.ndarray | None, u_nodes: np.ndarray | None) -> np.ndarray:
        """The program's fields as displacements of the places."""
        parts = [] if u_points is None else [u_points[self.own]]
        return np.concatenate(parts + ([] if u_nodes is None else [u_nodes]))

    def _nodes_of(self, cells: np.ndarray) -> np.ndarray:
        return self.n_own + self.d.node_row[self.d.mesh.cells[cells]]

    def points(self, u: np.ndarray) -> np.ndarray:
        """Displacements of all points; those of the overlap follow their nodes (25)."""
        all_points = np.empty_like(self.x)
        all_points[self.own] = u[: self.n_own]
        tied = np.flatnonzero(self.d.is_overlap & self.d.has_points)
        all_points[~self.own] = np.einsum("ga,cad->cgd", shapes(GAUSS), u[self._nodes_of(tied)]).reshape(-1, 3)
        return all_points

    def external(self) -> np.ndarray:
        """Loads at load factor 1, (n_places, 3)."""
        d, mesh = self.d, self.d.mesh
        force = np.zeros((self.n_places, 3))
        for load in self.scene.loads:
            if isinstance(load, BodyForce):
                chosen = self._cells(load)
                whole = self.cell_volume[chosen].sum()
                density = np.array(load.density) if load.total is None else np.array(load.total) / whole
                on_points = np.where(chosen[self.cell], self.volume, 0.0)[:, None] * density
                force[: self.n_own] += on_points[self.own]
                for c in np.flatnonzero(chosen & d.has_nodes):
                    np.add.at(force, self._nodes_of(c), np.outer(self.cell_volume[c] @ shapes(GAUSS), density))
                continue
            _, faces = mesh.faces_on_face(load.face)
            shares = np.array([_face_shares(mesh.nodes[face]) for face in faces])
            amount = np.array(load.traction) if load.total is None else np.array(load.total) / shares.sum()
            if load.nodal == "consistent":
                for face, share in zip(faces, shares, strict=True):
                    np.add.at(force, self.n_own + d.node_row[face], np.outer(share, amount))
            else:
                nodes = np.unique(faces)
                part = 0.5 ** self._on_planes(nodes).sum(axis=1)  # the rest belongs to the other side of the plane
                force[self.n_own + d.node_row[nodes]] += np.outer(part / part.sum(), amount * shares.sum())
        return force

    def prescribed(self) -> np.ndarray:
        """Displacements that supports and mirror planes prescribe at load factor 1; NaN elsewhere, (n_places, 3)."""
        d, mesh = self.d, self.d.mesh
        value = np.full((self.n_places, 3), np.nan)
        carries = np.flatnonzero(d.node_row >= 0)
        for support in self.scene.supports:
            chosen = self._cells(support)
            nodes = np.zeros(len(mesh.nodes), bool)
            nodes[mesh.cells[chosen & d.has_nodes]] = True
            if support.face is not None:
                nodes &= mesh.nodes_on_face(support.face)
            places = np.concatenate([chosen[self.cell[self.own]], nodes[carries]])
            for axis, amount in enumerate((support.x, support.y, support.z)):
                if amount is not None:
                    value[places, axis] = amount
        value[self.n_own :][self._on_planes(carries)] = 0.0
        return value

    def _on_planes(self, nodes: np.ndarray) -> np.ndarray:
        """Components of nodes normal to a mirror plane through them; bool, (n, 3)."""
        x, mesh = self.d.mesh.nodes, self.d.mesh
        on = np.zeros((len(nodes), 3), bool)
        for face in self.scene.mesh.symmetry:
            axis = "xyz".index(face[0])
            plane = x[:, axis].min() if face[1] == "-" else x[:, axis].max()
            on[:, axis] |= np.abs(x[nodes, axis] - plane) <= mesh.tolerance
        return on

    def _cells(self, entry) -> np.ndarray:
        d = self.d
        if entry.region is not None:
            return d.region == [region.name for region in self.scene.regions].index(entry.region)
        if entry.face is not None:
            return cells_near_face(d.mesh, entry.face, entry.layers)
        return d.mesh.cells_in_box(entry.lower, entry.upper)

    # Forces

    def internal(self, u: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
        """Internal forces of the places, the sums of the magnitudes of their parts, and the stored energy."""
        d, force, size, energy = self.d, np.zeros((self.n_places, 3)), np.zeros((self.n_places, 3)), 0.0
        if len(self.x):
            pull, stored = self.bond_forces(u)
            on_points, sizes = np.zeros_like(self.x), np.zeros_like(self.x)
            np.add.at(on_points, self.pairs.i, pull)
            np.add.at(sizes, self.pairs.i, np.abs(pull))
            force[: self.n_own], size[: self.n_own] = on_points[self.own], sizes[self.own]
            tied = np.flatnonzero(d.is_overlap & d.has_points)
            for target, values in ((force, on_points), (size, sizes)):
                lumped = np.einsum("ga,cgd->cad", shapes(GAUSS), values[~self.own].reshape(-1, 8, 3))
                np.add.at(target, self._nodes_of(tied), lumped)
            energy += stored
        cells = np.flatnonzero(d.has_stiffness)
        if len(cells):
            e = np.array([self.materials[c].youngs_modulus for c in cells])
            nu = np.array([self.materials[c].poissons_ratio for c in cells])
            lam, mu = e * nu / ((1.0 + nu) * (1.0 - 2.0 * nu)), e / (2.0 * (1.0 + nu))
            nodes = self._nodes_of(cells)
            nodal, stored = element_response(
                self.gradient[cells], self.cell_volume[cells], u[nodes], lam, mu, self.finite
            )
            np.add.at(force, nodes, nodal)
            np.add.at(size, nodes, np.abs(nodal))
            energy += stored.sum()
        return force, size, energy

    def stretches(self, u: np.ndarray) -> np.ndarray:
        """Stretch of each directed bond (3), linear where the kinematics are."""
        pairs, points = self.pairs, self.points(u)
        eta = pairs.sign * points[pairs.j] - points[pairs.i]
        square = (pairs.xi**2).sum(axis=1)
        if not self.finite:
            return (eta * pairs.xi).sum(axis=1) / square
        # (|y| - r) / r without cancellation
        more = (eta * (2.0 * pairs.xi + eta)).sum(axis=1) / square
        return more / (1.0 + np.sqrt(1.0 + more))

    def bond_forces(self, u: np.ndarray) -> tuple[np.ndarray, float]:
        """Force of each directed bond on its first point (2), and the energy of the part's bonds."""
        pairs, points = self.pairs, self.points(u)
        stretch, r = self.stretches(u), np.sqrt((pairs.xi**2).sum(axis=1))
        stiffness = pairs.stiffness * self.factor
        y = pairs.xi + (pairs.sign * points[pairs.j] - points[pairs.i] if self.finite else 0.0)
        theta, lacks = self.dilatation(u)
        common = 0.1 * lacks * theta / self._own_shear()
        pressure = common[pairs.i] + common[pairs.j]
        pull = (stiffness * (stretch + pressure) / np.sqrt((y**2).sum(axis=1)))[:, None] * y
        stored = 0.25 * (stiffness * stretch**2 * r).sum() + 0.5 * (lacks * self.volume * theta**2).sum()
        return pull, float(stored)


def _cell_edge(scene: Scene, d: Discretization) -> float:
    if isinstance(scene.mesh, FileMesh) and scene.mesh.spacing is None:
        return d.mesh.average_edge
    return scene.mesh.spacing


def _ellipsoid(vector: np.ndarray, pairs: Pairs) -> np.ndarray:
    """Factor of each bond from the vectors of its ends (A8)-(A10)."""
    mean = 0.5 * (vector[pairs.i] + vector[pairs.j])
    n = pairs.xi / np.sqrt((pairs.xi**2).sum(axis=1))[:, None]
    return 1.0 / np.sqrt(((n / mean) ** 2).sum(axis=1))


def _face_shares(corners: np.ndarray) -> np.ndarray:
    """``int N_a dA`` of a quadrilateral's four corners, 2x2 Gauss points."""
    signs = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])
    total = np.zeros(4)
    for place in signs / math.sqrt(3.0):
        factor = 1.0 + signs * place
        along, up = (signs[:, k] * factor[:, 1 - k] / 4.0 @ corners for k in (0, 1))
        total += np.prod(factor, axis=1) / 4.0 * np.linalg.norm(np.cross(along, up))
    return total


def crosses(polygon: np.ndarray, start: np.ndarray, stop: np.ndarray) -> np.ndarray:
    """Which segments cross a plane polygon without holes: signed angles around the point of crossing."""
    normal = np.cross(polygon[1] - polygon[0], polygon[-1] - polygon[0])
    above, below = ((end - polygon[0]) @ normal for end in (start, stop))
    through = above * below <= 0.0
    through &= above != below
    share = np.where(through, above / np.where(above == below, 1.0, above - below), 0.0)
    spokes = polygon[None] - (start + share[:, None] * (stop - start))[:, None]
    after = np.roll(spokes, -1, axis=1)
    turn = np.arctan2(np.cross(spokes, after) @ (normal / np.linalg.norm(normal)), (spokes * after).sum(axis=2))
    return through & (np.abs(turn.sum(axis=1)) > math.pi)
