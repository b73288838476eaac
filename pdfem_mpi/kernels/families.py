"""Families of the collocation points within the cutoff radius, as half-list rows over clusters of four points.

A *row* is one point ``i`` against one cluster ``J`` of four points; it is kept when at least one of the four is in
the family of ``i``. Bonds inside a rank stand in the row of the point with the lower local index. A bond between
two ranks stands on one of them only: on the rank whose cell lies deeper (`peridynamics.sharing_bonds`); of equal depths
on the rank of the lower-numbered cell when the sum of the two cell numbers is even, else on the other. By the numbers
goes a bond across a mirror plane too: that to the image of a cell and its mirror image are one bond, kept in the row of
one of the two cells; of the bonds to images of its own cell a point keeps those to itself and to later points.

Positions are in *cluster layout*: ``x[cluster][component][lane]``, flat.
"""

import math

import numpy as np
from numba import njit, types

from pdfem_mpi.kernels.simd import W

#: A bond exists when ``r0 <= (1 + CUTOFF_GUARD) r_c``: round-off of positions never decides a bond.
CUTOFF_GUARD = 1e-6

_f8, _i8, _u4 = types.float64[::1], types.int64[::1], types.uint32[::1]


@njit(cache=True, nogil=True, boundscheck=False, error_model="numpy")
def cluster_balls(x, centre, radius):
    """Centre of the bounding box of each cluster and the largest distance of its points from it.

    Parameters
    ----------
    x : float64, shape (n_clusters * 12,), dimension length
        Positions in cluster layout.
    centre : float64, shape (n_clusters, 3), dimension length
        Overwritten.
    radius : float64, shape (n_clusters,), dimension length
        Overwritten.
    """
    for c in range(radius.size):
        for d in range(3):
            low = x[12 * c + W * d]
            high = low
            for k in range(1, W):
                low = min(low, x[12 * c + W * d + k])
                high = max(high, x[12 * c + W * d + k])
            centre[c, d] = 0.5 * (low + high)
        largest = 0.0
        for k in range(W):
            r2 = 0.0
            for d in range(3):
                r2 += (x[12 * c + W * d + k] - centre[c, d]) ** 2
            largest = max(largest, r2)
        radius[c] = math.sqrt(largest)


