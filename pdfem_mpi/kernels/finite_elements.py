"""Trilinear finite elements: stiffness, masses (21)-(22) and internal forces (15)-(16).

Displacements enter as differences to node 0 of their element. The forces of the seven other nodes are rounded
to multiples of a quantum, and node 0 gets minus their integer sum. So a translation gives no force, and the
forces of every element sum to exactly zero. They may be added in any order: a node gets the same bits,
whatever the order of the elements and however they are shared out.

Four elements stand in the SIMD lanes. A short last group repeats its last element and leaves the copies out.
"""

import numpy as np
from numba import njit, types

from pdfem_mpi.kernels.hex8 import GRADIENTS_AT_GAUSS, gauss_gradients, inverse_jacobians
from pdfem_mpi.kernels.simd import PATTERN, W, fma, hmax, isub, largest, load, magnitude, splat, store

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
    lam, mu = (modulus[:, None, None, None, None] for modulus in (lam, mu))
    gradients, volumes = gauss_gradients(coordinates)
    stiffness = np.zeros((len(coordinates), 8, 3, 8, 3))
    for g in range(8):
        weight = volumes[:, g, None, None, None, None]
        products = gradients[:, g, :, :, None, None] * gradients[:, g, None, None, :, :]  # [a, i, b, j]
        laplacian = products[:, :, 0, :, 0] + products[:, :, 1, :, 1] + products[:, :, 2, :, 2]
        stiffness += weight * lam * products
        stiffness += weight * mu * (products.swapaxes(2, 4) + laplacian[:, :, None, :, None] * np.eye(3)[:, None, :])
    return stiffness.reshape(-1, 24, 24)


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
    """Bound b of the rounded force components of both kernels: ``|f| <= b * largest``.

    The largest row sum of ``|k|`` without the entries of node 0, with a margin for round-off. A quantum of at
    least ``2**-51 * b * largest`` keeps every value below ``2**51 * quantum``, as the rounding by bit pattern
    requires; times the largest ``scale`` for :func:`add_shared_forces`.

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
    """Geometry of general elements for :func:`add_general_forces`, four elements side by side.

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


@njit(cache=True, nogil=True, boundscheck=False, error_model="numpy")
def add_shared_forces(force, u, connectivity, stiffness, scale, quantum, largest_difference):
    """Add the internal forces ``-scale k (u_e - u_0)`` of elements with the same stiffness matrix (15)-(16).

    Parameters
    ----------
    force : int64, shape (n_nodes, 3), dimension force / quantum
        Added to. Rows of ghost nodes are completed by ``scatter_reverse``.
    u : float64, shape (n_nodes, 3), dimension length
        Displacements; ghost rows up to date (``scatter_forward``).
    connectivity : int32, shape (n_elements, 8)
        Local nodes of the elements, in range and not negative; may be any part of the elements.
    stiffness : float64, shape (24, 24), dimension force / length
        Symmetric.
    scale : float64, shape (n_elements,), dimension 1
        Factor of the stiffness, element by element.
    quantum : float, dimension force
        Power of two, equal on all ranks, at least ``2**-51 * force_bound * max(scale) * largest_difference``.
    largest_difference : float64, shape (1,), dimension length
        Raised to the largest ``|u_e - u_0|`` component, to check the bound afterwards. Not raised by NaN.
    """
    magic = splat(PATTERN * quantum)
    zero = splat(0.0)
    top = zero
    difference = np.empty(24 * W)
    rounded = np.empty(24 * W)
    factor = np.empty(W)
    for first in range(0, len(connectivity), W):
        gather(difference, u, connectivity, first)
        for lane in range(W):
            factor[lane] = scale[min(first + lane, len(connectivity) - 1)]
        for j in range(3, 24):
            top = largest(magnitude(load(difference, W * j)), top)
        for i in range(3, 24, 7):
            f0 = f1 = f2 = f3 = f4 = f5 = f6 = zero
            for j in range(3, 24):
                d = load(difference, W * j)
                f0 = fma(splat(stiffness[j, i]), d, f0)
                f1 = fma(splat(stiffness[j, i + 1]), d, f1)
                f2 = fma(splat(stiffness[j, i + 2]), d, f2)
                f3 = fma(splat(stiffness[j, i + 3]), d, f3)
                f4 = fma(splat(stiffness[j, i + 4]), d, f4)
                f5 = fma(splat(stiffness[j, i + 5]), d, f5)
                f6 = fma(splat(stiffness[j, i + 6]), d, f6)
            s = load(factor, 0)
            store(rounded, W * i, isub(fma(s, f0, magic), magic))
            store(rounded, W * (i + 1), isub(fma(s, f1, magic), magic))
            store(rounded, W * (i + 2), isub(fma(s, f2, magic), magic))
            store(rounded, W * (i + 3), isub(fma(s, f3, magic), magic))
            store(rounded, W * (i + 4), isub(fma(s, f4, magic), magic))
            store(rounded, W * (i + 5), isub(fma(s, f5, magic), magic))
            store(rounded, W * (i + 6), isub(fma(s, f6, magic), magic))
        scatter(force, rounded.view(np.int64), connectivity, first)
    largest_difference[0] = max(largest_difference[0], hmax(top))


