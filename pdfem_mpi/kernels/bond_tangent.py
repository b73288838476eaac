"""The tangent of the bond forces in finite kinematics: their change for a small change of the displacements."""

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
    V7,
    V8,
    ask_ahead,
    numbers_of,
    response_by_series,
    response_in_closed_form,
    u8,
)  # fmt: skip
from pdfem_mpi.kernels.simd import W, fma, held, hmax, iadd, ihsum, isub, largest, load, magnitude, splat, store

_options = {"cache": True, "nogil": True, "boundscheck": False, "error_model": "numpy"}


def _tangent_sweep(closed):
    """Build the sweep of the tangent, with ``phi`` in closed form or as a series."""

    @njit(**_options)
    def add_tangent_forces(first, last, row_start, row_offset, row_data, S, SI, table, extremes):
        """Add the change of the finite bond forces for a small change ``v`` of the displacements.

        With ``y`` the deformed bond, ``|y|^2 / r0^2 = 1 + e`` and ``phi`` as above, the derivative of ``2 K phi y`` is
        ``2 K [phi v + (1 - phi)^3 / r0^2 (y . v) y]``.

        Parameters are those of the finite sweep up to ``extremes``, with ``v`` in rows 0-2 of the table, deformed
        positions in rows 3-5, and ``extremes[0]`` the largest component of a bond's force, dimension force.

        Returns
        -------
        int
            ``last``.
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
            fx = zero
            fy = zero
            fz = zero
            while r < end:
                b = u8(row_offset[r])
                o = r * STEP
                r += ONE
                ask_ahead(row_offset, row_data, r, o)
                vx = load(S, b) - ux
                vy = load(S, b + V1) - uy
                vz = load(S, b + V2) - uz
                yx = load(S, b + V3) - zx
                yy = load(S, b + V4) - zy
                yz = load(S, b + V5) - zz
                inverse = load(row_data, o + V1)
                e = fma(yx, yx, fma(yy, yy, yz * yz)) * inverse - one
                phi = response_in_closed_form(one, e, numbers) if closed else response_by_series(one, e, numbers)
                k = load(row_data, o)
                k = k + k
                shrink = one - phi
                along = (k * inverse) * (shrink * shrink * shrink) * fma(yx, vx, fma(yy, vy, yz * vz))
                across = k * phi
                px = fma(across, vx, fma(along, yx, M))
                py = fma(across, vy, fma(along, yy, M))
                pz = fma(across, vz, fma(along, yz, M))
                peak = largest(magnitude(px - M), largest(magnitude(py - M), largest(magnitude(pz - M), peak)))
                fx = iadd(fx, px)
                fy = iadd(fy, py)
                fz = iadd(fz, pz)
                store(S, b + V6, isub(load(S, b + V6), px))
                store(S, b + V7, isub(load(S, b + V7), py))
                store(S, b + V8, isub(load(S, b + V8), pz))
            SI[own + 6 * W] += ihsum(fx)
            SI[own + 7 * W] += ihsum(fy)
            SI[own + 8 * W] += ihsum(fz)
        extremes[0] = hmax(peak)
        return last

    return add_tangent_forces


add_tangent_series = _tangent_sweep(closed=False)
add_tangent_closed = _tangent_sweep(closed=True)
#: What to call the sweeps: their functions share a name.
NAMES = {add_tangent_series: "tangent, series", add_tangent_closed: "tangent, closed form"}

_f8, _i8, _int = types.float64[::1], types.int64[::1], types.int64
_tangent = _int(_int, _int, _i8, types.uint32[::1], types.float32[::1], _f8, _i8, _f8, _f8)
SIGNATURES = {add_tangent_series: _tangent, add_tangent_closed: _tangent}
