"""Bonds that have softened where Poisson's ratio is not 1/4: their part in dilatations, and their forces.

A bond of the list (`softened_bonds`) has lost a part of its stiffness, and with it the same part of its weight in the
dilatations of its points: with what is left, ``phi``, it adds ``phi k e`` to these, and its force is ``phi`` times
that of the intact bond at the ``q`` of its points (`dilatation_sweeps`, `volumetric_sweeps`). So the energy is one
quadratic form for given teeth, and a bond that is gone has no part in it.

Every kernel begins with the list as in `softened_bonds`; all numbers of a bond have the same bits from either end.
"""

import math

import numpy as np
from numba import njit, types

from pdfem_mpi.kernels.bond_response import SMALLEST_SQUARE
from pdfem_mpi.kernels.simd import W
from pdfem_mpi.kernels.softened_bonds import add_pair

_options = {"cache": True, "nogil": True, "boundscheck": False, "error_model": "numpy"}


@njit(**_options)
def _add_to_both(DI, i, j, term):
    """Add the term of one bond, in quanta, to both of its points."""
    p = np.int64(np.rint(term))
    DI[i] += p
    DI[j] += p


@njit(**_options)
def add_softened_dilatations(n, pairs, strengths, law, tooth, stiffness, finite, S, DI, quantum, extremes):
    """Add ``phi k e`` of the list to both points of every bond.

    Parameters
    ----------
    DI : int64, shape (n_clusters * 4,)
        The sums, in multiples of ``quantum``; added to.
    extremes : float64, shape (2,)
        The first is raised to ``|e|`` (finite), or ``|K' (eta . xi)|`` (linear).
    """
    per_quantum = 1.0 / quantum
    for t in range(n):
        i = 36 * (pairs[t, 0] // W) + pairs[t, 0] % W
        j = 36 * (pairs[t, 1] // W) + pairs[t, 1] % W
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
        _add_to_both(DI, pairs[t, 0], pairs[t, 1], term * per_quantum)


@njit(**_options)
def add_softened_changes(n, pairs, strengths, law, tooth, stiffness, S, DI, quantum, extremes):
    """Add the change of ``phi k e`` for a small change of the displacements, to both points of every bond.

    The table has the change in rows 0-2 and deformed positions in rows 3-5; ``extremes[0]`` is raised to the largest
    change, dimension force length.
    """
    per_quantum = 1.0 / quantum
    for t in range(n):
        i = 36 * (pairs[t, 0] // W) + pairs[t, 0] % W
        j = 36 * (pairs[t, 1] // W) + pairs[t, 1] % W
        yx, yy, yz = S[j + 3 * W] - S[i + 3 * W], S[j + 4 * W] - S[i + 4 * W], S[j + 5 * W] - S[i + 5 * W]
        along = ((S[j] - S[i]) * yx + (S[j + W] - S[i + W]) * yy) + (S[j + 2 * W] - S[i + 2 * W]) * yz
        e = ((yx * yx + yy * yy) + yz * yz) * np.float64(strengths[t, 1]) - 1.0
        above = max(1.0 + e, SMALLEST_SQUARE)
        shrink = 1.0 - e / (above + math.sqrt(above))
        term = 2.0 * np.float64(strengths[t, 0]) * stiffness[law[t], tooth[t]] * shrink * along
        extremes[0] = max(extremes[0], abs(term))
        _add_to_both(DI, pairs[t, 0], pairs[t, 1], term * per_quantum)


@njit(**_options)
def add_softened_volumetric_forces(n, pairs, strengths, law, tooth, stiffness, finite, S, SI, quantum, Q):
    """Add the forces of the list to both of their points.

    Parameters
    ----------
    Q : float64, shape (n_clusters * 4,)
        ``q`` of all points.
    """
    per_quantum = 1.0 / quantum
    for t in range(n):
        i = 36 * (pairs[t, 0] // W) + pairs[t, 0] % W
        j = 36 * (pairs[t, 1] // W) + pairs[t, 1] % W
        ux, uy, uz = S[j] - S[i], S[j + W] - S[i + W], S[j + 2 * W] - S[i + 2 * W]
        gx, gy, gz = S[j + 3 * W] - S[i + 3 * W], S[j + 4 * W] - S[i + 4 * W], S[j + 5 * W] - S[i + 5 * W]
        common = Q[pairs[t, 0]] + Q[pairs[t, 1]]
        work = (ux * gx + uy * gy) + uz * gz
        if finite:
            e = work * np.float64(strengths[t, 1])
            above = max(1.0 + e, SMALLEST_SQUARE)
            phi = e / (above + math.sqrt(above))
            f = phi + (1.0 - phi) * common
            gx, gy, gz = gx + ux, gy + uy, gz + uz
        else:
            f = work + ((gx * gx + gy * gy) + gz * gz) * common
        f *= np.float64(strengths[t, 0]) * stiffness[law[t], tooth[t]]
        add_pair(SI, i, j, f * gx, f * gy, f * gz, per_quantum)


@njit(**_options)
def add_softened_volumetric_tangent(n, pairs, strengths, law, tooth, stiffness, S, SI, quantum, Q, change):
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
        i = 36 * (pairs[t, 0] // W) + pairs[t, 0] % W
        j = 36 * (pairs[t, 1] // W) + pairs[t, 1] % W
        vx, vy, vz = S[j] - S[i], S[j + W] - S[i + W], S[j + 2 * W] - S[i + 2 * W]
        yx, yy, yz = S[j + 3 * W] - S[i + 3 * W], S[j + 4 * W] - S[i + 4 * W], S[j + 5 * W] - S[i + 5 * W]
        common = Q[pairs[t, 0]] + Q[pairs[t, 1]]
        changed = change[pairs[t, 0]] + change[pairs[t, 1]]
        inverse = np.float64(strengths[t, 1])
        e = ((yx * yx + yy * yy) + yz * yz) * inverse - 1.0
        above = max(1.0 + e, SMALLEST_SQUARE)
        phi = e / (above + math.sqrt(above))
        shrink = 1.0 - phi
        k = 2.0 * np.float64(strengths[t, 0]) * stiffness[law[t], tooth[t]]
        along = inverse * (1.0 - common) * (shrink * shrink) * ((yx * vx + yy * vy) + yz * vz) + changed
        along *= k * shrink
        across = k * (phi + shrink * common)
        px, py, pz = across * vx + along * yx, across * vy + along * yy, across * vz + along * yz
        peak = max(peak, abs(px), abs(py), abs(pz))
        add_pair(SI, i, j, px, py, pz, per_quantum)
    return peak


_f8, _i8, _int = types.float64[::1], types.int64[::1], types.int64
_table = types.float64[:, ::1]
_list = (_int, types.int64[:, ::1], types.float32[:, ::1], _i8, _i8, _table)
SIGNATURES = {
    add_softened_dilatations: types.void(*_list, types.boolean, _f8, _i8, types.float64, _f8),
    add_softened_changes: types.void(*_list, _f8, _i8, types.float64, _f8),
    add_softened_volumetric_forces: types.void(*_list, types.boolean, _f8, _i8, types.float64, _f8),
    add_softened_volumetric_tangent: types.float64(*_list, _f8, _i8, types.float64, _f8, _f8),
}
