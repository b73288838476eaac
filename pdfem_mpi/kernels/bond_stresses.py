"""Moments of bonds at their points: of their forces (the virial stress), and of what their ends do (the strain).

A bond gives the same terms to both of its points. They are rounded to multiples of a quantum and added as integers, so
that sums have the same bits in any order. Each kernel is called twice: with quanta of 0 it only says how large its
terms are, which is what the quanta rest on.

Sums stand as ``sums[cluster][component][lane]``, components in the order xx, yy, zz, xy, yz, zx.
"""

import math

import numpy as np
from numba import njit, types

from pdfem_mpi.kernels.bond_response import SMALLEST_SQUARE
from pdfem_mpi.kernels.simd import W

_options = {"cache": True, "nogil": True, "boundscheck": False, "error_model": "numpy"}
#: Sums of `add_stresses`: six of the stress, one of the energy.
STRESSES = 7
#: Sums of `add_gradients`: nine of ``eta xi`` (xx, yy, zz, xy, yz, zx, yx, zy, xz), six of ``xi xi``.
GRADIENTS = 15


@njit(**_options)
def add_stresses(row_start, row_offset, row_data, S, expansion, Q, finite, weights, quanta, sums, top):
    """Add ``f (x) y`` and the energy of every bond to both of its points; ``y`` is the bond as it is now.

    ``f y = 2 K phi y y`` in finite kinematics, ``K' (eta . xi) xi xi`` in linear ones: symmetric. Half of it, over the
    point's volume, is its share of Kirchhoff's stress, which is the stress itself where strains are small. A volumetric
    part adds what the two points have in common (`volumetric_sweeps`) to the force; its energy is the points' own.

    Parameters
    ----------
    row_start, row_offset, row_data
        Rows as in the sweeps; a broken bond is a slot of zeros.
    S : float64, shape (n_clusters * 36,)
        The point table of the sweeps.
    expansion : float64, shape (n_clusters * 4,) or (0,), dimension 1
        Thermal strain of the points: a bond is stretched by what is beyond the mean of its ends. Linear kinematics.
    Q
        As in `volumetric_sweeps`; without a volumetric part ``Q`` is empty.
    finite : bool
    weights : float32, shape ((n_rows + 1) * 8,) or (0,)
        Fitted weights of the slots, as in `dilatation_sweeps`.
    quanta : float64, shape (2,), dimension force length
        Powers of two, of the stress and of the energy; 0 to measure only.
    sums : int64, shape (n_clusters * 28,)
        Added to, in quanta.
    top : float64, shape (2,)
        Raised to the largest terms, where the quanta are 0.
    """
    stride = 2 * W if finite else W
    terms = np.empty(STRESSES)
    measuring = quanta[0] == 0.0
    of_stress = 0.0 if measuring else 1.0 / quanta[0]
    of_energy = 0.0 if measuring else 1.0 / quanta[1]
    for i in range(row_start.size - 1):
        c = i // W
        own = c * 9 * W + (i - c * W)
        for row in range(row_start[i], row_start[i + 1]):
            first = np.int64(row_offset[row])
            for lane in range(W):
                k = np.float64(row_data[row * stride + lane])
                if k == 0.0:
                    continue
                b = first + lane
                dx, dy, dz = S[b] - S[own], S[b + W] - S[own + W], S[b + 2 * W] - S[own + 2 * W]
                gx = S[b + 3 * W] - S[own + 3 * W]
                gy = S[b + 4 * W] - S[own + 4 * W]
                gz = S[b + 5 * W] - S[own + 5 * W]
                work = dx * gx + dy * gy + dz * gz
                other = first // (9 * W)
                common = 0.0
                if Q.size:
                    common = Q[i] + Q[W * other + lane]
                    if weights.size:
                        slot = 2 * W * row + lane
                        common = weights[slot] * Q[i] + weights[slot + W] * Q[W * other + lane]
                if finite:
                    e = work * np.float64(row_data[row * stride + W + lane])
                    square = max(1.0 + e, SMALLEST_SQUARE)
                    length = math.sqrt(square)
                    phi = max(e, SMALLEST_SQUARE - 1.0) / (square + length)
                    strength = 0.5 * k * (phi + (1.0 - phi) * common)
                    gx, gy, gz = gx + dx, gy + dy, gz + dz
                    terms[6] = k * e * work / ((1.0 + length) * (1.0 + length))
                else:
                    square = gx * gx + gy * gy + gz * gz
                    if expansion.size:
                        work -= 0.5 * (expansion[i] + expansion[W * other + lane]) * square
                    strength = k * (work + common * square)
                    terms[6] = 0.5 * k * work * work
                terms[0], terms[1], terms[2] = strength * gx * gx, strength * gy * gy, strength * gz * gz
                terms[3], terms[4], terms[5] = strength * gx * gy, strength * gy * gz, strength * gz * gx
                if measuring:
                    for t in range(6):
                        top[0] = max(top[0], abs(terms[t]))
                    top[1] = max(top[1], abs(terms[6]))
                    continue
                own_place = STRESSES * W * c + (i - c * W)
                place = STRESSES * W * other + lane
                for t in range(STRESSES):
                    term = np.int64(np.rint(terms[t] * (of_stress if t < 6 else of_energy)))
                    sums[own_place + W * t] += term
                    sums[place + W * t] += term


