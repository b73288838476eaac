"""The six rigid motions of a set of places: translations along x, y, z and small rotations about them."""

import numpy as np


def write_rigid_motion(x: np.ndarray, k: int, motion: np.ndarray) -> None:
    """Write translation ``k = 0..2``, or rotation ``k = 3..5`` about the origin.

    Parameters
    ----------
    x : float64, shape (n, 3, ...), dimension length
        Positions; the second axis are the components.
    k : int
    motion : float64, shape of ``x``
        Filled with 0 before; a rotation has the dimension of ``x``.
    """
    if k < 3:
        motion[:, k] = 1.0
    else:
        after, last = (k - 2) % 3, (k - 1) % 3
        motion[:, after] = -x[:, last]
        motion[:, last] = x[:, after]


def rigid_motions(x: np.ndarray) -> np.ndarray:
    """All six motions at positions (n, 3), float64, shape (6, n, 3)."""
    motions = np.zeros((6, len(x), 3))
    for k in range(6):
        write_rigid_motion(x, k, motions[k])
    return motions
