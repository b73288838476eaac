"""Patch tests: uniform strains prescribed around a block, and how far its inside moves away from them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pdfem_mpi.model.forces import Forces
from pdfem_mpi.model.model import build_model
from pdfem_mpi.model.state import new_state
from pdfem_mpi.solvers import adr
from support.bodies import Body, build, make_scene

CUTOFF = 2.5  # cells

#: Symmetric gradients, and rotations about the three axes.
STRAINS = {"xx": (0, 0), "yy": (1, 1), "zz": (2, 2), "yz": (1, 2), "zx": (2, 0), "xy": (0, 1)}
ROTATIONS = {"about x": (2, 1), "about y": (0, 2), "about z": (1, 0)}

#: Blocks of unit cells: their size, how many layers are elements, and what else the scene has. The nodes of the first
#: are moved, the others are cubes.
DISTORTED = "finite elements, distorted"
BLOCKS = {
    DISTORTED: ((4, 4, 4), 4, {}),
    "peridynamics, appendix A": ((8, 8, 8), 0, {}),
    "peridynamics, no correction": ((8, 8, 8), 0, {"correction": "none"}),
    "coupled, reading B": ((10, 8, 8), 5, {"coupling": "paper"}),
    "coupled, reading A": ((10, 8, 8), 5, {"coupling": "paper_a"}),
}
MOVED = 0.2  # of an edge, at most: no cell is a parallelepiped, none is inside out


@dataclass(frozen=True)
class Errors:
    """Of one uniform gradient of size 1, in cell edges and in the largest force of a held unknown.

    Attributes
    ----------
    displacement : float
        Largest difference of a displacement from the uniform field, in equilibrium.
    force : float
        Largest force on a free unknown in the uniform field itself.
    """

    displacement: float
    force: float


def gradient_of(name: str) -> np.ndarray:
    """A strain of 1 (its two shear components 1 each), or a rotation by a small angle, per unit."""
    gradient = np.zeros((3, 3))
    a, b = (STRAINS | ROTATIONS)[name]
    gradient[a, b] = 1.0
    gradient[b, a] = 1.0 if name in STRAINS else -1.0
    return gradient


def distort(body: Body) -> Body:
    """The same body with its inner nodes moved at random (seeded), so that every element is a general hexahedron."""
    share = body.share
    mesh, units = share.mesh, share.units
    x = mesh.nodes
    inner = ((x > mesh.lower + 0.5 * mesh.mean_edge) & (x < mesh.upper - 0.5 * mesh.mean_edge)).all(axis=1)
    moves = np.random.default_rng(7).uniform(-MOVED, MOVED, x.shape) * mesh.mean_edge
    nodes = np.where(inner[:, None], x + moves, x)
    moved = replace(share, mesh=replace(mesh, nodes=nodes), nodes=(nodes - units.origin) / units.length)
    model = build_model(body.scene, moved, body.model.comm)
    state = new_state(model)
    return replace(body, share=moved, model=model, forces=Forces(model, state.bounds), state=state)


def block(name: str, size: tuple[tuple[int, int, int], int] | None = None) -> Body:
    """One of `BLOCKS`, assembled without loads, with other cells and layers of elements where ``size`` says so."""
    cells, n_elements, options = BLOCKS[name]
    cells, n_elements = size or (cells, n_elements)
    body = build(make_scene(cells, n_elements, **options), loaded=False)
    return distort(body) if name == DISTORTED else body


def held_by(body: Body) -> np.ndarray:
    """Unknowns of the nodes on the block's surface and of the points within a cutoff radius of it; bool."""
    mesh = body.share.mesh
    half = 0.5 * (mesh.upper - mesh.lower)

    def near_surface(x):
        depth = (half - np.abs(x)).min(axis=1)
        is_node = np.arange(len(x)) >= 0 if not body.model.points else _on_planes(x[:, 1] + half[1])
        return np.repeat((depth < np.where(is_node, 0.1, CUTOFF))[:, None], 3, axis=1)

    return body.of_positions(near_surface).astype(bool)


def _on_planes(y: np.ndarray) -> np.ndarray:
    """Nodes of cubes; Gauss points lie at least .21 beside the planes of nodes."""
    return np.abs(y - np.rint(y)) < 0.1


def patch_test(body: Body, name: str, tolerance: float = 1e-6) -> Errors:
    """Prescribe a uniform strain on the unknowns of `held_by` and find the equilibrium of the others.

    Free surfaces take no part: what is found is the error inside a body, and at a flat interface.
    """
    gradient = gradient_of(name)
    exact = body.of_positions(lambda x: x @ gradient.T)
    fixed = held_by(body)
    forces = np.abs(body.internal(exact))
    u = body.state.u
    u[:] = exact
    body.state.v[:] = 0.0
    body.state.iteration = 0
    adr.solve(body.forces, body.state, np.zeros_like(u), fixed, tolerance, 5000)
    return Errors(float(np.abs(u - exact).max()), float(forces[~fixed].max() / forces[fixed].max()))


def rotation_force(body: Body, name: str) -> float:
    """Largest force of a small rotation, over that of a strain of the same size."""

    def largest_force(way):
        return float(np.abs(body.internal(body.of_positions(lambda x: x @ gradient_of(way).T))).max())

    return largest_force(name) / largest_force("xx")
