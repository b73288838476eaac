"""What is measured on small bodies: bonds, eigenvalues, elastic constants, release rates, damage."""

from __future__ import annotations

import math

import numpy as np

from pdfem_mpi.deck.outputs import Output
from pdfem_mpi.deck.peridynamics import Crack
from pdfem_mpi.measure.fields import gather_damage
from pdfem_mpi.model.forces import Forces
from pdfem_mpi.peridynamics.bonds import BULK_MODULUS
from pdfem_mpi.peridynamics.cracks import cut_bonds
from support.bodies import bond_list, build, make_scene

POWER_ITERATIONS = 200
CUTOFF = 2.5  # internal lengths
# Places of a plane between and within cells of edge 1, and the gaps between layers of Gauss points that they stand for
GAPS = {0.0: 1.0 - 1.0 / math.sqrt(3.0), 0.5: 1.0 / math.sqrt(3.0)}
BESIDE = 0.1  # half widths


def largest_eigenvalue(body, mass=None, steps=POWER_ITERATIONS):
    """Rayleigh quotient of ``M^-1 K`` after some steps of power iteration from a seeded vector: a lower bound.

    Unknowns of infinite mass are held.
    """
    mass = body.model.mass if mass is None else mass
    free = np.isfinite(mass)
    weights = np.where(free, mass, 0.0)
    x = np.where(free, np.random.default_rng(0).standard_normal(len(mass)), 0.0)
    for _ in range(steps):
        y = -body.internal(x) / mass
        quotient = (x * weights) @ y / ((x * weights) @ x)
        x = y / np.abs(y).max()
    return quotient


def dense_stiffness(body):
    """The whole stiffness of a small body at rest, (n_unknowns, n_unknowns), column by column from its forces."""
    model = body.model
    n, rest = model.n_unknowns, np.zeros(model.n_unknowns)
    forces = Forces(model, tangent=bool(model.bonds and model.bonds.finite))
    if forces.tangent:
        forces.linearise(rest, 0.0)
    stiffness, column = np.empty((n, n)), np.empty(n)
    for k in range(n):
        moved = rest.copy()
        moved[k] = 1.0
        forces.evaluate_surely(moved, rest, column)
        stiffness[:, k] = -column
    return 0.5 * (stiffness + stiffness.T)


def spectrum(body, mass=None):
    """All eigenvalues of ``M^-1 K`` at rest, rising; rollers of mirror planes held."""
    root = 1.0 / np.sqrt(body.model.mass if mass is None else mass)
    return np.linalg.eigvalsh(root[:, None] * dense_stiffness(body) * root)


def lattice_constants(body):
    """Young's modulus over E_0 and Poisson's ratio by the bonds of the eight cells in the middle, unrelaxed.

    For linear kinematics.
    """
    x, i, j, stored = bond_list(body)
    edge = body.share.mesh.mean_edge / body.model.units.length
    central = np.abs(x).max(axis=1) < edge
    moments = np.zeros((3, 3))
    for end in (i, j):
        square = (x[j] - x[i])[central[end]] ** 2
        moments += np.einsum("n,na,nb->ab", stored[central[end]], square, square) / (2.0 * 8.0 * edge**3)
    normal, lateral = moments[0, 0], moments[0, 1]
    return (normal - lateral) * (normal + 2.0 * lateral) / (normal + lateral), lateral / (normal + lateral)


def lattice_of(internal_length):
    """`lattice_constants` without correction, for an internal length in cell edges."""
    scene = make_scene((8, 8, 8), correction="none")
    lengths = {"internal_length": internal_length, "cutoff_radius": max(CUTOFF * internal_length, 1.0)}
    peridynamics = scene.peridynamics.model_copy(update=lengths)
    return lattice_constants(build(scene.model_copy(update={"peridynamics": peridynamics}), loaded=False))


