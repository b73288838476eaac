"""Initial cracks: bonds that cross a plane polygon are cut before the first load (mu = 0 in eq. 4)."""

import numpy as np
from numba import njit, types

from pdfem_mpi.kernels.simd import W

#: Reach of a polygon's edges, dimension length (in model units): above round-off of places, also of a body that lies a
#: million times its size from the origin, and far below any bond.
ROUND_OFF = 1e-6

_options = {"cache": True, "nogil": True, "boundscheck": False, "error_model": "numpy"}


@njit(**_options)
def cut_rows(row_start, row_offset, row_data, x, corners, normal, across, up, finite):
    """Cut every bond whose straight line passes through a polygon, its edges included.

    A bond that ends on the plane is cut too. The crossing point is the same bits from either end of the bond; edges
    reach `ROUND_OFF` far, so that rounding does not tell mirror images on an edge apart.

    Parameters
    ----------
    row_start, row_offset : int64 (n_points + 1,), uint32 (n_rows + 1,)
    row_data : float32, shape ((n_rows + 1) * (8 if finite else 4),)
        Stored numbers are set to 0 for cut bonds.
    x : float64, shape (n_clusters * 12,), dimension length
        Positions in cluster layout.
    corners : float64, shape (n_corners, 3), dimension length
        Of a simple polygon, convex or not.
    normal : float64, shape (3,)
        Of its plane.
    across, up : int
        Axes of the coordinate plane the polygon is seen in: the two besides the largest component of the normal.
    finite : bool
        Layout of ``row_data``.

    Returns
    -------
    int
        Number of bonds cut.
    """
    count = 0
    stride = 2 * W if finite else W
    n = corners.shape[0]
    for i in range(row_start.size - 1):
        own = 12 * (i // W) + i % W
        height_i = 0.0
        for d in range(3):
            height_i += normal[d] * (x[own + W * d] - corners[0, d])
        for row in range(row_start[i], row_start[i + 1]):
            c = np.int64(row_offset[row]) // 3
            for k in range(W):
                if row_data[row * stride + k] == 0.0:
                    continue
                height_j = 0.0
                for d in range(3):
                    height_j += normal[d] * (x[c + W * d + k] - corners[0, d])
                if height_i * height_j > 0.0 or (height_i == 0.0 and height_j == 0.0):
                    continue
                a, b = abs(height_i), abs(height_j)
                p = (b * x[own + W * across] + a * x[c + W * across + k]) / (a + b)
                q = (b * x[own + W * up] + a * x[c + W * up + k]) / (a + b)
                inside, on_edge = False, False
                before = n - 1
                for s in range(n):
                    if (corners[s, up] > q) != (corners[before, up] > q):
                        slope = (corners[before, across] - corners[s, across]) / (corners[before, up] - corners[s, up])
                        if p < corners[s, across] + slope * (q - corners[s, up]):
                            inside = not inside
                    along, rise = corners[s, across] - corners[before, across], corners[s, up] - corners[before, up]
                    ahead, above = p - corners[before, across], q - corners[before, up]
                    square = along * along + rise * rise
                    share = min(max((along * ahead + rise * above) / square, 0.0), 1.0) if square > 0.0 else 0.0
                    if (ahead - share * along) ** 2 + (above - share * rise) ** 2 <= ROUND_OFF * ROUND_OFF:
                        on_edge = True
                    before = s
                if inside or on_edge:
                    for t in range(0, stride, W):
                        row_data[row * stride + t + k] = 0.0
                    count += 1
    return count


_f8 = types.float64[::1]
SIGNATURES = {
    cut_rows: types.int64(
        types.int64[::1],
        types.uint32[::1],
        types.float32[::1],
        _f8,
        types.float64[:, ::1],
        _f8,
        types.int64,
        types.int64,
        types.boolean,
    ),
}
