"""Bond forces of the peridynamic points: response (2), stretch (3), failure (4), force density (14).

**Table.** Point data stand in ``S[cluster][9][4]``: displacement ``u``, ``z`` and force, each with components x, y,
z over the four points of the cluster. Finite kinematics use ``z = 2 x + u``, linear kinematics ``z = x``.

**Finite.** With ``xi = x_j - x_i``, ``eta = u_j - u_i`` (the paper prints eta with the other sign) and
``d = z_j - z_i = 2 xi + eta``::

    e   = (eta . d) / |xi|^2                    (1 + s)^2 = 1 + e, eq. (3) without cancellation or square root
    phi = 1 - (1 + e)^(-1/2)                    a series in e up to e^5, or e / ((1 + e) + sqrt(1 + e))
    f   = K phi (d + eta),  K = 1/2 c exp(-r0^2) g_ij w_i w_j / r0        eq. (2) times both volumes

and ``f`` is added to i and taken from j. The series is used while ``|e| <= SERIES_LIMIT`` on every bond of every
rank; its relative error is about ``0.45 |e|^5``, 1.3e-8 at the limit, 1e-14 at a stretch of 1e-3.

**Linear.** ``f = K' (eta . xi) xi`` with ``K' = c exp(-r0^2) g_ij w_i w_j / r0^3``, the undeformed state's tangent.

**Failure (4).** ``s > s_0`` is ``e > (1 + s_0)^2 - 1``, in linear kinematics ``eta . xi > s_0 |xi|^2``. The row loop
keeps the largest excess of a point over the lowest limit of its class; if it is above 0, the rows are visited again
with the limit of each pair of classes, the forces of the broken bonds are taken back, the bonds are recorded, and their
stored numbers set to 0, so that a broken bond is a slot without a bond.

**Sums.** Each component ``p`` of a bond's force is rounded once to a multiple of the quantum ``q`` by ``fma(f, d, M)``,
``M = 1.5 * 2**52 q``, and the bit patterns are added as integers: exact, in any order, while ``|p| < 2**51 q``
for each single bond (integers wrap harmlessly in between). The rounding error of a point's force is at most
``q / 2`` a bond and ``q <= 2**-49`` of the largest bond force admitted by the bound; taking back a force is exact.
"""

import numpy as np
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
from pdfem_mpi.kernels.simd import (
    W,
    above,
    both,
    fma,
    fnma,
    held,
    hmax,
    hmin,
    iadd,
    ihsum,
    isub,
    lanes,
    largest,
    load,
    magnitude,
    smallest,
    splat,
    store,
)  # fmt: skip

_options = {"cache": True, "nogil": True, "boundscheck": False, "error_model": "numpy"}