@njit(cache=True, nogil=True, boundscheck=False, error_model="numpy")
def add_general_forces(force, u, connectivity, tables, lam, mu, quantum, largest_difference):
    """Add the internal forces ``-sum_g w_g B^T C B (u_e - u_0)`` of elements of any shape (15)-(16).

    At a Gauss point, with ``G = dN/dr`` the same for all elements and ``R = dr/dx`` from the tables::

        D = (u_e - u_0)^T G      du/dx = D R      sigma = lam tr(e) 1 + 2 mu e      f_e = w G R sigma

    Parameters
    ----------
    force : int64, shape (n_nodes, 3), dimension force / quantum
        Added to. Rows of ghost nodes are completed by ``scatter_reverse``.
    u : float64, shape (n_nodes, 3), dimension length
        Displacements; ghost rows up to date (``scatter_forward``).
    connectivity : int32, shape (n_elements, 8)
        Local nodes of the elements, in range and not negative. Parts of the elements start with a group.
    tables : float64, shape (ceil(n_elements / 4), 8, 10, 4)
        Of :func:`gradient_tables` for these elements.
    lam, mu : float64, shape (n_elements,), dimension force / length^2
        Lame's moduli.
    quantum : float, dimension force
        Power of two, equal on all ranks, at least ``2**-51 * force_bound * largest_difference``.
    largest_difference : float64, shape (1,), dimension length
        Raised to the largest ``|u_e - u_0|`` component, to check the bound afterwards. Not raised by NaN.
    """
    magic = splat(PATTERN * quantum)
    zero = splat(0.0)
    top = zero
    difference = np.empty(24 * W)
    forces = np.empty(24 * W)
    moduli = np.empty(2 * W)
    table = tables.reshape(-1)
    row = 0
    for first in range(0, len(connectivity), W):
        gather(difference, u, connectivity, first)
        for lane in range(W):
            element = min(first + lane, len(connectivity) - 1)
            moduli[lane] = lam[element]
            moduli[W + lane] = mu[element]
        for j in range(3, 24):
            top = largest(magnitude(load(difference, W * j)), top)
            store(forces, W * j, zero)
        for g in range(8):
            # D: x, y, z by r, s, t
            xr = xs = xt = yr = ys = yt = zr = zs = zt = zero
            for a in range(1, 8):
                dr = splat(GRADIENTS_AT_GAUSS[g, a, 0])
                ds = splat(GRADIENTS_AT_GAUSS[g, a, 1])
                dt = splat(GRADIENTS_AT_GAUSS[g, a, 2])
                x = load(difference, 3 * W * a)
                y = load(difference, 3 * W * a + W)
                z = load(difference, 3 * W * a + 2 * W)
                xr, xs, xt = fma(x, dr, xr), fma(x, ds, xs), fma(x, dt, xt)
                yr, ys, yt = fma(y, dr, yr), fma(y, ds, ys), fma(y, dt, yt)
                zr, zs, zt = fma(z, dr, zr), fma(z, ds, zs), fma(z, dt, zt)
            rx, sx, tx = load(table, row), load(table, row + W), load(table, row + 2 * W)
            ry, sy, ty = load(table, row + 3 * W), load(table, row + 4 * W), load(table, row + 5 * W)
            rz, sz, tz = load(table, row + 6 * W), load(table, row + 7 * W), load(table, row + 8 * W)
            volume = load(table, row + 9 * W)
            row += 10 * W
            # stress times volume; the shear strains are the engineering ones
            exx = fma(xr, rx, fma(xs, sx, xt * tx))
            eyy = fma(yr, ry, fma(ys, sy, yt * ty))
            ezz = fma(zr, rz, fma(zs, sz, zt * tz))
            exy = fma(xr, ry, fma(xs, sy, xt * ty)) + fma(yr, rx, fma(ys, sx, yt * tx))
            eyz = fma(yr, rz, fma(ys, sz, yt * tz)) + fma(zr, ry, fma(zs, sy, zt * ty))
            ezx = fma(zr, rx, fma(zs, sx, zt * tx)) + fma(xr, rz, fma(xs, sz, xt * tz))
            shear = volume * load(moduli, W)
            pressure = volume * load(moduli, 0) * (exx + eyy + ezz)
            sxx = fma(shear + shear, exx, pressure)
            syy = fma(shear + shear, eyy, pressure)
            szz = fma(shear + shear, ezz, pressure)
            sxy, syz, szx = shear * exy, shear * eyz, shear * ezx
            xr = fma(sxx, rx, fma(sxy, ry, szx * rz))
            xs = fma(sxx, sx, fma(sxy, sy, szx * sz))
            xt = fma(sxx, tx, fma(sxy, ty, szx * tz))
            yr = fma(sxy, rx, fma(syy, ry, syz * rz))
            ys = fma(sxy, sx, fma(syy, sy, syz * sz))
            yt = fma(sxy, tx, fma(syy, ty, syz * tz))
            zr = fma(szx, rx, fma(syz, ry, szz * rz))
            zs = fma(szx, sx, fma(syz, sy, szz * sz))
            zt = fma(szx, tx, fma(syz, ty, szz * tz))
            for a in range(1, 8):
                dr = splat(GRADIENTS_AT_GAUSS[g, a, 0])
                ds = splat(GRADIENTS_AT_GAUSS[g, a, 1])
                dt = splat(GRADIENTS_AT_GAUSS[g, a, 2])
                j = 3 * W * a
                store(forces, j, fma(xr, dr, fma(xs, ds, fma(xt, dt, load(forces, j)))))
                j += W
                store(forces, j, fma(yr, dr, fma(ys, ds, fma(yt, dt, load(forces, j)))))
                j += W
                store(forces, j, fma(zr, dr, fma(zs, ds, fma(zt, dt, load(forces, j)))))
        for j in range(3 * W, 24 * W, W):
            store(forces, j, isub(load(forces, j) + magic, magic))
        scatter(force, forces.view(np.int64), connectivity, first)
    largest_difference[0] = max(largest_difference[0], hmax(top))


