"""Trilinear finite elements in finite kinematics: forces, tangent, energy and how far they are deformed.

Total Lagrangian with the law of St Venant and Kirchhoff, 2x2x2 Gauss points. With the displacement gradient
``H = du/dx`` and ``F = 1 + H``::

    E = (H + H^T + H^T H) / 2      S = lam tr(E) 1 + 2 mu E      P = F S      f_a = sum_g w_g P dN_a/dx

``E`` is formed from differences of displacements, so that small strains lose no digit beside large ones, and a rigid
motion leaves round-off only. ``S`` is symmetric to the bit: the forces of an element have no moment about their
deformed places but for round-off. At small displacements these are the forces of `linear_elements`.

Forces of the seven other nodes are rounded and node 0 gets minus their integer sum, as in `linear_elements`. There the
largest difference of displacements bounds the forces; here a rotation makes these large without any force, so the
largest force itself is measured, and the quantum rests on it. Four elements stand in the SIMD lanes.
"""

import numpy as np
from numba import njit, types

from pdfem_mpi.kernels.element_lanes import add_stress, displacement_gradient, gather, load_moduli, scatter
from pdfem_mpi.kernels.simd import PATTERN, W, fma, hmax, isub, largest, load, magnitude, smallest, splat, store

_options = {"cache": True, "nogil": True, "boundscheck": False, "error_model": "numpy"}


