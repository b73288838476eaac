"""The change of the dilatations of the peridynamic points for a small change of the displacements, finite kinematics.

With ``v`` the change of a bond's displacement and ``y`` the deformed bond, that of ``k e`` (`dilatation_sweeps`) is
``2 K (1 - phi) (y . v)``, ``(1 - phi) = r0 / |y|``.
"""

from numba import njit, types

from pdfem_mpi.kernels.bond_response import (
    ONE,
    STEP,
    V1,
    V2,
    V3,
    V4,
    V5,
    V6,
    ask_ahead,
    numbers_of,
    response_by_series,
    response_in_closed_form,
    u8,
)
from pdfem_mpi.kernels.simd import W, fma, held, hmax, iadd, ihsum, largest, load, magnitude, splat, store

_options = {"cache": True, "nogil": True, "boundscheck": False, "error_model": "numpy"}


def _changes(closed, weighted):
    """Build the sweep of the change of the dilatations, with ``phi`` in closed form or as a series."""

    @njit(**_options)
    def add_dilatation_changes(
        first, last, row_start, row_offset, row_data, S, D, DI, table, weights, extremes
    ):  # fmt: skip
        """Add the change of ``k e`` for a small change ``v`` of the displacements, to both points of every bond.

        Parameters are those of the sweeps of the dilatations, with ``v`` in rows 0-2 of the table, deformed positions
        in rows 3-5, and ``extremes[0]`` the largest change met, dimension force length.
        """
        zero = splat(0.0)
        numbers = numbers_of(1, table)
        M = held(table[V5])
        one = held(table[V6])
        peak = splat(extremes[0])
        for i in range(first, last):
            r = u8(row_start[i])
            end = u8(row_start[i + 1])
            if end <= r:
                continue
            c = i // W
            own = c * 9 * W + (i - c * W)
            ux = splat(S[own])
            uy = splat(S[own + W])
            uz = splat(S[own + 2 * W])
            zx = splat(S[own + 3 * W])
            zy = splat(S[own + 4 * W])
            zz = splat(S[own + 5 * W])
            total = zero
            while r < end:
                b = u8(row_offset[r])
                o = r * STEP
                r += ONE
                ask_ahead(row_offset, row_data, r, o)
                yx = load(S, b + V3) - zx
                yy = load(S, b + V4) - zy
                yz = load(S, b + V5) - zz
                e = fma(yx, yx, fma(yy, yy, yz * yz)) * load(row_data, o + V1) - one
                phi = response_in_closed_form(one, e, numbers) if closed else response_by_series(one, e, numbers)
                k = load(row_data, o)
                k = k + k
                along = fma(load(S, b) - ux, yx, fma(load(S, b + V1) - uy, yy, (load(S, b + V2) - uz) * yz))
                along = k * (one - phi) * along
                peak = largest(magnitude(along), peak)
                if weighted:
                    total = iadd(total, fma(along, load(weights, o), M))
                    p = fma(along, load(weights, o + V1), M)
                else:
                    p = along + M
                    total = iadd(total, p)
                b = b // u8(9)
                store(D, b, iadd(load(D, b), p))
            DI[i] += ihsum(total)
        extremes[0] = hmax(peak)
        return last

    return add_dilatation_changes


#: By (series, weighted).
CHANGES = {
    (True, False): _changes(closed=False, weighted=False),
    (False, False): _changes(closed=True, weighted=False),
    (True, True): _changes(closed=False, weighted=True),
    (False, True): _changes(closed=True, weighted=True),
}

_f8, _i8, _int, _f4 = types.float64[::1], types.int64[::1], types.int64, types.float32[::1]
_change = _int(_int, _int, _i8, types.uint32[::1], _f4, _f8, _f8, _i8, _f8, _f4, _f8)
SIGNATURES = dict.fromkeys(CHANGES.values(), _change)
