"""Meshes in which the cell whose middle is nearest to a place need not hold it: cells of many sizes, oblique cells."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np

from pdfem_mpi.kernels.hex8 import shape_functions
from pdfem_mpi.mesh.hexmesh import HexMesh


def grid(x, y, z):
    """Cells between planes along each axis."""
    nodes = np.stack(np.meshgrid(x, y, z, indexing="ij"), axis=-1).reshape(-1, 3).astype(float)
    number = np.arange(len(nodes)).reshape(len(x), len(y), len(z))
    i, j, k = (n.reshape(-1) for n in np.indices((len(x) - 1, len(y) - 1, len(z) - 1)))
    steps = ((0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1))
    cells = np.stack([number[i + a, j + b, k + c] for a, b, c in steps], axis=1)
    return HexMesh(nodes, cells.astype(np.int32))


def beside_crack():
    """Cells 0.2 high below the plane y = 0 and 2 high above it, with nodes of their own on it where x < 3."""
    whole = grid(range(7), [-1.0, -0.8, -0.6, -0.4, -0.2, 0.0, 2.0, 4.0], range(3))
    on = np.flatnonzero((whole.nodes[:, 1] == 0.0) & (whole.nodes[:, 0] < 3.0))
    number = np.arange(len(whole.nodes))
    number[on] = len(whole.nodes) + np.arange(len(on))
    above = whole.centroids[:, 1] > 0.0
    cells = np.where(above[:, None], number[whole.cells], whole.cells)
    return HexMesh(np.concatenate([whole.nodes, whole.nodes[on]]), cells.astype(np.int32))


def oblique(shear=2.0):
    """Cells of 1 x 4 x 1, moved along x by so much of their height."""
    mesh = grid(range(9), [0.0, 4.0, 8.0], range(3))
    return HexMesh(mesh.nodes + mesh.nodes[:, [1]] * [shear, 0.0, 0.0], mesh.cells)


def shaken():
    """Cells of many sizes with bent faces, in no order."""
    rng = np.random.default_rng(5)
    mesh = grid(np.arange(8.0) ** 2, np.arange(5.0), np.arange(4.0) ** 1.5)
    nodes = mesh.nodes + rng.uniform(-0.2, 0.2, mesh.nodes.shape)
    return HexMesh(nodes, mesh.cells[rng.permutation(len(mesh.cells))])


MESHES = {"beside a crack": beside_crack, "oblique": oblique, "shaken": shaken}


def body_of(mesh, has_nodes=None):
    """What `locate` needs of a body: elements everywhere, if not said otherwise."""
    return SimpleNamespace(mesh=mesh, has_nodes=np.ones(len(mesh.cells), bool) if has_nodes is None else has_nodes)


def places_in(mesh, count, seed):
    """Places within cells that are drawn: the cells, int64 (count,), and the places, float64 (count, 3)."""
    rng = np.random.default_rng(seed)
    cells = rng.integers(0, len(mesh.cells), count)
    shape = shape_functions(rng.uniform(-0.99, 0.99, (count, 3)))
    return cells, (shape[:, :, None] * mesh.nodes[mesh.cells[cells]]).sum(axis=1)
