"""Trilinear finite elements in linear kinematics: internal forces (15)-(16).

Displacements enter as differences to node 0 of their element. The forces of the seven other nodes are rounded
to multiples of a quantum, and node 0 gets minus their integer sum. So a translation gives no force, and the
forces of every element sum to exactly zero. They may be added in any order: a node gets the same bits,
whatever the order of the elements and however they are shared out.
"""

import numpy as np
from numba import njit, types

from pdfem_mpi.kernels.element_lanes import (
    ONE,
    THREE,
    TWO,
    N,
    add_stress,
    aligned,
    displacement_gradient,
    gather,
    gather8,
    load_moduli,
    scatter,
    scatter8,
    u8,
)  # fmt: skip
from pdfem_mpi.kernels.simd import (
    PATTERN,
    W,
    fma,
    hmax,
    isub,
    largest,
    load,
    load8,
    magnitude,
    splat,
    splat8,
    store,
)  # fmt: skip


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
    magic = splat8(PATTERN * quantum)
    zero = splat8(0.0)
    top = zero
    difference = np.empty(2 * 192 + 8)
    rounded = np.empty(192 + 8)
    factor = np.empty(8)
    n, nodes, flat_u, flat_force = u8(len(connectivity)), connectivity.reshape(-1), u.reshape(-1), force.reshape(-1)
    out = aligned(rounded)
    here = aligned(difference)
    ahead = here + u8(192)
    if n > u8(0):
        gather8(difference, here, flat_u, nodes, u8(0))
    for first in range(u8(0), n, N):
        if first + N < n:  # one group ahead: a vector is read from what single numbers filled some time ago
            gather8(difference, ahead, flat_u, nodes, first + N)
        for lane in range(N):
            factor[lane] = scale[min(first + lane, n - ONE)]
        s = load8(factor, 0)
        for j in range(THREE, u8(24)):
            top = largest(magnitude(load8(difference, here + N * j)), top)
        for i in range(THREE, u8(24), u8(7)):
            f0 = f1 = f2 = f3 = f4 = f5 = f6 = zero
            for j in range(THREE, u8(24)):
                d = load8(difference, here + N * j)
                f0 = fma(splat8(stiffness[j, i]), d, f0)
                f1 = fma(splat8(stiffness[j, i + ONE]), d, f1)
                f2 = fma(splat8(stiffness[j, i + TWO]), d, f2)
                f3 = fma(splat8(stiffness[j, i + THREE]), d, f3)
                f4 = fma(splat8(stiffness[j, i + u8(4)]), d, f4)
                f5 = fma(splat8(stiffness[j, i + u8(5)]), d, f5)
                f6 = fma(splat8(stiffness[j, i + u8(6)]), d, f6)
            row = out + N * i
            store(rounded, row, isub(fma(s, f0, magic), magic))
            store(rounded, row + N, isub(fma(s, f1, magic), magic))
            store(rounded, row + TWO * N, isub(fma(s, f2, magic), magic))
            store(rounded, row + THREE * N, isub(fma(s, f3, magic), magic))
            store(rounded, row + u8(4) * N, isub(fma(s, f4, magic), magic))
            store(rounded, row + u8(5) * N, isub(fma(s, f5, magic), magic))
            store(rounded, row + u8(6) * N, isub(fma(s, f6, magic), magic))
        scatter8(flat_force, rounded.view(np.int64), out, nodes, first)
        here, ahead = ahead, here
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