@njit(cache=True, nogil=True, boundscheck=False, error_model="numpy")
def find_rows(
    first, last, x, n_owned, ghosts, cell_number, neighbour, depth, centre, radius, cutoff, lower, bin_size, bins,
    bin_start, bin_index, row_start, row_offset, candidates,
):  # fmt: skip
    """Find the rows of the points of clusters from ``first`` on, up to ``last`` or as many as there is room for.

    Parameters
    ----------
    first, last : int
        Range of owned clusters.
    x : float64, shape (n_clusters * 12,), dimension length
        Positions of owned and ghost points in cluster layout.
    n_owned : int
        Number of owned clusters; clusters from there on are ghosts.
    ghosts : bool
        False: rows against owned clusters ``J >= own``. True: rows against the ghost clusters whose bonds
        this rank owns.
    cell_number : int64, shape (n_clusters / 2,)
        Global number of the peridynamic cell of each local cell; an image has that of its cell.
    neighbour, depth : int64, shape (n_clusters / 2,), float64, shape (n_clusters / 2, n_neighbours)
        Of each local cell: which of the neighbours owns it, -1 for none of them, and depths as in `Depths`.
    centre, radius : float64, shapes (n_clusters, 3), (n_clusters,), dimension length
        From `cluster_balls`.
    cutoff : float, dimension length
        Guarded cutoff radius.
    lower, bin_size, bins : float64 (3,), float, int64 (3,)
        Uniform grid of bins over the cluster centres.
    bin_start, bin_index : int64, shapes (n_bins + 1,), (n_clusters,)
        Clusters of each bin.
    row_start : int64, shape (n_owned * 4 + 1,)
        Written for the points of the clusters done: index of the first row of each point; the first must be set.
    row_offset : uint32, shape (n_room,)
        Start of the row's cluster in the point table, ``36 J``, from the first row of this call on.
    candidates : int64, shape (n_clusters,)
        Scratch.

    Returns
    -------
    int
        The first cluster that is not done.
    """
    limit = cutoff * cutoff
    widest = 0.0
    for c in range(radius.size):
        widest = max(widest, radius[c])
    nearest = np.full(3, np.inf)  # of the ghosts: most owned clusters are far from all of them
    farthest = np.full(3, -np.inf)
    if ghosts:
        for c in range(n_owned, radius.size):
            for d in range(3):
                nearest[d] = min(nearest[d], centre[c, d])
                farthest[d] = max(farthest[d], centre[c, d])
    before = row_start[W * first]
    row = before
    for own in range(first, last):
        number = cell_number[own // 2]
        window = cutoff + radius[own] + widest
        if ghosts:
            away = 0.0
            for d in range(3):
                away = max(away, nearest[d] - centre[own, d], centre[own, d] - farthest[d])
            if away > window * (1 + 1e-9):
                for lane in range(W):
                    row_start[W * own + lane + 1] = row
                continue
        low = np.empty(3, np.int64)
        high = np.empty(3, np.int64)
        for d in range(3):
            low[d] = max(0, math.floor((centre[own, d] - window - lower[d]) / bin_size))
            high[d] = min(bins[d] - 1, math.floor((centre[own, d] + window - lower[d]) / bin_size))
        n = 0
        for bz in range(low[2], high[2] + 1):
            for by in range(low[1], high[1] + 1):
                for bx in range(low[0], high[0] + 1):
                    b = (bz * bins[1] + by) * bins[0] + bx
                    for t in range(bin_start[b], bin_start[b + 1]):
                        c = bin_index[t]
                        if ghosts:
                            if c < n_owned:
                                continue
                            other = cell_number[c // 2]
                            k = neighbour[c // 2]
                            if k >= 0 and depth[own // 2, k] != depth[c // 2, k]:
                                if depth[own // 2, k] < depth[c // 2, k]:
                                    continue
                            elif number != other and (number < other) != ((number + other) % 2 == 0):
                                continue
                        elif c < own or c >= n_owned:
                            continue
                        reach = cutoff + radius[own] + radius[c]
                        r2 = 0.0
                        for d in range(3):
                            r2 += (centre[c, d] - centre[own, d]) ** 2
                        if r2 <= reach * reach * (1 + 1e-9):
                            candidates[n] = c
                            n += 1
        if row - before + W * n > row_offset.size:
            return own
        candidates[:n].sort()
        for lane in range(W):
            xi = x[12 * own + lane]
            yi = x[12 * own + W + lane]
            zi = x[12 * own + 2 * W + lane]
            for t in range(n):
                c = candidates[t]
                start = 0
                if c == own:
                    start = lane + 1
                elif ghosts and cell_number[c // 2] == number:  # an image of the own cell
                    start = max(0, W * (own % 2 - c % 2) + lane)
                for k in range(start, W):
                    dx = x[12 * c + k] - xi
                    dy = x[12 * c + W + k] - yi
                    dz = x[12 * c + 2 * W + k] - zi
                    if dx * dx + dy * dy + dz * dz <= limit:
                        row_offset[row - before] = 9 * W * c
                        row += 1
                        break
            row_start[W * own + lane + 1] = row
    return last


@njit(cache=True, nogil=True, boundscheck=False, error_model="numpy")
def count_rows(row_start, row_offset, rows_of_point, rows_at_cluster):
    """Number of rows of each point and of rows that point at each cluster (both added to).

    Parameters
    ----------
    row_start : int64, shape (n_points + 1,)
    row_offset : uint32, shape (n_rows + 1,)
    rows_of_point : int64, shape (n_points,)
    rows_at_cluster : int64, shape (n_clusters,)
    """
    for i in range(row_start.size - 1):
        rows_of_point[i] += row_start[i + 1] - row_start[i]
    for row in range(row_start[row_start.size - 1]):
        rows_at_cluster[row_offset[row] // (9 * W)] += 1


@njit(cache=True, nogil=True, boundscheck=False, error_model="numpy")
def fill_rows(
    row_start, row_offset, row_data, x, volume, factor, constants, material, cutoff, finite, strongest, counts
):  # fmt: skip
    """Write the stored numbers of every slot of the rows (eq. 2, with the correction of eq. A12 in it).

    Finite kinematics store ``K = 1/2 c exp(-r0^2) g_ij w_i w_j / r0`` and ``1 / r0^2`` (two numbers a slot),
    linear kinematics ``K' = c exp(-r0^2) g_ij w_i w_j / r0^3``; lengths in units of the internal length, ``g_ij``
    from eqs (A8)-(A10). Slots without a bond get zeros. All expressions are symmetric in the two points.

    Parameters
    ----------
    row_start, row_offset : int64 (n_points + 1,), uint32 (n_rows + 1,)
    row_data : float32, shape ((n_rows + 1) * (8 if finite else 4),)
        Overwritten; the padding row stays 0.
    x : float64, shape (n_clusters * 12,), dimension length / l
    volume : float64, shape (n_clusters * 4,), dimension length^3 / l^3
        Integration weights ``w``.
    factor : float64, shape (n_clusters * 12,) or (0,)
        Correction vectors ``g_c`` (eq. A11) in cluster layout; size 0: no correction, ``g_ij = 1``.
    constants : float64, shape (n_materials, n_materials)
        ``c = 9 k / pi`` in model units, of the bonds between two materials; symmetric.
    material : int16, shape (n_clusters / 2,)
        Material of each local cell: a row has one pair of them.
    cutoff : float
        Guarded cutoff radius / l.
    finite : bool
    strongest : float64, shape (2,), dimensions force and force / length
        Raised to the largest ``c exp(-r0^2) g_ij w_i w_j``, the force of a bond per unit stretch, and to the
        largest half of that over ``r0``.
    counts : int64, shape (n_materials, n_materials)
        The numbers of bonds from a material of the rows' points to one of the rows' clusters; added to.
    """
    limit = cutoff * cutoff
    stride = 2 * W if finite else W
    gamma = np.empty(3)
    for i in range(row_start.size - 1):
        own = i // W
        lane = i - W * own
        for row in range(row_start[i], row_start[i + 1]):
            c = np.int64(row_offset[row]) // (9 * W)
            a, b = material[own // 2], material[c // 2]
            constant = constants[a, b]
            count = 0
            for k in range(W):
                dx = x[12 * c + k] - x[12 * own + lane]
                dy = x[12 * c + W + k] - x[12 * own + W + lane]
                dz = x[12 * c + 2 * W + k] - x[12 * own + 2 * W + lane]
                r2 = dx * dx + dy * dy + dz * dz
                if r2 > limit or (c == own and k <= lane):
                    for s in range(0, stride, W):
                        row_data[row * stride + s + k] = 0.0
                    continue
                count += 1
                strength = constant * math.exp(-r2) * (volume[i] * volume[W * c + k])
                if factor.size:
                    for d in range(3):
                        gamma[d] = 0.5 * (factor[12 * own + W * d + lane] + factor[12 * c + W * d + k])
                    inverse = (dx / gamma[0]) ** 2 + (dy / gamma[1]) ** 2 + (dz / gamma[2]) ** 2
                    strength *= math.sqrt(r2 / inverse)
                strongest[0] = max(strongest[0], strength)
                strongest[1] = max(strongest[1], 0.5 * strength / math.sqrt(r2))
                if finite:
                    row_data[row * stride + k] = 0.5 * strength / math.sqrt(r2)
                    row_data[row * stride + W + k] = 1.0 / r2
                else:
                    row_data[row * stride + k] = strength / (r2 * math.sqrt(r2))
            counts[a, b] += count


SIGNATURES = {
    cluster_balls: types.void(_f8, types.float64[:, ::1], _f8),
    find_rows: types.int64(
        types.int64, types.int64, _f8, types.int64, types.boolean, _i8, _i8, types.float64[:, ::1],
        types.float64[:, ::1], _f8, types.float64, _f8, types.float64, _i8, _i8, _i8, _i8, _u4, _i8,
    ),
    count_rows: types.void(_i8, _u4, _i8, _i8),
    fill_rows: types.void(
        _i8, _u4, types.float32[::1], _f8, _f8, _f8, types.float64[:, ::1], types.int16[::1], types.float64,
        types.boolean, _f8, types.int64[:, ::1],
    ),
}  # fmt: skip
