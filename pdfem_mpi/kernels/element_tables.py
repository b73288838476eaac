"""Tables of trilinear elements: stiffness, masses (21)-(22), bounds of forces, and geometry for the sweeps."""

import numpy as np
from numba import njit, types

from pdfem_mpi.kernels.hex8 import gauss_gradients, inverse_jacobians
from pdfem_mpi.kernels.simd import W

MARGIN = 1.0 + 2.0**-30  # of a computed force over its bound in exact arithmetic


def element_stiffness(
    coordinates: np.ndarray, youngs_modulus: np.ndarray, poissons_ratio: float | np.ndarray
) -> np.ndarray:
    """Stiffness ``k = sum_g w_g B^T C B`` of isotropic elements, 2x2x2 Gauss points; symmetric to the bit.

    Parameters
    ----------
    coordinates : float64, shape (n, 8, 3), dimension length
        Nodes of the elements, with positive Gauss volumes.
    youngs_modulus : float64, shape (n,), dimension force / length^2
    poissons_ratio : float, or float64, shape (n,)

    Returns
    -------
    float64, shape (n, 24, 24), dimension force / length
        Row and column ``3 node + component``. 4.6 kB an element: cut large meshes into batches.
    """
    return stiffness_of_moduli(coordinates, *lame_moduli(youngs_modulus, poissons_ratio))


def stiffness_of_moduli(coordinates: np.ndarray, lam: np.ndarray, mu: np.ndarray) -> np.ndarray:
    """`element_stiffness` from Lame's moduli, shape (n,), dimension force / length^2."""
    stiffness = np.zeros((len(coordinates), 8, 3, 8, 3))
    arrays = *gauss_gradients(coordinates), lam, mu
    add_stiffness(*(np.ascontiguousarray(array) for array in arrays), stiffness)
    return stiffness.reshape(-1, 24, 24)


@njit(cache=True, nogil=True, boundscheck=False, error_model="numpy")
def add_stiffness(gradients, volumes, lam, mu, stiffness):
    """Add the stiffness of elements, Gauss point by Gauss point.

    Parameters
    ----------
    gradients : float64, shape (n, 8, 8, 3), dimension length^-1
        Of the shape functions, by element, Gauss point, node and axis.
    volumes : float64, shape (n, 8), dimension length^3
    lam, mu : float64, shape (n,), dimension force / length^2
    stiffness : float64, shape (n, 8, 3, 8, 3), dimension force / length
    """
    for e in range(lam.size):
        for g in range(8):
            bulk, shear = volumes[e, g] * lam[e], volumes[e, g] * mu[e]
            for a in range(8):
                for b in range(8):
                    laplacian = gradients[e, g, a, 0] * gradients[e, g, b, 0]
                    laplacian += gradients[e, g, a, 1] * gradients[e, g, b, 1]
                    laplacian += gradients[e, g, a, 2] * gradients[e, g, b, 2]
                    for i in range(3):
                        for j in range(3):
                            product = gradients[e, g, a, i] * gradients[e, g, b, j]
                            other = gradients[e, g, a, j] * gradients[e, g, b, i]
                            if i == j:
                                other += laplacian
                            stiffness[e, a, i, b, j] += bulk * product
                            stiffness[e, a, i, b, j] += shear * other


def lame_moduli(youngs_modulus: np.ndarray, poissons_ratio: float | np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lame's moduli lambda and mu of an isotropic material.

    Parameters
    ----------
    youngs_modulus : float64, shape (n,), dimension force / length^2
    poissons_ratio : float, or float64, shape (n,)

    Returns
    -------
    lam, mu : float64, shape (n,), dimension force / length^2
    """
    mu = youngs_modulus / (2.0 * (1.0 + poissons_ratio))
    return 2.0 * mu * poissons_ratio / (1.0 - 2.0 * poissons_ratio), mu


def element_masses(stiffness: np.ndarray) -> np.ndarray:
    """Element part of the fictitious lumped masses, ``m_i = 1/4 sum_j |k_ij|`` (22), for time steps of 1.

    The sum runs over all 24 columns (printed: 8) and carries the 1/4 of (19), which (22) lost. By Gershgorin
    no eigenvalue of ``M^-1 K`` exceeds 4, the limit of stability of central differences.

    Parameters
    ----------
    stiffness : float64, shape (n, 24, 24), dimension force / length

    Returns
    -------
    float64, shape (n, 24), dimension force / length
    """
    return 0.25 * _row_sums(stiffness)


def turning_masses(stiffness: np.ndarray) -> np.ndarray:
    """Masses of elements that turn: of (22), the largest of a node's three, for all of its directions.

    An element's stiffness is at most 4 times its masses (22). Where these are alike in all directions, they stay so
    while it turns, and so does the bound; masses of elongated elements are not.

    Parameters
    ----------
    stiffness : float64, shape (n, 24, 24), dimension force / length

    Returns
    -------
    float64, shape (n, 24), dimension force / length
    """
    return np.repeat(element_masses(stiffness).reshape(-1, 8, 3).max(axis=2), 3, axis=1)


def force_bound(stiffness: np.ndarray) -> float:
    """Bound b of the rounded force components of the linear kernels: ``|f| <= b * largest``.

    The largest row sum of ``|k|`` without the entries of node 0, with a margin for round-off. A quantum of at
    least ``2**-51 * b * largest`` keeps every value below ``2**51 * quantum``, as the rounding by bit pattern
    requires; times the largest ``scale`` for `linear_elements.add_shared_forces`.

    Parameters
    ----------
    stiffness : float64, shape (n, 24, 24), dimension force / length

    Returns
    -------
    float, dimension force / length
        0 without elements.
    """
    return MARGIN * float(_row_sums(stiffness[:, 3:, 3:]).max(initial=0.0))


def _row_sums(stiffness):
    """Sums of the absolute values of each row, column after column."""
    sums = np.zeros(stiffness.shape[:2])
    for j in range(stiffness.shape[2]):
        sums += np.abs(stiffness[:, :, j])
    return sums


def gradient_tables(coordinates: np.ndarray) -> np.ndarray:
    """Geometry of elements of any shape for the sweeps, four elements side by side.

    The inverse Jacobians are kept, from which gradients are rebuilt: 640 bytes an element (gradients: 1408).

    Parameters
    ----------
    coordinates : float64, shape (n, 8, 3), dimension length
        Nodes of the elements, with positive Gauss volumes.

    Returns
    -------
    float64, shape (ceil(n / 4), 8, 10, 4)
        Index order: group of four elements, Gauss point, row, lane. Rows: ``d r_k / d x_d`` at ``3 d + k``
        (dimension length^-1), the Gauss volume at 9 (length^3). A short last group repeats its last element.
    """
    inverse, volumes = inverse_jacobians(coordinates)
    rows = np.concatenate([inverse.reshape(-1, 8, 9), volumes[:, :, None]], axis=2)
    n = len(rows)
    padded = rows[np.minimum(np.arange(-(-n // W) * W), n - 1)]
    return np.ascontiguousarray(np.moveaxis(padded.reshape(-1, W, 8, 10), 1, 3))


_f8 = types.float64[::1]
SIGNATURES = {
    add_stiffness: types.void(
        types.float64[:, :, :, ::1], types.float64[:, ::1], _f8, _f8, types.float64[:, :, :, :, ::1]
    ),
}
