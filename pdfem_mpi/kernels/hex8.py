"""The trilinear hexahedron: shape functions and its 2x2x2 Gauss rule.

Nodes are in VTK order: bottom quadrilateral counter-clockwise, then the top one. Gauss points are numbered
``g = gx + 2 gy + 4 gz``, all with weight 1. The same eight points integrate the elements and carry the bonds.
Sums over the nodes are written as loops, so a cell gives the same bits in whatever batch it is computed.
"""

import numpy as np

REFERENCE_NODES = np.array(
    [(-1, -1, -1), (1, -1, -1), (1, 1, -1), (-1, 1, -1), (-1, -1, 1), (1, -1, 1), (1, 1, 1), (-1, 1, 1)],
    float,
)
GAUSS_POINTS = np.array([(r, s, t) for t in (-1, 1) for s in (-1, 1) for r in (-1, 1)]) / np.sqrt(3.0)


def shape_functions(rst: np.ndarray) -> np.ndarray:
    """Shape functions ``N_a = (1 + r r_a) (1 + s s_a) (1 + t t_a) / 8``.

    Parameters
    ----------
    rst : float64, shape (n, 3), dimension 1
        Reference coordinates.

    Returns
    -------
    float64, shape (n, 8), dimension 1
    """
    factor = 1.0 + rst[:, None, :] * REFERENCE_NODES
    return factor[..., 0] * factor[..., 1] * factor[..., 2] / 8.0


def shape_gradients(rst: np.ndarray) -> np.ndarray:
    """Derivatives of the shape functions by the reference coordinates r, s, t.

    Parameters
    ----------
    rst : float64, shape (n, 3), dimension 1
        Reference coordinates.

    Returns
    -------
    float64, shape (n, 8, 3), dimension 1
    """
    r, s, t = np.moveaxis(1.0 + rst[:, None, :] * REFERENCE_NODES, -1, 0)
    return REFERENCE_NODES * np.stack([s * t, t * r, r * s], axis=-1) / 8.0


SHAPE_AT_GAUSS = shape_functions(GAUSS_POINTS)  # (8 Gauss points, 8 nodes)
GRADIENTS_AT_GAUSS = shape_gradients(GAUSS_POINTS)  # (8 Gauss points, 8 nodes, 3)


def gauss_positions(nodes: np.ndarray) -> np.ndarray:
    """Positions of the Gauss points, the peridynamic collocation points of a cell.

    Parameters
    ----------
    nodes : float64, shape (n, 8, 3), dimension length
        Positions of the nodes of n cells.

    Returns
    -------
    float64, shape (n, 8, 3), dimension length
    """
    positions = np.zeros_like(nodes)
    for a in range(8):
        positions += SHAPE_AT_GAUSS[:, a, None] * nodes[:, a, None, :]
    return positions


def jacobians(nodes: np.ndarray) -> np.ndarray:
    """Jacobians ``J[k, d] = d x_d / d r_k`` at the Gauss points.

    Differences to node 0 are summed: cells of the same shape at different places agree up to the rounding of
    their coordinates.

    Parameters
    ----------
    nodes : float64, shape (n, 8, 3), dimension length
        Positions of the nodes of n cells.

    Returns
    -------
    float64, shape (n, 8, 3, 3), dimension length
        A view of an array with the cells innermost.
    """
    corners = np.ascontiguousarray(nodes.transpose(1, 2, 0))  # cells innermost: numpy's loops are long then
    result = np.zeros((8, 3, 3, len(nodes)))
    for a in range(1, 8):
        result += GRADIENTS_AT_GAUSS[:, a, :, None, None] * (corners[a] - corners[0])
    return np.moveaxis(result, -1, 0)


def gauss_volumes(nodes: np.ndarray) -> np.ndarray:
    """Volumes of the Gauss points, ``det J`` (their weight is 1); positive in an admissible cell.

    Parameters
    ----------
    nodes : float64, shape (n, 8, 3), dimension length
        Positions of the nodes of n cells.

    Returns
    -------
    float64, shape (n, 8), dimension length^3
    """
    return _adjugate(jacobians(nodes))[1]


def inverse_jacobians(nodes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Inverse Jacobians ``d r_k / d x_d`` at the Gauss points, and their volumes.

    Parameters
    ----------
    nodes : float64, shape (n, 8, 3), dimension length
        Positions of the nodes of n cells, all Gauss volumes positive.

    Returns
    -------
    inverse : float64, shape (n, 8, 3, 3), dimension length^-1
        Index order: cell, Gauss point, d, k.
    volumes : float64, shape (n, 8), dimension length^3
    """
    adjugate, volumes = _adjugate(jacobians(nodes))
    return adjugate / volumes[..., None, None], volumes


def gauss_gradients(nodes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Gradients ``d N_a / d x_d`` of the shape functions at the Gauss points, and the volumes.

    Parameters
    ----------
    nodes : float64, shape (n, 8, 3), dimension length
        Positions of the nodes of n cells, all Gauss volumes positive.

    Returns
    -------
    gradients : float64, shape (n, 8, 8, 3), dimension length^-1
        Index order: cell, Gauss point, node, d.
    volumes : float64, shape (n, 8), dimension length^3
    """
    inverse, volumes = inverse_jacobians(nodes)
    gradients = np.zeros((len(nodes), 8, 8, 3))
    for k in range(3):
        gradients += GRADIENTS_AT_GAUSS[:, :, k, None] * inverse[:, :, None, :, k]
    return gradients, volumes


def _adjugate(matrices):
    """Adjugate and determinant of 3x3 matrices: cross products of the rows are the adjugate's columns."""
    a, b, c = np.moveaxis(matrices, -2, 0)
    columns = [np.cross(b, c), np.cross(c, a), np.cross(a, b)]
    product = a * columns[0]
    determinant = product[..., 0] + product[..., 1] + product[..., 2]
    return np.ascontiguousarray(np.stack(columns, axis=-1)), np.ascontiguousarray(determinant)
