"""Bonds that have softened: a list beside the rows of the sweeps, whose slots in the rows are empty.

A bond of the list has the stored numbers it had in its row, and a tooth of its law: its stiffness is that of the intact
bond times the tooth's, in tension and compression alike. Forces, tangent and energies are those of the sweeps in
`bond_sweeps`, `bond_tangent` and `bond_failure`, a bond at a time; each component of a force is rounded to a multiple
of the sweeps' quantum and added as an integer. All numbers of a bond have the same bits from either of its ends.

Every kernel begins with the list: ``n`` bonds; local points ``pairs``, int64, shape (n, 2); stored numbers
``strengths``, float32, shape (n, 2); ``law`` and ``tooth``, int64, shape (n,); ``stiffness``, float64, shape (n_laws,
most teeth + 1), 0 from the last tooth on. ``S`` and ``SI`` are the table of the sweeps, shape (n_clusters * 36,).
"""

import math

import numpy as np
from numba import njit, types

from pdfem_mpi.kernels.bond_response import SMALLEST_SQUARE
from pdfem_mpi.kernels.simd import W

_options = {"cache": True, "nogil": True, "boundscheck": False, "error_model": "numpy"}


@njit(**_options)
def add_pair(SI, i, j, x, y, z, per_quantum):
    """Add the force of one bond to the entry ``i`` of its first point, and take it from ``j`` of its second."""
    px = np.int64(np.rint(x * per_quantum))
    py = np.int64(np.rint(y * per_quantum))
    pz = np.int64(np.rint(z * per_quantum))
    SI[i + 6 * W] += px
    SI[i + 7 * W] += py
    SI[i + 8 * W] += pz
    SI[j + 6 * W] -= px
    SI[j + 7 * W] -= py
    SI[j + 8 * W] -= pz


