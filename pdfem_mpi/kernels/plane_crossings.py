"""Energy of the bonds that planes through a body cut, mean over the planes' places.

A plane normal to axis d cuts a bond over a part ``|xi_d|`` of its places: summed over all of them, the energies of the
bonds that are cut are the sum over all bonds of energy times ``|xi_d|``. Half of each bond belongs to either end.
"""

import numpy as np
from numba import njit, types

from pdfem_mpi.kernels.simd import W

#: Label of clusters that do not count.
NO_LABEL = 255

_options = {"cache": True, "nogil": True, "boundscheck": False, "error_model": "numpy"}


@njit(**_options)
def add_crossings(row_start, row_offset, row_data, x, label, finite, quantum, sums):
    """Add the energies at unit stretch times ``|xi_d|`` of all bonds to the labels of their ends, each a half.

    Parameters
    ----------
    row_start, row_offset, row_data
        Rows as in the sweeps.
    x : float64, shape (n_clusters * 12,), dimension length
        Positions in cluster layout.
    label : uint8, shape (n_clusters,)
        `NO_LABEL`, or a row of ``sums``.
    finite : bool
    quantum : float, dimension force length^2
        Terms are rounded to multiples of it, so that sums are exact.
    sums : int64, shape (n_labels, 3)
        Added to, in quanta.
    """
    stride = 2 * W if finite else W
    term = np.empty(3, np.int64)
    for i in range(row_start.size - 1):
        own = 12 * (i // W) + i % W
        mine = label[i // W]
        for row in range(row_start[i], row_start[i + 1]):
            c = np.int64(row_offset[row]) // (9 * W)
            other = label[c]
            if mine == NO_LABEL and other == NO_LABEL:
                continue
            for k in range(W):
                strength = np.float64(row_data[row * stride + k])
                if strength == 0.0:
                    continue
                square = 0.0
                for d in range(3):
                    xi = x[12 * c + W * d + k] - x[own + W * d]
                    square += xi * xi
                energy = strength * square if finite else 0.5 * strength * square * square
                for d in range(3):
                    xi = x[12 * c + W * d + k] - x[own + W * d]
                    term[d] = np.int64(np.rint(0.5 * energy * abs(xi) / quantum))
                for d in range(3):
                    if mine != NO_LABEL:
                        sums[mine, d] += term[d]
                    if other != NO_LABEL:
                        sums[other, d] += term[d]


_i8 = types.int64[::1]
SIGNATURES = {
    add_crossings: types.void(
        _i8, types.uint32[::1], types.float32[::1], types.float64[::1], types.uint8[::1], types.boolean,
        types.float64, types.int64[:, ::1],
    ),
}  # fmt: skip
