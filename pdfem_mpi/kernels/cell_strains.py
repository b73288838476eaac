"""How far cells are strained, from their nodes or their own eight points, and what opens between them.

Few cells are worth the search of their bonds: a bond's stretch is a mean of the strain along it.
"""

import math

import numpy as np
from numba import njit, types

from pdfem_mpi.kernels.hex8 import GAUSS_POINTS, shape_functions
from pdfem_mpi.kernels.simd import W

#: Rows of a cluster in the table of points: displacements, and positions.
ROWS = 6
#: A trilinear field at the corners, by its values at the points.
FROM_POINTS = np.ascontiguousarray(shape_functions(3.0 * GAUSS_POINTS).T)

_options = {"cache": True, "nogil": True, "boundscheck": False, "error_model": "numpy"}


@njit(**_options)
def strains_by_nodes(connectivity, inverse, steep, tapered, S, first, u, enough, strain):
    """Bound the largest principal strain in cells that follow nodes.

    Parameters
    ----------
    connectivity : int32, shape (n, 8)
    inverse : float64, shape (n, 3, 3), dimension length^-1
        ``d r_k / d x_d`` in the middle of each cell, indices k and d.
    steep : float64, shape (n,), dimension length^-1
        Half the sum of the lengths of its rows, of parallelepipeds: times the size of the box around the displacements
        of a cell's nodes it bounds the strain.
    tapered : bool, shape (n,)
        Cells that are no parallelepipeds: their strain is told from their corners, each with its own ``d r_k / d x_d``.
    S : float64, shape (n_cells * 48,)
        Two clusters a cell: displacements in rows 0-2, positions in rows 3-5 of six; of the cells from ``first`` on.
    u : float64, shape (n_nodes, 3), dimension length
    enough : float, dimension 1
        Below this a rough bound will do.
    strain : float64, shape (n,), dimension 1
        Overwritten.
    """
    moved, placed = np.empty((8, 3)), np.empty((8, 3))
    for cell in range(strain.size):
        box = 0.0
        for c in range(3):
            low = high = u[connectivity[cell, 0], c]
            for a in range(1, 8):
                value = u[connectivity[cell, a], c]
                low, high = min(low, value), max(high, value)
            box += (high - low) ** 2
        box = math.sqrt(box)
        if not tapered[cell] and steep[cell] * box <= enough:
            strain[cell] = steep[cell] * box
            continue
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
def gaps_between(S, cells, nodes, held, lowest, highest, apart):
    """How far cells that share a node would carry it to different places, each by its own eight points.

    Between two cells the field jumps by no more than that: jumps are bilinear on a face, and largest at its corners.

    Parameters
    ----------
    S : float64, shape (n_cells * 48,)
        As of `strains_by_nodes`.
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


_f8, _table, _real = types.float64[::1], types.float64[:, ::1], types.float64
_shapes = types.float64[:, :, ::1], types.boolean[::1]
SIGNATURES = {
    strains_by_nodes: types.void(
        types.int32[:, ::1], _shapes[0], _f8, _shapes[1], _f8, types.int64, _table, _real, _f8
    ),
    strains_by_points: types.void(_f8, *_shapes, _real, _f8),
    gaps_between: types.void(_f8, types.int64[::1], types.int32[:, ::1], types.boolean[:, ::1], _table, _table, _f8),
}
