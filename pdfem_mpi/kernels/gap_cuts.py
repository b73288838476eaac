"""Bonds whose straight line leaves the body: they would reach across a notch, a hole or an inner corner.

The surface of the body is a set of triangles that closes around it, with normals outwards. Both ends of a bond lie
inside, so a line leaves the body through one triangle and comes back through another, and the length outside is the sum
of where it comes back less the sum of where it leaves: no order of crossings, and nothing to pair.

The caller moves the surface by a tiny way along no direction of a lattice. A line through an edge or a corner of it
then meets one of the triangles there, and one that only touches an edge is outside for a length of no account.
"""

import math

import numpy as np
from numba import njit, types

from pdfem_mpi.kernels.simd import W

#: A bond is cut if it is outside for longer than this, dimension length (in model units): far above round-off and what
#: touching an edge comes to, far below what matters.
OUTSIDE = 1e-5

_options = {"cache": True, "nogil": True, "boundscheck": False, "error_model": "numpy"}


@njit(**_options)
def find_near(x, y, z, reach, balls, lower, bin_size, bins, bin_start, bin_index, found):
    """List the triangles whose balls come within ``reach`` of a place; how many.

    Parameters
    ----------
    x, y, z, reach : float, dimension length
    balls : float64, shape (n_triangles, 4), dimension length
        Centre and radius.
    lower, bin_size, bins : float64 (3,), float, int64 (3,)
        Uniform grid of bins over the centres.
    bin_start, bin_index : int64, shapes (n_bins + 1,), (n_triangles,)
    found : int64, shape (n_triangles + 1,)
        Overwritten from its start; its last number is the triangle with the largest ball.
    """
    widest = balls[found[-1], 3]
    window, n = reach + widest, 0
    low, high = np.empty(3, np.int64), np.empty(3, np.int64)
    for d in range(3):
        place = x if d == 0 else (y if d == 1 else z)
        low[d] = max(0, math.floor((place - window - lower[d]) / bin_size))
        high[d] = min(bins[d] - 1, math.floor((place + window - lower[d]) / bin_size))
    for bz in range(low[2], high[2] + 1):
        for by in range(low[1], high[1] + 1):
            for bx in range(low[0], high[0] + 1):
                b = (bz * bins[1] + by) * bins[0] + bx
                for s in range(bin_start[b], bin_start[b + 1]):
                    t = bin_index[s]
                    away = (balls[t, 0] - x) ** 2 + (balls[t, 1] - y) ** 2 + (balls[t, 2] - z) ** 2
                    if away <= (reach + balls[t, 3]) ** 2:
                        found[n] = t
                        n += 1
    return n


@njit(**_options)
def mark_faced(x, centre, radius, cutoff, planes, balls, lower, bin_size, bins, bin_start, bin_index, found, faced):
    """Mark the triangles that have a point in front of them within the cutoff radius: bonds can cross no others.

    Parameters
    ----------
    x : float64, shape (n_clusters * 12,), dimension length
        Positions in cluster layout.
    centre, radius : float64, shapes (n_clusters, 3), (n_clusters,), dimension length
        From `families.cluster_balls`.
    cutoff : float, dimension length
    planes : float64, shape (n_triangles, 4)
        Outward normal, and its product with a corner.
    balls, lower, bin_size, bins, bin_start, bin_index, found
        As of `find_near`.
    faced : bool, shape (n_triangles,)
        Set.
    """
    for c in range(radius.size):
        n = find_near(
            centre[c, 0], centre[c, 1], centre[c, 2], cutoff + radius[c], balls, lower, bin_size, bins, bin_start,
            bin_index, found,
        )  # fmt: skip
        for s in range(n):
            t = found[s]
            for k in range(12 * c, 12 * c + W):
                if planes[t, 0] * x[k] + planes[t, 1] * x[k + W] + planes[t, 2] * x[k + 2 * W] > planes[t, 3]:
                    faced[t] = True