def released(body, place, half_width):
    """Energy at unit stretch of the bonds cut by a crack at x = place, within half widths along y and z; cuts them.

    For linear kinematics.
    """
    beside = BESIDE * half_width[0]  # a period of the lattice wherever it begins, and no bond ends on its edges
    (low, high), (down, up) = ((beside - half, beside + half) for half in half_width)
    polygon = np.array([[place, low, down], [place, high, down], [place, high, up], [place, low, up]])
    model = body.model
    before = [rows.data.copy() for rows in model.bonds.rows]
    cut_bonds(model.comm, model.points, model.bonds, polygon, np.array([1.0, 0.0, 0.0]))
    for rows, stored in zip(model.bonds.rows, before, strict=True):
        rows.data[:] = stored - rows.data  # only the bonds that were cut are left
    x, i, j, stored = bond_list(body)
    return float((0.5 * stored * np.linalg.norm(x[j] - x[i], axis=1) ** 4).sum())  # c exp(-r^2) g w w r / 2 each


def release_rate_inside(internal_length):
    """Energy of the bonds across a unit of plane inside a body, at unit stretch, mean over the plane's places.

    Cells of edge 1; without correction; in units of E l.
    """
    reach = math.ceil(CUTOFF * internal_length)
    scene = make_scene((2 * reach + 2, 2 * reach + 1, 2 * reach + 1), correction="none")
    peridynamics = scene.peridynamics.model_copy(update={"internal_length": internal_length})
    scene = scene.model_copy(update={"peridynamics": peridynamics})
    edge = 1.0 / internal_length  # model units
    return sum(
        gap * released(build(scene, loaded=False), place * edge, (0.5 * edge, 0.5 * edge)) / edge**2
        for place, gap in GAPS.items()
    )


def cracked_block(kinematics="linear", front=8.0):
    """A block of 8 x 7 x 7 cells with a crack through its middle, between cells, up to a height z."""
    corners = ((4.0, -1.0, -1.0), (4.0, 8.0, -1.0), (4.0, 8.0, front), (4.0, -1.0, front))
    scene = make_scene((8, 7, 7), kinematics=kinematics, cracks=(Crack(polygon=corners),), output=Output(damage=True))
    return build(scene, loaded=False)


def damage_by_layer(body):
    """Damage of the points at the axis of `cracked_block` in each layer of points, from the crack outwards."""
    damage = gather_damage(body.share, body.model)
    x = body.geometry.point_positions - [4.0, 3.5, 3.5]
    inner = np.abs(x[:, 1:]).max(axis=1) < 0.5
    distance = np.abs(x[inner, 0]).round(6)
    return [damage[inner][distance == value] for value in np.unique(distance)]


def stored_responses(body_bonds, volume: np.ndarray, length: float) -> tuple[np.ndarray, np.ndarray]:
    """Distances and responses ``c exp`` of a body's stored bonds (linear kinematics), in cell edges and k / edge^4."""
    x, i, j, stored = body_bonds
    r = np.linalg.norm(x[j] - x[i], axis=1)
    response = stored * r**3 / (volume[i] * volume[j]) / BULK_MODULUS / length**4
    return r * length, response


def single_bond(body, body_bonds, stretch: np.ndarray) -> np.ndarray:
    """Forces of one bond of a finite-kinematics body, all others taken out, at some stretches."""
    x, i, j, _ = body_bonds
    chosen = int(np.argmin(np.linalg.norm(x[j] - x[i], axis=1)))
    a, b = int(i[chosen]), int(j[chosen])
    rows = body.model.bonds.interior
    data = rows.data.reshape(-1, 8)
    for row in range(len(rows.offset)):
        in_row = row >= rows.start[a] and row < rows.start[a + 1] and rows.offset[row] // 36 == b // 4
        for lane in range(4):
            if not (in_row and lane == b % 4):
                data[row, lane] = data[row, 4 + lane] = 0.0
    found = []
    for s in stretch:
        u = np.zeros_like(x)
        u[b] = s * (x[b] - x[a])
        force = body.internal(body.of_positions(lambda places, u=u: u)).reshape(-1, 3, 4).swapaxes(1, 2).reshape(-1, 3)
        found.append(float(np.linalg.norm(force[b])))
    return np.array(found)
