"""Structured meshes."""

import math

import numpy as np

from pdfem_mpi.kernels.banded import factor_of_band, solution_of_band
from pdfem_mpi.mesh.extrusion import Extrusion, Grid, Plane
from pdfem_mpi.mesh.hexmesh import HexMesh

#: Edges of the square left out around a hole, per radius over spacing. The circle has as many edges as the square:
#: 4 * 1.75 for a circumference of 2 pi, so they are 0.9 of the spacing.
SQUARE_RATIO = 1.75
#: Rings of cells between that square and the circle, per radius over spacing; at least one.
RING_RATIO = 1 / 8
#: The same, per width of the ligament beside the hole over spacing: narrow ligaments have one ring.
RINGS_PER_LIGAMENT = 1 / 4
#: Reach of the graded cells around the hole's centre, in radii, and from its edge, in spacings; the larger one.
GRADED_RADII, GRADED_CELLS = 2.0, 5.0
#: Smoothing turns, each moving every node half-way; an edge's length is its weight in a turn.
TURNS = 8
#: Solves with a factor in single precision, each on what the last one missed.
REFINEMENTS = 6


def box(lower, upper, n_cells) -> HexMesh:
    """Equal cells in a box, all of them; see `box_layers`."""
    return box_layers(lower, upper, n_cells).whole()


def box_layers(lower, upper, n_cells) -> Extrusion:
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
    x, y, z = axes
    return Extrusion(Grid((x, y)), z)


def plate_with_hole(lower, upper, hole_radius, spacing, symmetry=()) -> HexMesh:
    """A plate with a hole, all of it; see `plate_layers`."""
    return plate_layers(lower, upper, hole_radius, spacing, symmetry).whole()


def plate_layers(lower, upper, hole_radius, spacing, symmetry=()) -> Extrusion:
    """A plate with a circular hole through its thickness (z) at its centre (Fig. 13).

    Far from the hole cells are cubes of the regular grid of `box`. A square of that grid is left out at the hole, and
    rings of cells fill the space between its edge and the circle. Nodes of the rings and of the grid up to
    ``GRADED_RADII`` radii from the centre are then moved to where edges are short: they lie between about 0.6 and 1.5
    spacings at a hole of 6 or more spacings with a radius of room around it (0.2 at the smallest hole), and all
    interfaces conform. Mirror images in x and y have the same bits about a centre at 0.

    Parameters
    ----------
    lower, upper : three floats, dimension length
        Opposite corners of the plate, or of what mirror planes leave of it; every side is a whole number of spacings.
    hole_radius : float, dimension length
        At least 2 spacings, and at least 2 spacings away from the edges of the plate.
    spacing : float, dimension length
    symmetry : faces
        Mirror planes: of a plate mirrored at ``x-``, ``x+``, ``y-`` or ``y+`` the part that is not an image is made,
        with the same nodes as the whole plate has there.
    """
    lower, upper = np.array(lower, float), np.array(upper, float)
    n_cells = np.rint((upper - lower) / spacing).astype(np.int64)
    kept_side = np.array([(f"{axis}-" in symmetry) - (f"{axis}+" in symmetry) for axis in "xy"])
    side = (upper - lower)[:2]
    mirror = np.where(kept_side > 0, lower[:2], upper[:2])
    lower[:2] -= np.where(kept_side > 0, side, 0.0)
    upper[:2] += np.where(kept_side < 0, side, 0.0)
    n_cells[:2] *= 1 + np.abs(kept_side)
    place, quads, square = _plane_cells(n_cells[:2], hole_radius / spacing)
    pitch = (upper - lower)[:2] / n_cells[:2]
    offset = _smooth(place, quads, square, n_cells[:2], pitch, hole_radius)
    centre = 0.5 * (lower + upper)
    plane = centre[:2] + offset
    for d in range(2):
        plane[place[:, 1 + d] == -n_cells[d], d] = lower[d]
        plane[place[:, 1 + d] == n_cells[d], d] = upper[d]
        if kept_side[d]:
            plane[place[:, 1 + d] == 0, d] = mirror[d]
    plane, quads = _kept_part(plane, quads, place[:, 1:] * kept_side)

    t = np.arange(n_cells[2] + 1) / n_cells[2]
    return Extrusion(Plane(plane, quads), lower[2] * (1.0 - t) + upper[2] * t)


