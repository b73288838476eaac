"""Stretches of the bonds that there would be if all cells had points: what elements foretell of the next break.

Displacements stand at the eight points of every cell, interpolated where there are elements. Each number is a largest
of terms that depend on two points alone: the same bits in any order, and on any number of ranks.

Few cells are worth the search of their bonds. How far a cell is strained is told from its nodes, or from its own eight
points, and a bond's stretch is a mean of the strain along it.
"""

import math

import numpy as np
from numba import njit, types

from pdfem_mpi.kernels.gap_cuts import leaves
from pdfem_mpi.kernels.hex8 import GAUSS_POINTS, SHAPE_AT_GAUSS, shape_functions
from pdfem_mpi.kernels.simd import W, above, fma, lanes, load, splat

#: Rows of a cluster in the table: displacements, and positions.
ROWS = 6
#: A trilinear field at the corners, by its values at the points.
FROM_POINTS = np.ascontiguousarray(shape_functions(3.0 * GAUSS_POINTS).T)

_options = {"cache": True, "nogil": True, "boundscheck": False, "error_model": "numpy"}


@njit(**_options)
def follow_nodes(cells, first, connectivity, u, S):
    """Displace the points of some cells with their nodes (25).

    Parameters
    ----------
    cells : int64, shape (n,)
        Cells from ``first`` on, whose nodes are the rows of ``connectivity``.
    connectivity : int32, shape (n_following, 8)
    u : float64, shape (n_nodes, 3), dimension length
    S : float64, shape (n_cells * 48,)
        Two clusters a cell: displacements in rows 0-2, which are overwritten, and positions in rows 3-5 of six.
    """
    for cell in cells:
        nodes = connectivity[cell - first]
        for c in range(3):
            origin = u[nodes[0], c]
            for p in range(8):
                moved = 0.0
                for a in range(1, 8):
                    moved += SHAPE_AT_GAUSS[p, a] * (u[nodes[a], c] - origin)
                S[ROWS * W * (2 * cell + p // W) + W * c + p % W] = origin + moved


@njit(**_options)
def strains_by_nodes(connectivity, inverse, tapered, S, first, u, enough, strain):
    """Bound the largest principal strain in cells that follow nodes.

    Parameters
    ----------
    connectivity : int32, shape (n, 8)
    inverse : float64, shape (n, 3, 3), dimension length^-1
        ``d r_k / d x_d`` in the middle of each cell, indices k and d.
    tapered : bool, shape (n,)
        Cells that are no parallelepipeds: their strain is told from their corners, each with its own ``d r_k / d x_d``.
    S : float64, shape (n_cells * 48,)
        As of `follow_nodes`; of the cells from ``first`` on.
    u : float64, shape (n_nodes, 3), dimension length
    enough : float, dimension 1
        Below this a rough bound will do.
    strain : float64, shape (n,), dimension 1
        Overwritten.
    """
    moved, placed = np.empty((8, 3)), np.empty((8, 3))
    for cell in range(strain.size):
        for a in range(8):
            for c in range(3):
                moved[a, c] = u[connectivity[cell, a], c]
        if tapered[cell]:
            _read_points(S, first + cell, 3, placed)
            strain[cell] = _largest_of_tapered(moved, 1.0, placed)
        else:
            strain[cell] = _largest_strain(moved, inverse[cell], 1.0, enough)


@njit(**_options)
def strains_by_points(S, inverse, tapered, enough, strain):
    """Bound the largest principal strain in the first cells, from their points; as `strains_by_nodes`."""
    moved, placed = np.empty((8, 3)), np.empty((8, 3))
    for cell in range(strain.size):
        _read_points(S, cell, 0, moved)
        if tapered[cell]:
            _read_points(S, cell, 3, placed)
            strain[cell] = _largest_of_tapered(moved, math.sqrt(3.0), placed)
        else:
            strain[cell] = _largest_strain(moved, inverse[cell], math.sqrt(3.0), enough)


@njit(**_options)
def _read_points(S, cell, row, values):
    """Rows of a cell's points in the order of nodes, which go around a face, where points go row by row."""
    for a in range(8):
        p = a ^ (a >> 1 & 1)
        for c in range(3):
            values[a, c] = S[ROWS * W * (2 * cell + p // W) + W * (row + c) + p % W]


@njit(**_options)
def _split(u, wider, slope, bent, twist):
    """The gradient of a trilinear field in the middle, by r, s and t, and what differs from it at the corners."""
    for c in range(3):
        along = u[1, c] - u[0, c], u[2, c] - u[3, c], u[5, c] - u[4, c], u[6, c] - u[7, c]
        aside = u[3, c] - u[0, c], u[2, c] - u[1, c], u[7, c] - u[4, c], u[6, c] - u[5, c]
        upward = u[4, c] - u[0, c], u[5, c] - u[1, c], u[7, c] - u[3, c], u[6, c] - u[2, c]
        slope[0, c] = 0.125 * wider * (along[0] + along[1] + along[2] + along[3])
        slope[1, c] = 0.125 * wider * (aside[0] + aside[1] + aside[2] + aside[3])
        slope[2, c] = 0.125 * wider * (upward[0] + upward[1] + upward[2] + upward[3])
        second = 0.125 * wider * wider
        bent[0, c] = second * ((aside[2] - aside[0]) + (aside[3] - aside[1]))  # with s and t
        bent[1, c] = second * ((along[2] - along[0]) + (along[3] - along[1]))  # with r and t
        bent[2, c] = second * ((along[1] - along[0]) + (along[3] - along[2]))  # with r and s
        twist[c] = second * wider * ((along[3] - along[2]) - (along[1] - along[0]))


@njit(**_options)
def _to_corner(slope, bent, twist, corner, gradient):
    """The gradient at a corner, by r, s and t."""
    r, s, t = 2.0 * (corner & 1) - 1.0, 2.0 * (corner >> 1 & 1) - 1.0, 2.0 * (corner >> 2) - 1.0
    for c in range(3):
        gradient[0, c] = slope[0, c] + s * bent[2, c] + t * bent[1, c] + s * t * twist[c]
        gradient[1, c] = slope[1, c] + r * bent[2, c] + t * bent[0, c] + r * t * twist[c]
        gradient[2, c] = slope[2, c] + r * bent[1, c] + s * bent[0, c] + r * s * twist[c]


@njit(**_options)
def _largest_strain(u, inverse, wider, enough):
    """Bound the largest principal strain of a trilinear field in a parallelepiped, from eight places in nodes' order.

    That in the middle and the size of what changes in the cell; where that is too rough, the largest at its corners.

    Parameters
    ----------
    u : float64, shape (8, 3), dimension length
    inverse : float64, shape (3, 3), dimension length^-1
        ``d r_k / d x_d``.
    wider : float
        The cell over the box of the places.
    enough : float
        Below this a rough bound will do.
    """
    slope, bent, twist = np.empty((3, 3)), np.empty((3, 3)), np.empty(3)
    _split(u, wider, slope, bent, twist)
    changes = 0.0
    for p in range(3):
        size, steep = 0.0, 0.0
        for c in range(3):
            most = abs(bent[p - 1, c]) + abs(bent[p - 2, c]) + abs(twist[c])
            size += most * most
            steep += inverse[p, c] * inverse[p, c]
        changes += math.sqrt(size * steep)
    rough = _principal(slope, inverse) + changes
    if rough <= enough:
        return rough
    top, at_corner = 0.0, np.empty((3, 3))
    for corner in range(8):
        _to_corner(slope, bent, twist, corner, at_corner)
        top = max(top, _principal(at_corner, inverse))
    return min(top, rough)


@njit(**_options)
def _largest_of_tapered(u, wider, x):
    """The largest principal strain at the corners, nearly that inside; ``x``, (8, 3): the points in nodes' order."""
    slope, bent, twist, moved = np.empty((3, 3)), np.empty((3, 3)), np.empty(3), np.empty((3, 3))
    along, curved, warp, placed = np.empty((3, 3)), np.empty((3, 3)), np.empty(3), np.empty((3, 3))
    _split(u, wider, slope, bent, twist)
    _split(x, math.sqrt(3.0), along, curved, warp)
    top, inverse = 0.0, np.empty((3, 3))
    for corner in range(8):
        _to_corner(slope, bent, twist, corner, moved)
        _to_corner(along, curved, warp, corner, placed)
        volume = 0.0
        for k in range(3):
            for d in range(3):
                inverse[k, d] = (
                    placed[k - 2, d - 2] * placed[k - 1, d - 1] - placed[k - 2, d - 1] * placed[k - 1, d - 2]
                )
        for d in range(3):
            volume += placed[0, d] * inverse[0, d]
        for k in range(3):
            for d in range(3):
                inverse[k, d] /= volume
        top = max(top, _principal(moved, inverse))
    return top


@njit(**_options)
def gaps_between(S, cells, nodes, held, lowest, highest, apart):
    """How far cells that share a node would carry it to different places, each by its own eight points.

    Between two cells the field jumps by no more than that: jumps are bilinear on a face, and largest at its corners.

    Parameters
    ----------
    S : float64, shape (n_cells * 48,)
        As of `follow_nodes`.
    cells : int64, shape (n,)
    nodes : int32, shape (n, 8)
        Their nodes, by numbers among few.
    held : bool, shape (n_nodes, 3)
        Components across mirror planes: images carry the node the other way.
    lowest, highest : float64, shape (n_nodes, 3), dimension length
        Overwritten.
    apart : float64, shape (n,), dimension length
        The largest of each cell. Overwritten.
    """
    lowest[:], highest[:] = np.inf, -np.inf
    for k in range(cells.size):
        for a in range(8):
            node = nodes[k, a]
            for c in range(3):
                moved = 0.0
                for p in range(8):
                    moved += FROM_POINTS[a, p] * S[ROWS * W * (2 * cells[k] + p // W) + W * c + p % W]
                lowest[node, c] = min(lowest[node, c], moved)
                highest[node, c] = max(highest[node, c], moved)
                if held[node, c]:
                    lowest[node, c] = min(lowest[node, c], -moved)
                    highest[node, c] = max(highest[node, c], -moved)
    for k in range(cells.size):
        top = 0.0
        for a in range(8):
            square = 0.0
            for c in range(3):
                square += (highest[nodes[k, a], c] - lowest[nodes[k, a], c]) ** 2
            top = max(top, square)
        apart[k] = math.sqrt(top)


@njit(**_options)
def _principal(slope, inverse):
    """``tr / 3 + sqrt(2/3) |dev|`` of the strain, which its largest principal value does not pass."""
    trace, square = 0.0, 0.0
    for d in range(3):
        trace += slope[0, d] * inverse[0, d] + slope[1, d] * inverse[1, d] + slope[2, d] * inverse[2, d]
    for p in range(3):
        for c in range(3):
            strain = -trace / 3.0 if p == c else 0.0
            for k in range(3):
                strain += 0.5 * (slope[k, p] * inverse[k, c] + slope[k, c] * inverse[k, p])
            square += strain * strain
    return trace / 3.0 + math.sqrt(2.0 / 3.0 * square)


@njit(**_options)
def _bonds(S, a, b):
    """Squared lengths, and products with the changes, of the bonds from a point to those of a cluster."""
    gx = load(S, b + 3 * W) - splat(S[a + 3 * W])
    gy = load(S, b + 4 * W) - splat(S[a + 4 * W])
    gz = load(S, b + 5 * W) - splat(S[a + 5 * W])
    dx = load(S, b) - splat(S[a])
    dy = load(S, b + W) - splat(S[a + W])
    dz = load(S, b + 2 * W) - splat(S[a + 2 * W])
    return fma(gx, gx, fma(gy, gy, gz * gz)), fma(dx, gx, fma(dy, gy, dz * gz))


@njit(**_options)
def raise_bins(bins, members, number, around):
    """Largest number of the cells in each bin and the 26 bins around it.

    Parameters
    ----------
    bins : int64, shape (nx, ny, nz, 2)
        Where the cells of each bin begin and end in ``members``; the outermost bins are empty.
    members : int64, shape (n_cells,)
    number : float64, shape (n_cells,)
    around : float64, shape (nx, ny, nz)
        Overwritten.
    """
    around[:] = 0.0
    nx, ny, nz = around.shape
    for i in range(1, nx - 1):
        for j in range(1, ny - 1):
            for k in range(1, nz - 1):
                top = 0.0
                for m in range(bins[i, j, k, 0], bins[i, j, k, 1]):
                    top = max(top, number[members[m]])
                for a in range(i - 1, i + 2):
                    for b in range(j - 1, j + 2):
                        for c in range(k - 1, k + 2):
                            around[a, b, c] = max(around[a, b, c], top)


@njit(**_options)
def near_larger(bins, members, place, centre, reach2, number, more, around, more_around, limit, chosen):
    """Which of the first cells have a limit below the sum of the largest numbers of both kinds within the reach.

    Parameters
    ----------
    bins, members, number, around, more, more_around
        As of `raise_bins`.
    place : int32, shape (n_cells, 3)
        Bin of each cell.
    centre : float64, shape (n_cells, 3), dimension length
    reach2 : float, dimension length^2
        Bins are as wide as the reach.
    limit : float64, shape (n,)
    chosen : bool, shape (n,)
        Overwritten.
    """
    for cell in range(limit.size):
        i, j, k = place[cell]
        chosen[cell] = around[i, j, k] + more_around[i, j, k] > limit[cell] and _is_near_larger(
            bins, members, place, centre, reach2, number, more, cell, limit[cell]
        )


@njit(**_options)
def _is_near_larger(bins, members, place, centre, reach2, number, more, cell, limit):
    i, j, k = place[cell]
    top, most = 0.0, 0.0
    for a in range(i - 1, i + 2):
        for b in range(j - 1, j + 2):
            for c in range(k - 1, k + 2):
                for m in range(bins[a, b, c, 0], bins[a, b, c, 1]):
                    other = members[m]
                    if (number[other] > top or more[other] > most) and _are_near(centre, cell, other, reach2):
                        top, most = max(top, number[other]), max(most, more[other])
                        if top + most > limit:
                            return True
    return False


@njit(**_options)
def _are_near(centre, one, other, reach2):
    square = 0.0
    for d in range(3):
        square += (centre[other, d] - centre[one, d]) ** 2
    return square <= reach2


@njit(**_options)
def mark_around(bins, members, place, centre, reach2, cells, marked):
    """Mark the cells within the reach of some; ``marked``, bool, shape (n_cells,), the rest as of `near_larger`."""
    for cell in cells:
        i, j, k = place[cell]
        for a in range(i - 1, i + 2):
            for b in range(j - 1, j + 2):
                for c in range(k - 1, k + 2):
                    for m in range(bins[a, b, c, 0], bins[a, b, c, 1]):
                        if _are_near(centre, cell, members[m], reach2):
                            marked[members[m]] = True


@njit(**_options)
def raise_ratios(
    bins, members, place, centre, reach2, cells, S, class_of, inverse, cutoff2, cutoff, corners, planes, balls, lower,
    bin_size, n_bins, bin_start, bin_index, found, ratio,
):  # fmt: skip
    """Raise the ratios of some cells to the largest stretch over its limit of the bonds of their points.

    Parameters
    ----------
    bins, members, place, centre, reach2
        As of `near_larger`.
    cells : int64, shape (n,)
    S : float64, shape (n_cells * 48,)
        As of `follow_nodes`, complete for the cells and those around them.
    class_of : int64, shape (n_cells,)
    inverse : float64, shape (n_classes, n_classes)
        One over the critical stretch; 0 where bonds do not break.
    cutoff2 : float, dimension length^2
    cutoff, corners, planes, balls, lower, bin_size, n_bins, bin_start, bin_index, found
        The body's surface, which no bond crosses, as of `gap_cuts.cut_gaps`. ``balls`` may be empty.
    ratio : float64, shape (n_cells,)
        Raised for the cells given.
    """
    far = splat(cutoff2)
    for cell in cells:
        top = ratio[cell]
        i, j, k = place[cell]
        for a in range(i - 1, i + 2):
            for b in range(j - 1, j + 2):
                for c in range(k - 1, k + 2):
                    for m in range(bins[a, b, c, 0], bins[a, b, c, 1]):
                        other = members[m]
                        limit = inverse[class_of[cell], class_of[other]]
                        if limit == 0.0 or not _are_near(centre, cell, other, reach2):
                            continue
                        for q in range(2):
                            cluster = ROWS * W * (2 * other + q)
                            for p in range(8):
                                point = ROWS * W * (2 * cell + p // W) + p % W
                                square, work = _bonds(S, point, cluster)
                                larger = lanes(above(work * splat(limit), splat(top) * square))
                                if larger and larger & ~lanes(above(square, far)):
                                    top = _raised(
                                        S, point, cluster, limit, cutoff2, cutoff, corners, planes, balls, lower,
                                        bin_size, n_bins, bin_start, bin_index, found, top,
                                    )  # fmt: skip
        ratio[cell] = top


@njit(**_options)
def _raised(
    S, a, b, limit, cutoff2, cutoff, corners, planes, balls, lower, bin_size, n_bins, bin_start, bin_index, found, top
):  # fmt: skip
    """The largest of a ratio and those of the bonds from a point to the four of a cluster."""
    p, q, heights = np.empty(3), np.empty(3), np.empty(found.size)
    for k in range(W):
        square, work = 0.0, 0.0
        for d in range(3):
            xi = S[b + k + W * (3 + d)] - S[a + W * (3 + d)]
            square += xi * xi
            work += xi * (S[b + k + W * d] - S[a + W * d])
            p[d], q[d] = S[a + W * (3 + d)], S[b + k + W * (3 + d)]
        if square > cutoff2 or square == 0.0 or work / square * limit <= top:
            continue
        if not balls.size or not leaves(
            p, q, cutoff, corners, planes, balls, lower, bin_size, n_bins, bin_start, bin_index, found, heights
        ):  # fmt: skip
            top = work / square * limit
    return top


_i8, _f8, _table = types.int64[::1], types.float64[::1], types.float64[:, ::1]
_shapes = types.float64[:, :, ::1], types.boolean[::1]
_bins = (types.int64[:, :, :, ::1], _i8)
_places = (*_bins, types.int32[:, ::1], _table, types.float64)
SIGNATURES = {
    follow_nodes: types.void(_i8, types.int64, types.int32[:, ::1], _table, _f8),
    strains_by_nodes: types.void(types.int32[:, ::1], *_shapes, _f8, types.int64, _table, types.float64, _f8),
    strains_by_points: types.void(_f8, *_shapes, types.float64, _f8),
    gaps_between: types.void(_f8, _i8, types.int32[:, ::1], types.boolean[:, ::1], _table, _table, _f8),
    raise_bins: types.void(*_bins, _f8, types.float64[:, :, ::1]),
    near_larger: types.void(*_places, _f8, _f8, *2 * (types.float64[:, :, ::1],), _f8, types.boolean[::1]),
    mark_around: types.void(*_places, _i8, types.boolean[::1]),
    raise_ratios: types.void(
        *_places,
        _i8,
        _f8,
        _i8,
        _table,
        types.float64,
        types.float64,
        _table,
        _table,
        _table,
        _f8,
        types.float64,
        *4 * (_i8,),
        _f8,
    ),
}