@njit(**_options)
def add_forces(force, u, connectivity, tables, lam, mu, quantum, met):
    """Add the internal forces ``-f_a`` of elements in finite kinematics.

    Parameters
    ----------
    force : int64, shape (n_nodes, 3), dimension force / quantum
        Added to. Rows of ghost nodes are completed by ``scatter_reverse``.
    u : float64, shape (n_nodes, 3), dimension length
        Displacements; ghost rows up to date (``scatter_forward``).
    connectivity : int32, shape (n_elements, 8)
        Local nodes of the elements, in range and not negative. Parts of the elements start with a group.
    tables : float64, shape (ceil(n_elements / 4), 8, 10, 4), or (1, 8, 10, 4) for elements of one shape
        Of `element_tables.gradient_tables`.
    lam, mu : float64, shape (n_elements,), dimension force / length^2
        Lame's moduli.
    quantum : float, dimension force
        Power of two, equal on all ranks, at least ``2**-51`` of the largest component of a force on nodes 1 to 7.
    met : float64, shape (2,), dimensions force and length
        Raised to that component, and to the largest ``|u_a - u_0|``, to check afterwards. Not raised by NaN.
    """
    magic = splat(PATTERN * quantum)
    zero, half = splat(0.0), splat(0.5)
    top_force = top_difference = zero
    difference = np.empty(24 * W)
    forces = np.empty(24 * W)
    moduli = np.empty(2 * W)
    table = tables.reshape(-1)
    stride = 0 if len(tables) == 1 else 80 * W
    for first in range(0, len(connectivity), W):
        gather(difference, u, connectivity, first)
        load_moduli(moduli, lam, mu, first)
        for j in range(3 * W, 24 * W, W):
            top_difference = largest(magnitude(load(difference, j)), top_difference)
            store(forces, j, zero)
        lam_lanes, mu_lanes = load(moduli, 0), load(moduli, W)
        for g in range(8):
            row = stride * (first // W) + 10 * W * g
            hxx, hxy, hxz, hyx, hyy, hyz, hzx, hzy, hzz = displacement_gradient(difference, table, row, g)
            # Green's strain, shear strains twice
            exx = fma(half, fma(hxx, hxx, fma(hyx, hyx, hzx * hzx)), hxx)
            eyy = fma(half, fma(hxy, hxy, fma(hyy, hyy, hzy * hzy)), hyy)
            ezz = fma(half, fma(hxz, hxz, fma(hyz, hyz, hzz * hzz)), hzz)
            exy = fma(hxx, hxy, fma(hyx, hyy, fma(hzx, hzy, hxy + hyx)))
            eyz = fma(hxy, hxz, fma(hyy, hyz, fma(hzy, hzz, hyz + hzy)))
            ezx = fma(hxz, hxx, fma(hyz, hyx, fma(hzz, hzx, hzx + hxz)))
            # stress times volume
            volume = load(table, row + 9 * W)
            shear = volume * mu_lanes
            pressure = volume * lam_lanes * (exx + eyy + ezz)
            sxx = fma(shear + shear, exx, pressure)
            syy = fma(shear + shear, eyy, pressure)
            szz = fma(shear + shear, ezz, pressure)
            sxy, syz, szx = shear * exy, shear * eyz, shear * ezx
            add_stress(
                forces, table, row, g,
                fma(hxx, sxx, fma(hxy, sxy, fma(hxz, szx, sxx))),
                fma(hxx, sxy, fma(hxy, syy, fma(hxz, syz, sxy))),
                fma(hxx, szx, fma(hxy, syz, fma(hxz, szz, szx))),
                fma(hyx, sxx, fma(hyy, sxy, fma(hyz, szx, sxy))),
                fma(hyx, sxy, fma(hyy, syy, fma(hyz, syz, syy))),
                fma(hyx, szx, fma(hyy, syz, fma(hyz, szz, syz))),
                fma(hzx, sxx, fma(hzy, sxy, fma(hzz, szx, szx))),
                fma(hzx, sxy, fma(hzy, syy, fma(hzz, syz, syz))),
                fma(hzx, szx, fma(hzy, syz, fma(hzz, szz, szz))),
            )  # fmt: skip
        for j in range(3 * W, 24 * W, W):
            value = load(forces, j)
            top_force = largest(magnitude(value), top_force)
            store(forces, j, isub(value + magic, magic))
        scatter(force, forces.view(np.int64), connectivity, first)
    met[0] = max(met[0], hmax(top_force))
    met[1] = max(met[1], hmax(top_difference))


@njit(**_options)
def add_tangent(force, u, at, connectivity, tables, lam, mu, quantum, met):
    """Add minus the change of the internal forces with the displacements, ``-K u``, at the displacements ``at``.

    With ``G = du/dx``: ``dE = sym(F^T G)``, ``dP = G S + F dS``; the first term is the geometric stiffness, the second
    the material's. Parameters as in `add_forces`; ``at`` as ``u``, ``met[1]`` speaks of ``u``.
    """
    magic = splat(PATTERN * quantum)
    zero, half = splat(0.0), splat(0.5)
    top_force = top_difference = zero
    difference = np.empty(24 * W)
    base = np.empty(24 * W)
    forces = np.empty(24 * W)
    moduli = np.empty(2 * W)
    table = tables.reshape(-1)
    stride = 0 if len(tables) == 1 else 80 * W
    for first in range(0, len(connectivity), W):
        gather(difference, u, connectivity, first)
        gather(base, at, connectivity, first)
        load_moduli(moduli, lam, mu, first)
        for j in range(3 * W, 24 * W, W):
            top_difference = largest(magnitude(load(difference, j)), top_difference)
            store(forces, j, zero)
        lam_lanes, mu_lanes = load(moduli, 0), load(moduli, W)
        for g in range(8):
            row = stride * (first // W) + 10 * W * g
            hxx, hxy, hxz, hyx, hyy, hyz, hzx, hzy, hzz = displacement_gradient(base, table, row, g)
            gxx, gxy, gxz, gyx, gyy, gyz, gzx, gzy, gzz = displacement_gradient(difference, table, row, g)
            volume = load(table, row + 9 * W)
            shear = volume * mu_lanes
            twice = shear + shear
            pressure = volume * lam_lanes
            exx = fma(half, fma(hxx, hxx, fma(hyx, hyx, hzx * hzx)), hxx)
            eyy = fma(half, fma(hxy, hxy, fma(hyy, hyy, hzy * hzy)), hyy)
            ezz = fma(half, fma(hxz, hxz, fma(hyz, hyz, hzz * hzz)), hzz)
            trace = pressure * (exx + eyy + ezz)
            sxx, syy, szz = fma(twice, exx, trace), fma(twice, eyy, trace), fma(twice, ezz, trace)
            sxy = shear * fma(hxx, hxy, fma(hyx, hyy, fma(hzx, hzy, hxy + hyx)))
            syz = shear * fma(hxy, hxz, fma(hyy, hyz, fma(hzy, hzz, hyz + hzy)))
            szx = shear * fma(hxz, hxx, fma(hyz, hyx, fma(hzz, hzx, hzx + hxz)))
            # changes of strain and of stress
            exx = fma(hxx, gxx, fma(hyx, gyx, fma(hzx, gzx, gxx)))
            eyy = fma(hxy, gxy, fma(hyy, gyy, fma(hzy, gzy, gyy)))
            ezz = fma(hxz, gxz, fma(hyz, gyz, fma(hzz, gzz, gzz)))
            trace = pressure * (exx + eyy + ezz)
            txx, tyy, tzz = fma(twice, exx, trace), fma(twice, eyy, trace), fma(twice, ezz, trace)
            txy = fma(hxx, gxy, fma(hyx, gyy, fma(hzx, gzy, gxy + gyx)))
            txy = shear * fma(gxx, hxy, fma(gyx, hyy, fma(gzx, hzy, txy)))
            tyz = fma(hxy, gxz, fma(hyy, gyz, fma(hzy, gzz, gyz + gzy)))
            tyz = shear * fma(gxy, hxz, fma(gyy, hyz, fma(gzy, hzz, tyz)))
            tzx = fma(hxz, gxx, fma(hyz, gyx, fma(hzz, gzx, gzx + gxz)))
            tzx = shear * fma(gxz, hxx, fma(gyz, hyx, fma(gzz, hzx, tzx)))
            add_stress(
                forces, table, row, g,
                fma(gxx, sxx, fma(gxy, sxy, fma(gxz, szx, fma(hxx, txx, fma(hxy, txy, fma(hxz, tzx, txx)))))),
                fma(gxx, sxy, fma(gxy, syy, fma(gxz, syz, fma(hxx, txy, fma(hxy, tyy, fma(hxz, tyz, txy)))))),
                fma(gxx, szx, fma(gxy, syz, fma(gxz, szz, fma(hxx, tzx, fma(hxy, tyz, fma(hxz, tzz, tzx)))))),
                fma(gyx, sxx, fma(gyy, sxy, fma(gyz, szx, fma(hyx, txx, fma(hyy, txy, fma(hyz, tzx, txy)))))),
                fma(gyx, sxy, fma(gyy, syy, fma(gyz, syz, fma(hyx, txy, fma(hyy, tyy, fma(hyz, tyz, tyy)))))),
                fma(gyx, szx, fma(gyy, syz, fma(gyz, szz, fma(hyx, tzx, fma(hyy, tyz, fma(hyz, tzz, tyz)))))),
                fma(gzx, sxx, fma(gzy, sxy, fma(gzz, szx, fma(hzx, txx, fma(hzy, txy, fma(hzz, tzx, tzx)))))),
                fma(gzx, sxy, fma(gzy, syy, fma(gzz, syz, fma(hzx, txy, fma(hzy, tyy, fma(hzz, tyz, tyz)))))),
                fma(gzx, szx, fma(gzy, syz, fma(gzz, szz, fma(hzx, tzx, fma(hzy, tyz, fma(hzz, tzz, tzz)))))),
            )  # fmt: skip
        for j in range(3 * W, 24 * W, W):
            value = load(forces, j)
            top_force = largest(magnitude(value), top_force)
            store(forces, j, isub(value + magic, magic))
        scatter(force, forces.view(np.int64), connectivity, first)
    met[0] = max(met[0], hmax(top_force))
    met[1] = max(met[1], hmax(top_difference))


@njit(**_options)
def measure(u, connectivity, tables, lam, mu, energy, volume_ratio, strain):
    """Strain energy ``sum_g w_g (lam/2 tr(E)^2 + mu E:E)`` of each element, and how far it is deformed.

    Parameters
    ----------
    u, connectivity, tables, lam, mu
        As in `add_forces`.
    energy : float64, shape (n_elements,), dimension force length
        Overwritten.
    volume_ratio : float64, shape (n_elements,), dimension 1
        Overwritten: the smallest ``det F`` of the Gauss points; not positive where the element is turned inside out.
    strain : float64, shape (n_elements,), dimension 1
        Overwritten: the largest ``|E|``, root of the sum of the squares of its nine components.
    """
    zero, half, one = splat(0.0), splat(0.5), splat(1.0)
    difference = np.empty(24 * W)
    moduli = np.empty(2 * W)
    result = np.empty(3 * W)
    table = tables.reshape(-1)
    stride = 0 if len(tables) == 1 else 80 * W
    for first in range(0, len(connectivity), W):
        gather(difference, u, connectivity, first)
        load_moduli(moduli, lam, mu, first)
        total = square = zero
        ratio = splat(np.inf)
        for g in range(8):
            row = stride * (first // W) + 10 * W * g
            hxx, hxy, hxz, hyx, hyy, hyz, hzx, hzy, hzz = displacement_gradient(difference, table, row, g)
            exx = fma(half, fma(hxx, hxx, fma(hyx, hyx, hzx * hzx)), hxx)
            eyy = fma(half, fma(hxy, hxy, fma(hyy, hyy, hzy * hzy)), hyy)
            ezz = fma(half, fma(hxz, hxz, fma(hyz, hyz, hzz * hzz)), hzz)
            exy = fma(hxx, hxy, fma(hyx, hyy, fma(hzx, hzy, hxy + hyx)))
            eyz = fma(hxy, hxz, fma(hyy, hyz, fma(hzy, hzz, hyz + hzy)))
            ezx = fma(hxz, hxx, fma(hyz, hyx, fma(hzz, hzx, hzx + hxz)))
            product = fma(exy, exy, fma(eyz, eyz, ezx * ezx)) * half
            product = fma(exx, exx, fma(eyy, eyy, fma(ezz, ezz, product)))
            trace = exx + eyy + ezz
            density = fma(half * load(moduli, 0), trace * trace, load(moduli, W) * product)
            total = fma(load(table, row + 9 * W), density, total)
            square = largest(product, square)
            fxx, fyy, fzz = one + hxx, one + hyy, one + hzz
            a = fma(fyy, fzz, zero - hyz * hzy)
            b = fma(hyz, hzx, zero - hyx * fzz)
            c = fma(hyx, hzy, zero - fyy * hzx)
            ratio = smallest(fma(fxx, a, fma(hxy, b, hxz * c)), ratio)
        store(result, 0, total)
        store(result, W, ratio)
        store(result, 2 * W, square)
        for lane in range(min(W, len(connectivity) - first)):
            energy[first + lane] = result[lane]
            volume_ratio[first + lane] = result[W + lane]
            strain[first + lane] = np.sqrt(result[2 * W + lane])


_f8, _nodal = types.float64[::1], types.float64[:, ::1]
_elements = types.int32[:, ::1], types.float64[:, :, :, ::1], _f8, _f8
SIGNATURES = {
    add_forces: types.void(types.int64[:, ::1], _nodal, *_elements, types.float64, _f8),
    add_tangent: types.void(types.int64[:, ::1], _nodal, _nodal, *_elements, types.float64, _f8),
    measure: types.void(_nodal, *_elements, _f8, _f8, _f8),
}