@njit(cache=True, nogil=True, boundscheck=False, error_model="numpy")
def gather(difference, u, connectivity, first):
    """Write ``u_a - u_0`` of a group's elements to ``difference[4 (3 a + component) + lane]``."""
    for lane in range(W):
        element = min(first + lane, len(connectivity) - 1)
        n = np.uint64(connectivity[element, 0])
        x, y, z = u[n, 0], u[n, 1], u[n, 2]
        for a in range(1, 8):
            n = np.uint64(connectivity[element, a])
            j = 3 * W * a + lane
            difference[j] = u[n, 0] - x
            difference[j + W] = u[n, 1] - y
            difference[j + 2 * W] = u[n, 2] - z


@njit(cache=True, nogil=True, boundscheck=False, error_model="numpy")
def scatter(force, rounded, connectivity, first):
    """Take ``rounded[4 (3 a + component) + lane]`` from nodes 1 to 7, give their sum to node 0."""
    for lane in range(min(W, len(connectivity) - first)):
        x = y = z = np.int64(0)
        for a in range(1, 8):
            n = np.uint64(connectivity[first + lane, a])
            j = 3 * W * a + lane
            x += rounded[j]
            y += rounded[j + W]
            z += rounded[j + 2 * W]
            force[n, 0] -= rounded[j]
            force[n, 1] -= rounded[j + W]
            force[n, 2] -= rounded[j + 2 * W]
        n = np.uint64(connectivity[first + lane, 0])
        force[n, 0] += x
        force[n, 1] += y
        force[n, 2] += z


_NODAL = types.int64[:, ::1], types.float64[:, ::1], types.int32[:, ::1]

SIGNATURES = {
    add_shared_forces: types.void(
        *_NODAL, types.float64[:, ::1], types.float64[::1], types.float64, types.float64[::1]
    ),
    add_general_forces: types.void(
        *_NODAL,
        types.float64[:, :, :, ::1],
        types.float64[::1],
        types.float64[::1],
        types.float64,
        types.float64[::1],
    ),
}
