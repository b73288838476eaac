"""The 3x3 diagonal blocks of the stiffness: of points, from their surviving bonds, and of nodes.

A block is stored as its six entries xx, yy, zz, xy, yz, zx.
"""

import numpy as np

from pdfem_mpi.finite_elements.nodes import assemble
from pdfem_mpi.kernels.dense import eigen
from pdfem_mpi.kernels.hex8 import SHAPE_AT_GAUSS
from pdfem_mpi.model.model import Model
from pdfem_mpi.parallel.comm import largest

#: Directions of a block softer than this fraction of the stiffest block of all, each over its material's modulus, are
#: held still.
SOFTEST = 1e-7
#: Blocks that are inverted together.
BATCH = 2**14

_ENTRIES = ((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (2, 0))


def node_blocks(model: Model, of_points: np.ndarray | None) -> np.ndarray:
    """Blocks of the owned nodes, shape (n_owned, 6), dimension force / length. Collective.

    Parameters
    ----------
    of_points : float64, shape (n_owned * 8, 6) or None
        Blocks of the points, for the overlap's share ``sum_p N_I(x_p)^2 B_p``.
    """

    def pick(stiffness):
        k = stiffness.reshape(-1, 8, 3, 8, 3)
        return np.stack([np.stack([k[:, a, i, a, j] for i, j in _ENTRIES], axis=1) for a in range(8)], axis=1)

    lumped = None
    if model.overlap:
        block = of_points[8 * model.points.n_free :].reshape(-1, 8, 6)
        lumped = np.zeros((len(block), 8, 6))
        for p in range(8):
            lumped += SHAPE_AT_GAUSS[p][:, None] ** 2 * block[:, p, None, :]

    def contributions():
        if model.elements:
            yield from model.elements.per_node(pick)
        if lumped is not None:
            yield model.overlap.connectivity, lumped

    return assemble(model.comm, model.nodes, contributions, 6)


def with_springs(blocks: np.ndarray, springs: np.ndarray | None, rows) -> np.ndarray:
    """Blocks (n, 6) with the stiffness of springs, (n_triples, 3), of these rows on their diagonals."""
    if springs is None:
        return blocks
    blocks = blocks.copy()
    blocks[:, :3] += springs[rows]
    return blocks


def softest(comm, blocks: np.ndarray, modulus: np.ndarray) -> np.ndarray:
    """Stiffness below which a direction of each block counts as without any. Collective.

    Parameters
    ----------
    blocks : float64, shape (n, 6)
    modulus : float64, shape (n,)
        Young's modulus of the material around: a block is measured by the stiffest of all, each over its modulus.

    Returns
    -------
    float64, shape (n,)
    """
    return SOFTEST * modulus * float(largest(comm, np.array([(blocks[:, :3] / modulus[:, None]).max(initial=0.0)]))[0])


def inverted(blocks: np.ndarray, fixed: np.ndarray, limit: np.ndarray) -> np.ndarray:
    """Inverse blocks by eigenvalues; directions without stiffness, and fixed ones, are held still.

    Parameters
    ----------
    blocks : float64, shape (n, 6)
    fixed : bool, shape (n, 3)
        Components that do not move.
    limit : float64, shape (n,)
        From `softest`.

    Returns
    -------
    float64, shape (n, 6)
    """
    found = np.empty((len(blocks), 6))
    for start in range(0, len(blocks), BATCH):
        some = slice(start, start + BATCH)
        found[some] = _inverted(blocks[some], fixed[some], limit[some])
    return found


def _inverted(blocks: np.ndarray, fixed: np.ndarray, limit: np.ndarray) -> np.ndarray:
    """`inverted`, of some blocks: takes 600 bytes a block."""
    matrix = blocks[:, [0, 3, 5, 3, 1, 4, 5, 4, 2]].reshape(-1, 3, 3).copy()
    matrix[fixed[:, :, None] | fixed[:, None, :]] = 0.0
    values, vectors = eigen(matrix)
    limit = limit[:, None]
    inverse = np.where(values > limit, 1.0 / np.maximum(values, np.maximum(limit, 1e-300)), 0.0)
    full = np.zeros_like(matrix)
    for d in range(3):
        full += inverse[:, d, None, None] * vectors[:, :, d, None] * vectors[:, None, :, d]
    return full.reshape(-1, 9)[:, [0, 4, 8, 1, 5, 6]]