@njit(**_options)
def add_softened_forces(n, pairs, strengths, law, tooth, stiffness, finite, S, SI, quantum):
    """Add the forces of the list to both of their points.

    Returns
    -------
    float
        Largest ``|e|`` (finite), or ``|K' (eta . xi)|`` (linear): what `Bounds.bond` bounds.
    """
    per_quantum = 1.0 / quantum
    peak = 0.0
    for t in range(n):
        i = 36 * (pairs[t, 0] // W) + pairs[t, 0] % W
        j = 36 * (pairs[t, 1] // W) + pairs[t, 1] % W
        ux, uy, uz = S[j] - S[i], S[j + W] - S[i + W], S[j + 2 * W] - S[i + 2 * W]
        gx, gy, gz = S[j + 3 * W] - S[i + 3 * W], S[j + 4 * W] - S[i + 4 * W], S[j + 5 * W] - S[i + 5 * W]
        k = np.float64(strengths[t, 0]) * stiffness[law[t], tooth[t]]
        work = (ux * gx + uy * gy) + uz * gz
        if finite:
            e = work * np.float64(strengths[t, 1])
            above = max(1.0 + e, SMALLEST_SQUARE)
            f = k * (e / (above + math.sqrt(above)))
            gx, gy, gz = gx + ux, gy + uy, gz + uz
            peak = max(peak, abs(e))
        else:
            f = k * work
            peak = max(peak, abs(f))
        add_pair(SI, i, j, f * gx, f * gy, f * gz, per_quantum)
    return peak


@njit(**_options)
def add_softened_tangent(n, pairs, strengths, law, tooth, stiffness, S, SI, quantum):
    """Add the change of the finite forces of the list for a small change of the displacements, as `bond_tangent` does.

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
        inverse = np.float64(strengths[t, 1])
        e = ((yx * yx + yy * yy) + yz * yz) * inverse - 1.0
        above = max(1.0 + e, SMALLEST_SQUARE)
        phi = e / (above + math.sqrt(above))
        k = 2.0 * np.float64(strengths[t, 0]) * stiffness[law[t], tooth[t]]
        shrink = 1.0 - phi
        along = (k * inverse) * (shrink * shrink * shrink) * ((yx * vx + yy * vy) + yz * vz)
        across = k * phi
        px, py, pz = across * vx + along * yx, across * vy + along * yy, across * vz + along * yz
        peak = max(peak, abs(px), abs(py), abs(pz))
        add_pair(SI, i, j, px, py, pz, per_quantum)
    return peak


@njit(**_options)
def measure_softened(n, pairs, strengths, law, tooth, stiffness, finite, S, stretch, square, energy):
    """Stretch, squared length and energy of each bond of the list at the displacements of the table.

    Parameters
    ----------
    stretch : float64, shape (n,), dimension 1
    square : float64, shape (n,), dimension length^2
    energy : float64, shape (n,), dimension force length
        Of the intact bond; overwritten, like the others.
    """
    for t in range(n):
        i = 36 * (pairs[t, 0] // W) + pairs[t, 0] % W
        j = 36 * (pairs[t, 1] // W) + pairs[t, 1] % W
        gx, gy, gz = S[j + 3 * W] - S[i + 3 * W], S[j + 4 * W] - S[i + 4 * W], S[j + 5 * W] - S[i + 5 * W]
        work = ((S[j] - S[i]) * gx + (S[j + W] - S[i + W]) * gy) + (S[j + 2 * W] - S[i + 2 * W]) * gz
        k = np.float64(strengths[t, 0])
        if finite:
            inverse = np.float64(strengths[t, 1])
            e = work * inverse
            below = 1.0 + math.sqrt(max(1.0 + e, 0.0))
            stretch[t] = e / below
            square[t] = 1.0 / inverse
            energy[t] = (k * stretch[t]) * (work / below)
        else:
            square[t] = (gx * gx + gy * gy) + gz * gz
            stretch[t] = work / square[t]
            energy[t] = 0.5 * k * work * work


@njit(**_options)
def advance_softened(n, law, tooth, limit, teeth, fresh, stretch, margin):
    """Move every bond on through the teeth that its stretch passes.

    Parameters
    ----------
    limit : float64, shape (n_laws, most teeth)
    teeth : int64, shape (n_laws,)
    fresh : int
        Bonds from here on have just left their rows, and go through their first tooth whatever their stretch reads.
    stretch : float64, shape (n,)
    margin : float
        They move on this fraction below a limit.

    Returns
    -------
    int
        How many moved.
    """
    moved = 0
    for t in range(n):
        at = tooth[t]
        if t >= fresh:
            tooth[t] += 1
        while tooth[t] < teeth[law[t]] and stretch[t] > (1.0 - margin) * limit[law[t], tooth[t]]:
            tooth[t] += 1
        if tooth[t] != at:
            moved += 1
    return moved


@njit(**_options)
def write_slots(pairs, values, row_start, row_offset, row_data, finite):
    """Write stored numbers into the slots that bonds have in these rows, or had.

    Parameters
    ----------
    pairs, values : int64, float32, shape (n, 2)
    row_start, row_offset, row_data
        Rows as in the sweeps; changed. A bond stands in the rows of its first point alone.
    finite : bool
    """
    stride = 2 * W if finite else W
    for t in range(pairs.shape[0]):
        i, j = pairs[t, 0], pairs[t, 1]
        if i >= row_start.size - 1:
            continue
        for row in range(row_start[i], row_start[i + 1]):
            if np.int64(row_offset[row]) == 9 * W * (j // W):
                row_data[row * stride + j % W] = values[t, 0]
                if finite:
                    row_data[row * stride + W + j % W] = values[t, 1]


_f8, _i8, _int = types.float64[::1], types.int64[::1], types.int64
_list = (_int, types.int64[:, ::1], types.float32[:, ::1], _i8, _i8, types.float64[:, ::1])
SIGNATURES = {
    add_softened_forces: types.float64(*_list, types.boolean, _f8, _i8, types.float64),
    add_softened_tangent: types.float64(*_list, _f8, _i8, types.float64),
    measure_softened: types.void(*_list, types.boolean, _f8, _f8, _f8, _f8),
    write_slots: types.void(
        types.int64[:, ::1], types.float32[:, ::1], _i8, types.uint32[::1], types.float32[::1], types.boolean
    ),
    advance_softened: _int(_int, _i8, _i8, types.float64[:, ::1], _i8, _int, _f8, types.float64),
}
