"""Trilinear finite elements in linear kinematics: internal forces (15)-(16).

Displacements enter as differences to node 0 of their element. The forces of the seven other nodes are rounded
to multiples of a quantum, and node 0 gets minus their integer sum. So a translation gives no force, and the
forces of every element sum to exactly zero. They may be added in any order: a node gets the same bits,
whatever the order of the elements and however they are shared out.
"""

import numpy as np
from numba import njit, types

from pdfem_mpi.kernels.element_lanes import add_stress, displacement_gradient, gather, load_moduli, scatter
from pdfem_mpi.kernels.simd import PATTERN, W, fma, hmax, isub, largest, load, magnitude, splat, store


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
        Of `element_tables.gradient_tables` for these elements.
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
        load_moduli(moduli, lam, mu, first)
        for j in range(3, 24):
            top = largest(magnitude(load(difference, W * j)), top)
            store(forces, W * j, zero)
        for g in range(8):
            gxx, gxy, gxz, gyx, gyy, gyz, gzx, gzy, gzz = displacement_gradient(difference, table, row, g)
            # stress times volume; the shear strains are the engineering ones
            volume = load(table, row + 9 * W)
            shear = volume * load(moduli, W)
            pressure = volume * load(moduli, 0) * (gxx + gyy + gzz)
            sxx = fma(shear + shear, gxx, pressure)
            syy = fma(shear + shear, gyy, pressure)
            szz = fma(shear + shear, gzz, pressure)
            sxy, syz, szx = shear * (gxy + gyx), shear * (gyz + gzy), shear * (gzx + gxz)
            add_stress(forces, table, row, g, sxx, sxy, szx, sxy, syy, syz, szx, syz, szz)
            row += 10 * W
        for j in range(3 * W, 24 * W, W):
            store(forces, j, isub(load(forces, j) + magic, magic))
        scatter(force, forces.view(np.int64), connectivity, first)
    largest_difference[0] = max(largest_difference[0], hmax(top))


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