def _finite_sweep(closed, failing):
    """Build the sweep with ``phi`` in closed form or as a series, with or without failure.

    The two flags are constants to the compiler (a compiled function as a free variable could not be cached).
    """

    @njit(**_options)
    def add_bond_forces(
        first, last, row_start, row_offset, row_data, S, SI, table, extremes,
        class_of, trigger, critical, pairs, strengths, counter,
    ):  # fmt: skip
        """Add the force of every bond of the rows of points ``first:last`` to both of its points (eqs 2-4, 14).

        Parameters
        ----------
        first, last : int
            Range of owned points.
        row_start : int64, shape (n_points + 1,)
        row_offset : uint32, shape (n_rows + 1,)
        row_data : float32, shape ((n_rows + 1) * 8,)
            ``K`` and ``1 / r0^2`` of the four slots; zeroed for bonds that break.
        S, SI : float64, int64, shape (n_clusters * 36,)
            The table and its view as integers; force rows are added to.
        table : float64, shape (32,)
            From `constants`.
        extremes : float64, shape (2,)
            Largest and smallest ``e`` met on intact bonds; widened.
        class_of : uint8, shape (n_clusters,)
            Class of each cluster's points; this and what follows matters to the failing sweeps only.
        trigger : float64, shape (n_classes,)
            Lowest limit of ``e`` of a bond with a point of the class.
        critical : float64, shape (n_classes, n_classes)
            Limit of ``e`` by the classes of the two points: ``(1 + s_0)^2 - 1``.
        pairs : int64, shape (capacity, 2)
            Local points of the bonds that broke.
        strengths : float32, shape (capacity, 2)
            ``K`` and ``1 / r0^2`` of these bonds.
        counter : int64, shape (1,)
            Number of records; raised.

        Returns
        -------
        int
            The point to go on with: ``last``, or an earlier one before which the records could overflow.
        """
        zero = splat(0.0)
        numbers = numbers_of(table)
        M = held(table[V5])
        peak, floor = splat(extremes[0]), splat(extremes[1])
        count = counter[0]
        after = last
        for i in range(first, last):
            r = u8(row_start[i])
            end = u8(row_start[i + 1])
            if end <= r:
                continue
            if failing and count + W * (row_start[i + 1] - row_start[i]) > pairs.shape[0]:
                after = i
                break
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
            top = zero
            # e of the first row; later the e of the next row is computed while this row's force is scattered
            b = u8(row_offset[r])
            o = r * STEP
            dx = load(S, b) - ux
            gx = load(S, b + V3) - zx
            dy = load(S, b + V1) - uy
            gy = load(S, b + V4) - zy
            dz = load(S, b + V2) - uz
            gz = load(S, b + V5) - zz
            e = fma(dx, gx, fma(dy, gy, dz * gz)) * load(row_data, o + V1)
            gx = gx + dx
            gy = gy + dy
            gz = gz + dz
            while r < end:
                r += ONE  # past the last row this reads harmless numbers, hence one padding row
                b_next = u8(row_offset[r])
                o_next = o + STEP
                ask_ahead(row_offset, row_data, r, o_next)
                dx = load(S, b_next) - ux
                hx = load(S, b_next + V3) - zx
                dy = load(S, b_next + V1) - uy
                hy = load(S, b_next + V4) - zy
                dz = load(S, b_next + V2) - uz
                hz = load(S, b_next + V5) - zz
                e_next = fma(dx, hx, fma(dy, hy, dz * hz)) * load(row_data, o_next + V1)
                hx = hx + dx
                hy = hy + dy
                hz = hz + dz
                top = largest(e, top)
                floor = smallest(e, floor)
                k = load(row_data, o)
                f = response_in_closed_form(k, e, numbers) if closed else response_by_series(k, e, numbers)
                px = fma(f, gx, M)
                py = fma(f, gy, M)
                pz = fma(f, gz, M)
                fx = iadd(fx, px)
                fy = iadd(fy, py)
                fz = iadd(fz, pz)
                store(S, b + V6, isub(load(S, b + V6), px))
                store(S, b + V7, isub(load(S, b + V7), py))
                store(S, b + V8, isub(load(S, b + V8), pz))
                e = e_next
                gx = hx
                gy = hy
                gz = hz
                b = b_next
                o = o_next
            if failing and lanes(above(top, splat(trigger[class_of[c]]))) != 0:
                # rare: some bond of this point may have passed its critical stretch
                top = zero
                for row in range(u8(row_start[i]), end):
                    b = u8(row_offset[row])
                    o = u8(row) * STEP
                    dx = load(S, b) - ux
                    dy = load(S, b + V1) - uy
                    dz = load(S, b + V2) - uz
                    gx = load(S, b + V3) - zx
                    gy = load(S, b + V4) - zy
                    gz = load(S, b + V5) - zz
                    e = fma(dx, gx, fma(dy, gy, dz * gz)) * load(row_data, o + V1)
                    broken = above(e, splat(critical[class_of[c], class_of[b // u8(9 * W)]]))
                    if lanes(broken) == 0:
                        top = largest(e, top)
                        continue
                    k = load(row_data, o)
                    f = response_in_closed_form(k, e, numbers) if closed else response_by_series(k, e, numbers)
                    f = both(f, broken)
                    px = isub(fma(f, gx + dx, M), M)
                    py = isub(fma(f, gy + dy, M), M)
                    pz = isub(fma(f, gz + dz, M), M)
                    fx = isub(fx, px)
                    fy = isub(fy, py)
                    fz = isub(fz, pz)
                    store(S, b + V6, iadd(load(S, b + V6), px))
                    store(S, b + V7, iadd(load(S, b + V7), py))
                    store(S, b + V8, iadd(load(S, b + V8), pz))
                    top = largest(isub(e, both(e, broken)), top)  # e of the intact lanes, 0 on the broken
                    for lane in range(W):
                        if (lanes(broken) >> lane) & 1 and row_data[o + u8(lane)] != 0:
                            pairs[count, 0] = i
                            pairs[count, 1] = np.int64(b // u8(9 * W)) * W + lane
                            strengths[count, 0] = row_data[o + u8(lane)]
                            strengths[count, 1] = row_data[o + u8(W + lane)]
                            row_data[o + u8(lane)] = 0
                            row_data[o + u8(W + lane)] = 0
                            count += 1
            peak = largest(top, peak)
            SI[own + 6 * W] += ihsum(fx)
            SI[own + 7 * W] += ihsum(fy)
            SI[own + 8 * W] += ihsum(fz)
        extremes[0] = hmax(peak)
        extremes[1] = hmin(floor)
        counter[0] = count
        return after

    return add_bond_forces


add_forces_series = _finite_sweep(closed=False, failing=False)
add_forces_closed = _finite_sweep(closed=True, failing=False)
add_forces_series_failing = _finite_sweep(closed=False, failing=True)
add_forces_closed_failing = _finite_sweep(closed=True, failing=True)


def _linear_sweep(failing):
    """Build the sweep of linear kinematics, with or without failure (a constant to the compiler)."""

    @njit(**_options)
    def add_bond_forces(
        first, last, row_start, row_offset, row_data, S, SI, table, extremes,
        class_of, trigger, critical, pairs, strengths, counter,
    ):  # fmt: skip
        """Add the linearised bond forces ``K' (eta . xi) xi`` of the rows of points ``first:last``.

        Parameters and result are those of the finite sweep, with one number a slot (``row_data`` of shape ((n_rows +
        1) * 4,)), positions in rows 3-5 of the table, limits of the stretch instead of ``e``, and ``extremes[0]`` the
        largest ``|K' (eta . xi)|``, force / length: a component of a bond's force is at most that times the longest
        bond.
        """
        zero = splat(0.0)
        M = held(table[V5])
        peak = splat(extremes[0])
        count = counter[0]
        after = last
        for i in range(first, last):
            r = u8(row_start[i])
            end = u8(row_start[i + 1])
            if end <= r:
                continue
            if failing and count + W * (row_start[i + 1] - row_start[i]) > pairs.shape[0]:
                after = i
                break
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
            limit = splat(trigger[class_of[c]]) if failing else zero
            excess = zero
            b = u8(row_offset[r])
            gx = load(S, b + V3) - zx
            gy = load(S, b + V4) - zy
            gz = load(S, b + V5) - zz
            k = load(row_data, r * V1)
            f = fma(load(S, b) - ux, gx, fma(load(S, b + V1) - uy, gy, (load(S, b + V2) - uz) * gz))
            f = f * k
            while r < end:
                r += ONE  # past the last row this reads harmless numbers, hence one padding row
                b_next = u8(row_offset[r])
                hx = load(S, b_next + V3) - zx
                hy = load(S, b_next + V4) - zy
                hz = load(S, b_next + V5) - zz
                ask_ahead(row_offset, row_data, r, r * V1)
                k_next = load(row_data, r * V1)
                f_next = fma(
                    load(S, b_next) - ux,
                    hx,
                    fma(load(S, b_next + V1) - uy, hy, (load(S, b_next + V2) - uz) * hz),
                )
                f_next = f_next * k_next
                peak = largest(magnitude(f), peak)
                if failing:
                    excess = largest(fnma(limit, k * fma(gx, gx, fma(gy, gy, gz * gz)), f), excess)
                    k = k_next
                px = fma(f, gx, M)
                py = fma(f, gy, M)
                pz = fma(f, gz, M)
                fx = iadd(fx, px)
                fy = iadd(fy, py)
                fz = iadd(fz, pz)
                store(S, b + V6, isub(load(S, b + V6), px))
                store(S, b + V7, isub(load(S, b + V7), py))
                store(S, b + V8, isub(load(S, b + V8), pz))
                f = f_next
                gx = hx
                gy = hy
                gz = hz
                b = b_next
            if failing and lanes(above(excess, zero)) != 0:
                # rare: some bond of this point may have passed its critical stretch
                for row in range(u8(row_start[i]), end):
                    b = u8(row_offset[row])
                    o = u8(row) * V1
                    k = load(row_data, o)
                    gx = load(S, b + V3) - zx
                    gy = load(S, b + V4) - zy
                    gz = load(S, b + V5) - zz
                    f = fma(load(S, b) - ux, gx, fma(load(S, b + V1) - uy, gy, (load(S, b + V2) - uz) * gz))
                    f = f * k
                    limit = splat(critical[class_of[c], class_of[b // u8(9 * W)]])
                    broken = above(fnma(limit, k * fma(gx, gx, fma(gy, gy, gz * gz)), f), zero)
                    if lanes(broken) == 0:
                        continue
                    f = both(f, broken)
                    px = isub(fma(f, gx, M), M)
                    py = isub(fma(f, gy, M), M)
                    pz = isub(fma(f, gz, M), M)
                    fx = isub(fx, px)
                    fy = isub(fy, py)
                    fz = isub(fz, pz)
                    store(S, b + V6, iadd(load(S, b + V6), px))
                    store(S, b + V7, iadd(load(S, b + V7), py))
                    store(S, b + V8, iadd(load(S, b + V8), pz))
                    for lane in range(W):
                        if (lanes(broken) >> lane) & 1:
                            pairs[count, 0] = i
                            pairs[count, 1] = np.int64(b // u8(9 * W)) * W + lane
                            strengths[count, 0] = row_data[o + u8(lane)]
                            row_data[o + u8(lane)] = 0
                            count += 1
            SI[own + 6 * W] += ihsum(fx)
            SI[own + 7 * W] += ihsum(fy)
            SI[own + 8 * W] += ihsum(fz)
        extremes[0] = hmax(peak)
        counter[0] = count
        return after

    return add_bond_forces


add_forces_linear = _linear_sweep(failing=False)
add_forces_linear_failing = _linear_sweep(failing=True)
#: By (finite, series, failing).
SWEEPS = {
    (True, True, False): add_forces_series,
    (True, False, False): add_forces_closed,
    (True, True, True): add_forces_series_failing,
    (True, False, True): add_forces_closed_failing,
    (False, False, False): add_forces_linear,
    (False, False, True): add_forces_linear_failing,
}
#: What to call the sweeps: their functions share a name.
NAMES = {
    add_forces_series: "finite, series",
    add_forces_closed: "finite, closed form",
    add_forces_series_failing: "finite, series, breaking",
    add_forces_closed_failing: "finite, closed form, breaking",
    add_forces_linear: "linear",
    add_forces_linear_failing: "linear, breaking",
}

_f8, _i8, _int = types.float64[::1], types.int64[::1], types.int64
_rows = (_i8, types.uint32[::1], types.float32[::1])
_records = (types.int64[:, ::1], types.float32[:, ::1], _i8)
_sweep = _int(_int, _int, *_rows, _f8, _i8, _f8, _f8, types.uint8[::1], _f8, types.float64[:, ::1], *_records)
SIGNATURES = {
    add_forces_series: _sweep,
    add_forces_closed: _sweep,
    add_forces_series_failing: _sweep,
    add_forces_closed_failing: _sweep,
    add_forces_linear: _sweep,
    add_forces_linear_failing: _sweep,
}
