"""Structured meshes."""

import numpy as np

from pdfem_mpi.mesh.hexmesh import HexMesh


def box(lower, upper, n_cells) -> HexMesh:
    """Equal cells in a box; nodes and cells are numbered with x fastest.

    Parameters
    ----------
    lower, upper : three floats, dimension length
        Opposite corners.
    n_cells : three ints, >= 1
        Cells along x, y and z.
    """
    axes = []
    for low, high, n in zip(lower, upper, n_cells, strict=True):
        t = np.arange(n + 1) / n
        axes.append(low * (1.0 - t) + high * t)
    z, y, x = np.meshgrid(*axes[::-1], indexing="ij")
    nodes = np.stack([x.ravel(), y.ravel(), z.ravel()], axis=1)
    nx, ny, nz = n_cells
    k, j, i = (a.ravel() for a in np.meshgrid(np.arange(nz), np.arange(ny), np.arange(nx), indexing="ij"))
    corner = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)]
    cells = np.stack([((k + c) * (ny + 1) + (j + b)) * (nx + 1) + (i + a) for a, b, c in corner], axis=1)
    return HexMesh(nodes, cells.astype(np.int32))