def _kept_part(plane: np.ndarray, quads: np.ndarray, depth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Nodes and cells of the plane on the side of positive ``depth``, shape (n_nodes, 2), in both directions."""
    quads = quads[(depth[quads] >= 0).all(axis=(1, 2))]
    used = np.unique(quads)
    number = np.full(len(plane), -1)
    number[used] = np.arange(len(used))
    return plane[used], number[quads]


def _plane_cells(n_cells, radius: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Topology of the plate's plane: the grid without a square, and rings inside the square.

    Parameters
    ----------
    n_cells : int64, shape (2,)
    radius : float
        Of the hole, in spacings.

    Returns
    -------
    place : int64, shape (n, 3)
        Ring of each node (0: on the grid) and twice its distances from the centre, in cells; for a node of a ring those
        of the node on the square's edge that it belongs to.
    quads : int64, shape (n_quads, 4)
        Nodes of each cell, counter-clockwise; the cells of the grid with x fastest, then ring by ring.
    square : int64, shape (2,)
        Edges of the square along x and y.
    """
    square = n_cells - 2 * np.ceil((n_cells - SQUARE_RATIO * radius - 1) / 2).astype(np.int64)
    square = np.clip(square, 2 + n_cells % 2, n_cells - 2)
    ligament = 0.5 * n_cells.min() - radius
    rings = max(1, round(min(RING_RATIO * radius, RINGS_PER_LIGAMENT * ligament)))
    columns, rows = n_cells + 1
    b, a = np.meshgrid(*(2 * np.arange(n + 1) - n for n in n_cells[::-1]), indexing="ij")
    inside = (np.abs(a) < square[0]) & (np.abs(b) < square[1])
    number = np.where(inside, -1, np.cumsum(~inside.reshape(-1)).reshape(rows, columns) - 1)
    grid = np.stack([number[:-1, :-1], number[:-1, 1:], number[1:, 1:], number[1:, :-1]], axis=-1).reshape(-1, 4)
    left_out = (np.abs(a[:-1, :-1] + 1) < square[0]) & (np.abs(b[:-1, :-1] + 1) < square[1])
    grid = grid[~left_out.reshape(-1)]

    i, j = (n_cells - square) // 2
    m, n = square
    edge = np.concatenate(
        [
            number[j : j + n, i + m],
            number[j + n, i + m : i : -1],
            number[j + n : j : -1, i],
            number[j, i : i + m],
        ]
    )
    loops = number.max() + 1 + np.arange(rings * len(edge)).reshape(rings, len(edge))
    outer, inner = np.concatenate([edge[None], loops[:-1]]), loops
    ring = np.stack([inner, outer, np.roll(outer, -1, axis=1), np.roll(inner, -1, axis=1)], axis=-1)
    on_grid = np.column_stack([np.zeros(np.count_nonzero(~inside), np.int64), a[~inside], b[~inside]])
    on_rings = np.tile(on_grid[edge], (rings, 1))
    on_rings[:, 0] = np.repeat(np.arange(1, rings + 1), len(edge))
    return np.concatenate([on_grid, on_rings]), np.concatenate([grid, ring.reshape(-1, 4)]), square


def _smooth(place, quads, square, n_cells, pitch, hole_radius: float) -> np.ndarray:
    """Positions of the plane's nodes from the centre, shape (n, 2), dimension length.

    The free nodes minimise the sum of the squares, and from there nearly that of the cubes, of all edge lengths.
    """
    from scipy import sparse

    n_edges = 2 * int(square.sum())
    offset = 0.5 * place[:, 1:] * pitch
    circle = slice(len(place) - n_edges, len(place))
    angle = 2.0 * math.pi / n_edges * (np.arange(n_edges) - 0.5 * square[1])
    offset[circle] = hole_radius * np.column_stack([[function(a) for a in angle] for function in (math.cos, math.sin)])
    radius = hole_radius / pitch
    reach = 2 * np.rint(np.maximum(GRADED_RADII * radius, radius + GRADED_CELLS)).astype(np.int64)
    reach = np.minimum(reach, n_cells)
    free = (np.abs(place[:, 1:]) < np.maximum(reach, square + 2)).all(axis=1)
    free[circle] = False

    edges = np.concatenate([quads[:, [k, (k + 1) % 4]] for k in range(4)])
    edges = np.unique(np.sort(edges[free[edges].any(axis=1)], axis=1), axis=0)
    for turn in range(TURNS + 1):
        length = np.hypot(*(offset[edges[:, 0]] - offset[edges[:, 1]]).T)
        weight = length if turn else np.ones(len(edges))
        pull = sparse.coo_matrix((weight, tuple(edges.T)), shape=(len(place),) * 2)
        pull = (pull + pull.T).tocsr()[free]
        stiffness = sparse.diags_array(np.asarray(pull.sum(axis=1)).reshape(-1)) - pull[:, free]
        best = _solved(stiffness.tocsr(), pull[:, ~free] @ offset[~free])
        offset[free] = 0.5 * (offset[free] + best) if turn else best
    return _mirrored(place, offset)


def _solved(matrix, right: np.ndarray) -> np.ndarray:
    """Solutions for right-hand sides (n, k) of a sparse symmetric positive matrix, to the last digits."""
    from scipy.sparse.csgraph import breadth_first_order

    # neighbours stay near one another; the order of Cuthill and McKee has ties that processors break in different ways
    first = int(np.argmin(np.diff(matrix.indptr)))
    order = breadth_first_order(matrix, first, directed=False, return_predecessors=False)[::-1].astype(np.int64)
    order = np.concatenate([order, np.setdiff1d(np.arange(matrix.shape[0]), order)])
    entries = matrix[order][:, order].tocoo()
    lower = entries.row >= entries.col
    row, column = (index[lower].astype(np.int64) for index in (entries.row, entries.col))
    factor = factor_of_band(row, column, entries.data[lower], len(order))
    x = np.zeros_like(right)
    for _ in range(REFINEMENTS):  # the factor is in single precision
        miss = right - matrix @ x
        for column in range(right.shape[1]):
            x[order, column] += solution_of_band(*factor, miss[order, column])
    return x


def _mirrored(place, offset) -> np.ndarray:
    """Positions with the bits of those in the first quadrant, and exactly 0 on the axes."""
    width = 2 * int(np.abs(place).max()) + 1
    first = np.abs(place)
    code = [(p[:, 0] * width + p[:, 1]) * width + p[:, 2] for p in (first, place)]
    order = np.argsort(code[1], kind="stable")
    quadrant = order[np.searchsorted(code[1][order], code[0])]
    return np.sign(place[:, 1:]) * np.abs(offset[quadrant])
