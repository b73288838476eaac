"""Bonds that have softened where Poisson's ratio is not 1/4: their part in dilatations, and their forces.

A bond of the list (`softened_bonds`) has lost a part of its stiffness, and with it the same part of its weight in the
dilatations of its points: with what is left, ``phi``, it adds ``phi s k e`` to these, and its force is ``phi`` times
that of the intact bond at the ``q`` of its points (`dilatation_sweeps`, `volumetric_sweeps`). So the energy is one
quadratic form for given teeth, and a bond that is gone has no part in it.

Every kernel begins with the list as in `softened_bonds`; ``material`` and ``scale`` are as in `volumetric_sweeps`, and
all numbers of a bond have the same bits from either of its ends.
"""

import math

import numpy as np
from numba import njit, types

from pdfem_mpi.kernels.simd import W

_options = {"cache": True, "nogil": True, "boundscheck": False, "error_model": "numpy"}


@njit(**_options)
def add_softened_dilatations(
    n, pairs, strengths, law, tooth, stiffness, finite, S, material, scale, DI, quantum, extremes
):  # fmt: skip
    """Add ``phi s k e`` of the list to both points of every bond.

    Parameters
    ----------
    DI : int64, shape (n_clusters * 4,)
        The sums, in multiples of ``quantum``; added to.
    extremes : float64, shape (2,)
        The first is raised to ``|e|`` (finite), or ``|K' (eta . xi)|`` (linear).
    """
    per_quantum = 1.0 / quantum
    for t in range(n):
        one, two = pairs[t, 0] // W, pairs[t, 1] // W
        i, j = 36 * one + pairs[t, 0] % W, 36 * two + pairs[t, 1] % W
        gx, gy, gz = S[j + 3 * W] - S[i + 3 * W], S[j + 4 * W] - S[i + 4 * W], S[j + 5 * W] - S[i + 5 * W]
        work = ((S[j] - S[i]) * gx + (S[j + W] - S[i + W]) * gy) + (S[j + 2 * W] - S[i + 2 * W]) * gz
        k = np.float64(strengths[t, 0]) * stiffness[law[t], tooth[t]]
        if finite:
            e = work * np.float64(strengths[t, 1])
            extremes[0] = max(extremes[0], abs(e))
            term = 2.0 * k * work / (1.0 + math.sqrt(max(1.0 + e, 0.0)))
        else:
            extremes[0] = max(extremes[0], abs(k * work))
            term = k * work * ((gx * gx + gy * gy) + gz * gz)
        if scale.shape[0] > 1:
            term *= scale[material[one], material[two]]
        p = np.int64(np.rint(term * per_quantum))
        DI[pairs[t, 0]] += p
        DI[pairs[t, 1]] += p


@njit(**_options)
def add_softened_changes(n, pairs, strengths, law, tooth, stiffness, S, material, scale, DI, quantum, extremes):
    """Add the change of ``phi s k e`` for a small change of the displacements, to both points of every bond.

    The table has the change in rows 0-2 and deformed positions in rows 3-5; ``extremes[0]`` is raised to the largest
    change, dimension force length.
    """
    per_quantum = 1.0 / quantum
    for t in range(n):
        one, two = pairs[t, 0] // W, pairs[t, 1] // W
        i, j = 36 * one + pairs[t, 0] % W, 36 * two + pairs[t, 1] % W
        yx, yy, yz = S[j + 3 * W] - S[i + 3 * W], S[j + 4 * W] - S[i + 4 * W], S[j + 5 * W] - S[i + 5 * W]
        along = ((S[j] - S[i]) * yx + (S[j + W] - S[i + W]) * yy) + (S[j + 2 * W] - S[i + 2 * W]) * yz
        e = ((yx * yx + yy * yy) + yz * yz) * np.float64(strengths[t, 1]) - 1.0
        above = max(1.0 + e, 0.0)
        shrink = 1.0 - e / (above + math.sqrt(above))
        term = 2.0 * np.float64(strengths[t, 0]) * stiffness[law[t], tooth[t]] * shrink * along
        if scale.shape[0] > 1:
            term *= scale[material[one], material[two]]
        extremes[0] = max(extremes[0], abs(term))
        p = np.int64(np.rint(term * per_quantum))
        DI[pairs[t, 0]] += p
        DI[pairs[t, 1]] += p


