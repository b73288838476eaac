"""Symmetric tensors as six numbers, xx, yy, zz, xy, yz, zx, as viewers have them; shears are those of the tensor."""

from __future__ import annotations

import numpy as np

from pdfem_mpi.kernels.dense import eigen

#: Component of the six for each entry of the matrix, row by row.
ENTRIES = np.array([[0, 3, 5], [3, 1, 4], [5, 4, 2]])
#: Row and column of each of the six.
ROWS, COLUMNS = np.array([0, 1, 2, 0, 1, 2]), np.array([0, 1, 2, 1, 2, 0])


def matrices(six: np.ndarray) -> np.ndarray:
    """Symmetric matrices, shape (..., 3, 3), of shape (..., 6)."""
    return six[..., ENTRIES]


def six_of(matrix: np.ndarray) -> np.ndarray:
    """The six components, shape (..., 6), of the symmetric part of matrices, shape (..., 3, 3)."""
    return 0.5 * (matrix[..., ROWS, COLUMNS] + matrix[..., COLUMNS, ROWS])


def products(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """``a b`` for 3x3 matrices, shape (..., 3, 3), to the same bits in whatever batch."""
    total = np.zeros(np.broadcast_shapes(a.shape, b.shape))
    for k in range(3):
        total += a[..., :, k, None] * b[..., None, k, :]
    return total


def determinants(a: np.ndarray) -> np.ndarray:
    """Determinants of 3x3 matrices, shape (...)."""
    x, y, z = np.moveaxis(a, -2, 0)
    cross = np.cross(y, z)
    return x[..., 0] * cross[..., 0] + x[..., 1] * cross[..., 1] + x[..., 2] * cross[..., 2]


def trace(six: np.ndarray) -> np.ndarray:
    """Sum of the first three components, shape (...)."""
    return six[..., 0] + six[..., 1] + six[..., 2]


def principal(six: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Principal values, largest first, and their axes.

    Returns
    -------
    values : float64, shape (..., 3)
    axes : float64, shape (..., 3, 3)
        A unit vector for each value, in its row; of its two directions that whose largest component is positive.
        NaN where the tensor is not known.
    """
    known = np.isfinite(six).all(axis=-1)
    values, vectors = eigen(matrices(np.where(known[..., None], six, 0.0)))
    values, axes = values[..., ::-1], vectors.swapaxes(-1, -2)[..., ::-1, :]
    largest = np.take_along_axis(axes, np.abs(axes).argmax(axis=-1)[..., None], axis=-1)
    axes = axes * np.where(largest < 0.0, -1.0, 1.0)
    return np.where(known[..., None], values, np.nan), np.where(known[..., None, None], axes, np.nan)


def von_mises(six: np.ndarray) -> np.ndarray:
    """The equivalent stress of von Mises, shape (...)."""
    xx, yy, zz, xy, yz, zx = np.moveaxis(six, -1, 0)
    normal = 0.5 * ((xx - yy) ** 2 + (yy - zz) ** 2 + (zz - xx) ** 2)
    return np.sqrt(normal + 3.0 * (xy**2 + yz**2 + zx**2))