@njit(**_options)
def add_thermal_forces(row_start, row_offset, row_data, x, expansion, Q, weights, quanta, sums, top):
    """Add ``-K' |xi|^2 (theta + Q_i + Q_j) xi`` of every bond to its point i and take it from j: linear kinematics.

    Parameters
    ----------
    row_start, row_offset, row_data
        Rows as in the sweeps.
    x : float64, shape (n_clusters * 12,), dimension length
        Positions in cluster layout.
    expansion : float64, shape (n_clusters * 4,), dimension 1
        Thermal strain of the points; ``theta`` is the mean of a bond's ends.
    Q
        As in `volumetric_sweeps`, of dilatations by the thermal strain; without a volumetric part ``Q`` is empty.
    weights : float32, shape ((n_rows + 1) * 8,) or (0,)
        Fitted weights of the slots, as in `dilatation_sweeps`.
    quanta : float64, shape (2,), dimension force
        The first is a power of two; 0 to measure only.
    sums : int64, shape (n_clusters * 12,)
        Added to, in quanta.
    top : float64, shape (2,)
        The first is raised to the largest term, where the quanta are 0.
    """
    xi = np.empty(3)
    measuring = quanta[0] == 0.0
    inverse = 0.0 if measuring else 1.0 / quanta[0]
    for i in range(row_start.size - 1):
        own = 3 * W * (i // W) + i % W
        for row in range(row_start[i], row_start[i + 1]):
            other = np.int64(row_offset[row]) // (9 * W)
            for lane in range(W):
                strength = np.float64(row_data[row * W + lane])
                if strength == 0.0:
                    continue
                place = 3 * W * other + lane
                square = 0.0
                for d in range(3):
                    xi[d] = x[place + W * d] - x[own + W * d]
                    square += xi[d] * xi[d]
                strain = 0.5 * (expansion[i] + expansion[W * other + lane])
                if Q.size:
                    common = Q[i] + Q[W * other + lane]
                    if weights.size:
                        slot = 2 * W * row + lane
                        common = weights[slot] * Q[i] + weights[slot + W] * Q[W * other + lane]
                    strain += common
                strength *= strain * square
                for d in range(3):
                    if measuring:
                        top[0] = max(top[0], abs(strength * xi[d]))
                        continue
                    term = np.int64(np.rint(strength * xi[d] * inverse))
                    sums[own + W * d] -= term
                    sums[place + W * d] += term


@njit(**_options)
def add_thermal_dilatations(row_start, row_offset, row_data, x, expansion, weights, quanta, sums, top):
    """Add ``K' theta |xi|^4`` of every bond to both of its points: the terms ``k e`` of `dilatation_sweeps`.

    Parameters are those of `add_thermal_forces`; ``sums`` has the shape (n_clusters * 4,).
    """
    measuring = quanta[0] == 0.0
    inverse = 0.0 if measuring else 1.0 / quanta[0]
    for i in range(row_start.size - 1):
        own = 3 * W * (i // W) + i % W
        for row in range(row_start[i], row_start[i + 1]):
            other = np.int64(row_offset[row]) // (9 * W)
            for lane in range(W):
                strength = np.float64(row_data[row * W + lane])
                if strength == 0.0:
                    continue
                square = 0.0
                for d in range(3):
                    along = x[3 * W * other + lane + W * d] - x[own + W * d]
                    square += along * along
                strength *= 0.5 * (expansion[i] + expansion[W * other + lane]) * square * square
                here, there = strength, strength
                if weights.size:
                    here *= weights[2 * W * row + lane]
                    there *= weights[2 * W * row + W + lane]
                if measuring:
                    top[0] = max(top[0], abs(here), abs(there))
                    continue
                sums[i] += np.int64(np.rint(here * inverse))
                sums[W * other + lane] += np.int64(np.rint(there * inverse))


@njit(**_options)
def add_gradients(row_start, row_offset, row_data, S, x, volume, cell_number, finite, quanta, sums, top):
    """Add ``w_i w_j exp(-r0^2) eta (x) xi`` and ``w_i w_j exp(-r0^2) xi (x) xi`` of every bond to both of its points.

    Parameters
    ----------
    row_start, row_offset, row_data
        Rows as in the sweeps; the numbers say which bonds are there.
    S : float64, shape (n_clusters * 36,)
        The point table of the sweeps, for its displacements.
    x : float64, shape (n_clusters * 12,), dimension length / l
        Positions in cluster layout.
    volume : float64, shape (n_clusters * 4,), dimension length^3 / l^3
    cell_number : int64, shape (n_clusters / 2,)
        Number of each local cell; an image has that of its cell. A bond of a point to its own image counts once.
    finite : bool
    quanta : float64, shape (2,), dimension length^8
        Powers of two, of the two kinds of terms; 0 to measure only.
    sums : int64, shape (n_clusters * 60,)
        Added to, in quanta.
    top : float64, shape (2,)
        Raised to the largest terms, where the quanta are 0.
    """
    stride = 2 * W if finite else W
    terms, eta, xi = np.empty(GRADIENTS), np.empty(3), np.empty(3)
    measuring = quanta[0] == 0.0
    of_change = 0.0 if measuring else 1.0 / quanta[0]
    of_shape = 0.0 if measuring else 1.0 / quanta[1]
    for i in range(row_start.size - 1):
        c = i // W
        k = i - c * W
        for row in range(row_start[i], row_start[i + 1]):
            other = np.int64(row_offset[row]) // (9 * W)
            for lane in range(W):
                if row_data[row * stride + lane] == 0.0:
                    continue
                square = 0.0
                for d in range(3):
                    eta[d] = S[other * 9 * W + d * W + lane] - S[c * 9 * W + d * W + k]
                    xi[d] = x[other * 3 * W + d * W + lane] - x[c * 3 * W + d * W + k]
                    square += xi[d] * xi[d]
                weight = volume[W * c + k] * volume[W * other + lane] * math.exp(-square)
                if cell_number[c // 2] == cell_number[other // 2] and (W * c + k) % 8 == (W * other + lane) % 8:
                    weight *= 0.5
                for d in range(3):
                    after = (d + 1) % 3
                    terms[d] = weight * eta[d] * xi[d]
                    terms[3 + d] = weight * eta[d] * xi[after]
                    terms[6 + d] = weight * eta[after] * xi[d]
                    terms[9 + d] = weight * xi[d] * xi[d]
                    terms[12 + d] = weight * xi[d] * xi[after]
                if measuring:
                    for t in range(9):
                        top[0] = max(top[0], abs(terms[t]))
                    for t in range(9, GRADIENTS):
                        top[1] = max(top[1], abs(terms[t]))
                    continue
                for t in range(GRADIENTS):
                    term = np.int64(np.rint(terms[t] * (of_change if t < 9 else of_shape)))
                    sums[GRADIENTS * W * c + W * t + k] += term
                    sums[GRADIENTS * W * other + W * t + lane] += term


_f8, _i8 = types.float64[::1], types.int64[::1]
_f4 = types.float32[::1]
_rows = _i8, types.uint32[::1], _f4
SIGNATURES = {
    add_stresses: types.void(*_rows, _f8, _f8, _f8, types.boolean, _f4, _f8, _i8, _f8),
    add_thermal_forces: types.void(*_rows, _f8, _f8, _f8, _f4, _f8, _i8, _f8),
    add_thermal_dilatations: types.void(*_rows, _f8, _f8, _f4, _f8, _i8, _f8),
    add_gradients: types.void(*_rows, _f8, _f8, _f8, _i8, types.boolean, _f8, _i8, _f8),
}