@njit(**_options)
def add_softened_volumetric_forces(
    n, pairs, strengths, law, tooth, stiffness, finite, S, SI, quantum, Q, material, scale
):  # fmt: skip
    """Add the forces of the list to both of their points.

    Parameters
    ----------
    Q : float64, shape (n_clusters * 4,)
        ``q`` of all points.
    """
    per_quantum = 1.0 / quantum
    for t in range(n):
        one, two = pairs[t, 0] // W, pairs[t, 1] // W
        i, j = 36 * one + pairs[t, 0] % W, 36 * two + pairs[t, 1] % W
        ux, uy, uz = S[j] - S[i], S[j + W] - S[i + W], S[j + 2 * W] - S[i + 2 * W]
        gx, gy, gz = S[j + 3 * W] - S[i + 3 * W], S[j + 4 * W] - S[i + 4 * W], S[j + 5 * W] - S[i + 5 * W]
        common = Q[pairs[t, 0]] + Q[pairs[t, 1]]
        if scale.shape[0] > 1:
            common *= scale[material[one], material[two]]
        work = (ux * gx + uy * gy) + uz * gz
        if finite:
            e = work * np.float64(strengths[t, 1])
            above = max(1.0 + e, 0.0)
            phi = e / (above + math.sqrt(above))
            f = phi + (1.0 - phi) * common
            gx, gy, gz = gx + ux, gy + uy, gz + uz
        else:
            f = work + ((gx * gx + gy * gy) + gz * gz) * common
        f *= np.float64(strengths[t, 0]) * stiffness[law[t], tooth[t]]
        px = np.int64(np.rint((f * gx) * per_quantum))
        py = np.int64(np.rint((f * gy) * per_quantum))
        pz = np.int64(np.rint((f * gz) * per_quantum))
        SI[i + 6 * W] += px
        SI[i + 7 * W] += py
        SI[i + 8 * W] += pz
        SI[j + 6 * W] -= px
        SI[j + 7 * W] -= py
        SI[j + 8 * W] -= pz


@njit(**_options)
def add_softened_volumetric_tangent(
    n, pairs, strengths, law, tooth, stiffness, S, SI, quantum, Q, material, scale, change
):  # fmt: skip
    """Add the change of the finite forces of the list for a small change of the displacements.

    Parameters
    ----------
    Q, change : float64, shape (n_clusters * 4,)
        ``q`` where the tangent is taken, and its change.

    Returns
    -------
    float
        Largest component of a force.
    """
    per_quantum = 1.0 / quantum
    peak = 0.0
    for t in range(n):
        one, two = pairs[t, 0] // W, pairs[t, 1] // W
        i, j = 36 * one + pairs[t, 0] % W, 36 * two + pairs[t, 1] % W
        vx, vy, vz = S[j] - S[i], S[j + W] - S[i + W], S[j + 2 * W] - S[i + 2 * W]
        yx, yy, yz = S[j + 3 * W] - S[i + 3 * W], S[j + 4 * W] - S[i + 4 * W], S[j + 5 * W] - S[i + 5 * W]
        weight = scale[material[one], material[two]] if scale.shape[0] > 1 else 1.0
        common = (Q[pairs[t, 0]] + Q[pairs[t, 1]]) * weight
        changed = (change[pairs[t, 0]] + change[pairs[t, 1]]) * weight
        inverse = np.float64(strengths[t, 1])
        e = ((yx * yx + yy * yy) + yz * yz) * inverse - 1.0
        above = max(1.0 + e, 0.0)
        phi = e / (above + math.sqrt(above))
        shrink = 1.0 - phi
        k = 2.0 * np.float64(strengths[t, 0]) * stiffness[law[t], tooth[t]]
        along = inverse * (1.0 - common) * (shrink * shrink) * ((yx * vx + yy * vy) + yz * vz) + changed
        along *= k * shrink
        across = k * (phi + shrink * common)
        px, py, pz = across * vx + along * yx, across * vy + along * yy, across * vz + along * yz
        peak = max(peak, abs(px), abs(py), abs(pz))
        ix = np.int64(np.rint(px * per_quantum))
        iy = np.int64(np.rint(py * per_quantum))
        iz = np.int64(np.rint(pz * per_quantum))
        SI[i + 6 * W] += ix
        SI[i + 7 * W] += iy
        SI[i + 8 * W] += iz
        SI[j + 6 * W] -= ix
        SI[j + 7 * W] -= iy
        SI[j + 8 * W] -= iz
    return peak


_f8, _i8, _int, _i2 = types.float64[::1], types.int64[::1], types.int64, types.int16[::1]
_table = types.float64[:, ::1]
_list = (_int, types.int64[:, ::1], types.float32[:, ::1], _i8, _i8, _table)
_law = _i2, _table
SIGNATURES = {
    add_softened_dilatations: types.void(*_list, types.boolean, _f8, *_law, _i8, types.float64, _f8),
    add_softened_changes: types.void(*_list, _f8, *_law, _i8, types.float64, _f8),
    add_softened_volumetric_forces: types.void(*_list, types.boolean, _f8, _i8, types.float64, _f8, *_law),
    add_softened_volumetric_tangent: types.float64(*_list, _f8, _i8, types.float64, _f8, *_law, _f8),
}