@njit(**_options)
def cut_gaps(
    row_start, row_offset, row_data, x, centre, radius, cutoff, corners, planes, balls, lower, bin_size, bins,
    bin_start, bin_index, found, material, finite, counts,
):  # fmt: skip
    """Take out every bond whose straight line leaves the body.

    Parameters
    ----------
    row_start, row_offset : int64 (n_points + 1,), uint32 (n_rows + 1,)
    row_data : float32, shape ((n_rows + 1) * (8 if finite else 4),)
        Stored numbers are set to 0 for bonds that are taken out.
    x, centre, radius, cutoff, planes, balls, lower, bin_size, bins, bin_start, bin_index, found
        As of `mark_faced`.
    corners : float64, shape (n_triangles, 9), dimension length
        Counter-clockwise as seen from outside.
    material : int16, shape (n_clusters / 2,)
        Material of each local cell.
    finite : bool
        Layout of ``row_data``.
    counts : int64, shape (n_materials, n_materials)
        Bonds by materials; those taken out are subtracted.
    """
    stride = 2 * W if finite else W
    p, q, heights = np.empty(3), np.empty(3), np.empty(found.size)
    for own in range((row_start.size - 1) // W):
        near = find_near(
            centre[own, 0], centre[own, 1], centre[own, 2], cutoff + radius[own], balls, lower, bin_size, bins,
            bin_start, bin_index, found,
        )  # fmt: skip
        if near == 0:
            continue
        for i in range(W * own, W * own + W):
            for d in range(3):
                p[d] = x[12 * own + W * d + i % W]
            for s in range(near):
                heights[s] = _height(planes, found[s], p)
            for row in range(row_start[i], row_start[i + 1]):
                c = np.int64(row_offset[row]) // 3
                for k in range(W):
                    if row_data[row * stride + k] == 0.0:
                        continue
                    for d in range(3):
                        q[d] = x[c + W * d + k]
                    if _outside(p, q, heights, corners, planes, found, near) > OUTSIDE:
                        for s in range(0, stride, W):
                            row_data[row * stride + s + k] = 0.0
                        counts[material[own // 2], material[c // 24]] -= 1


@njit(**_options)
def leaves(p, q, cutoff, corners, planes, balls, lower, bin_size, bins, bin_start, bin_index, found, heights):
    """Whether the bond from p to q, float64 (3,), leaves the body; ``heights``, (n_triangles + 1,), is overwritten."""
    near = find_near(p[0], p[1], p[2], cutoff, balls, lower, bin_size, bins, bin_start, bin_index, found)
    for s in range(near):
        heights[s] = _height(planes, found[s], p)
    return _outside(p, q, heights, corners, planes, found, near) > OUTSIDE


@njit(**_options)
def _height(planes, t, p):
    """Of a place over the plane of a triangle, outwards."""
    return planes[t, 0] * p[0] + planes[t, 1] * p[1] + planes[t, 2] * p[2] - planes[t, 3]


@njit(**_options)
def _outside(p, q, heights, corners, planes, found, near):
    """Length of the line from p to q outside of the body, by the triangles listed and the heights of p over them."""
    total = 0.0
    for s in range(near):
        ahead = _height(planes, found[s], q)
        if (heights[s] > 0.0) == (ahead > 0.0) or not _pierces(p, q, corners, found[s]):
            continue
        place = heights[s] / (heights[s] - ahead)
        total += place if ahead <= 0.0 else -place
    if total <= 0.0:
        return 0.0
    return total * math.sqrt((q[0] - p[0]) ** 2 + (q[1] - p[1]) ** 2 + (q[2] - p[2]) ** 2)


@njit(**_options)
def _pierces(p, q, corners, t):
    """Whether the unbounded line through p and q passes through a triangle.

    On which side of an edge it passes is the sign of one product, and that of the edge as the neighbouring triangle
    runs along it is its exact negative: the line finds no gap between the two.
    """
    side = 0
    for e in range(3):
        a, b = 3 * e, 3 * ((e + 1) % 3)
        ax, ay, az = corners[t, a] - p[0], corners[t, a + 1] - p[1], corners[t, a + 2] - p[2]
        bx, by, bz = corners[t, b] - p[0], corners[t, b + 1] - p[1], corners[t, b + 2] - p[2]
        product = (q[0] - p[0]) * (ay * bz - az * by)
        product += (q[1] - p[1]) * (az * bx - ax * bz)
        product += (q[2] - p[2]) * (ax * by - ay * bx)
        side += 1 if product > 0.0 else -1
    return side == 3 or side == -3


_f8, _i8, _table = types.float64[::1], types.int64[::1], types.float64[:, ::1]
_bins = (_f8, types.float64, _i8, _i8, _i8, _i8)
SIGNATURES = {
    mark_faced: types.void(_f8, _table, _f8, types.float64, _table, _table, *_bins, types.boolean[::1]),
    cut_gaps: types.void(
        _i8, types.uint32[::1], types.float32[::1], _f8, _table, _f8, types.float64, _table, _table, _table, *_bins,
        types.int16[::1], types.boolean, types.int64[:, ::1],
    ),
}  # fmt: skip
