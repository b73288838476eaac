"""Dilatation of the peridynamic points, the first of two sweeps where Poisson's ratio is not 1/4, and its change.

The volumetric part of the energy is ``1/2 sum_i M_i w_i theta_i^2`` with ``w_i theta_i = sum_j A_ij e_ij``, ``e_ij``
the extension of a bond and ``A_ij = k_ij / (10 mu_ij)``, ``k_ij = c exp(-r0^2) g_ij w_i w_j``
(`peridynamics.volumetric`). The sweeps here add ``k_ij e_ij`` to both points of every bond, from the numbers that
bonds store anyway::

    linear          k e = K' r0^2 (eta . xi)
    finite          k e = 2 K (eta . d) / (1 + (1 + e)^(1/2))
    its change      2 K (1 - phi) (y . v),    (1 - phi) = r0 / |y|

``e`` in the last two is the number of `bond_sweeps`. Terms are rounded to multiples of a quantum and added as integers,
as forces are: the sums have the same bits in any order.

Bonds break here, before the forces are swept: a broken bond has no part in the dilatation of its points any more, and
what it gave is taken back exactly.
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
    ask_ahead,
    numbers_of,
    response_by_series,
    u8,
)
from pdfem_mpi.kernels.bond_response import constants as response_constants
from pdfem_mpi.kernels.bond_response import response_in_closed_form as _response
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
    root,
    smallest,
    splat,
    store,
)  # fmt: skip

#: Coefficients of ``1 / (1 + (1 + e)^(1/2)) = 1/2 - 1/8 e + ...``
SERIES = (1 / 2, -1 / 8, 1 / 16, -5 / 128, 7 / 256)
_A0, _A1, _A2, _A3, _A4 = (u8(W * k) for k in range(8, 13))
_NINE = u8(9)

_options = {"cache": True, "nogil": True, "boundscheck": False, "error_model": "numpy"}


def constants(pattern):
    """What the sweeps of finite kinematics read: `bond_response.constants`, then the coefficients of ``SERIES``.

    Returns
    -------
    float64, shape (52,)
    """
    return np.concatenate([response_constants(pattern), np.repeat(np.array(SERIES), W)])


@njit(inline="always")
def _lengthening_numbers(table):
    """Coefficients of ``SERIES``, and one, in registers."""
    return (
        held(table[_A0]),
        held(table[_A1]),
        held(table[_A2]),
        held(table[_A3]),
        held(table[_A4]),
        held(table[V6]),
    )


@njit(inline="always")
def lengthening_by_series(e, numbers):
    """``1 / (1 + (1 + e)^(1/2))`` by its series."""
    e2 = e * e
    high = fma(e2, numbers[4], fma(numbers[3], e, numbers[2]))
    return fma(e2, high, fma(numbers[1], e, numbers[0]))


@njit(inline="always")
def lengthening_in_closed_form(e, numbers):
    """The same in closed form, for large stretch and compression."""
    one = numbers[5]
    return one / (one + root(largest(one + e, splat(0.0))))


def _linear_sweep(failing, weighted):
    """Build the sweep of linear kinematics, with or without failure and fitted weights (constants to the compiler)."""

    @njit(**_options)
    def add_dilatations(
        first, last, row_start, row_offset, row_data, S, D, DI, pattern, weights, extremes,
        class_of, trigger, critical, pairs, strengths, counter,
    ):  # fmt: skip
        """Add ``k e`` of the bonds of the rows of points ``first:last`` to both of their points.

        Parameters
        ----------
        first, last, row_start, row_offset, row_data, S
            As in `bond_sweeps`; the table is only read.
        D, DI : float64, int64, shape (n_clusters * 4,)
            The sums, of both views; added to.
        pattern : float
            ``M`` of the quantum.
        weights : float32, shape ((n_rows + 1) * 8,) or (0,)
            Fitted weights of each slot in the dilatation of the row's point, and of the slot's; read where weighted.
        extremes : float64, shape (2,)
            The first is raised to ``|K' (eta . xi)|``.
        class_of, trigger, critical, pairs, strengths, counter
            As in `bond_sweeps`.

        Returns
        -------
        int
            The point to go on with.
        """
        zero = splat(0.0)
        M = splat(pattern)
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
            limit = splat(trigger[class_of[c]]) if failing else zero
            excess = zero
            total = zero
            while r < end:
                b = u8(row_offset[r])
                gx = load(S, b + V3) - zx
                gy = load(S, b + V4) - zy
                gz = load(S, b + V5) - zz
                f = fma(load(S, b) - ux, gx, fma(load(S, b + V1) - uy, gy, (load(S, b + V2) - uz) * gz))
                k = load(row_data, r * V1)
                o = r * STEP
                r += ONE
                ask_ahead(row_offset, row_data, r, r * V1)
                f = f * k
                square = fma(gx, gx, fma(gy, gy, gz * gz))
                peak = largest(magnitude(f), peak)
                if failing:
                    excess = largest(fnma(limit, k * square, f), excess)
                if weighted:
                    f = f * square
                    total = iadd(total, fma(f, load(weights, o), M))
                    p = fma(f, load(weights, o + V1), M)
                else:
                    p = fma(f, square, M)
                    total = iadd(total, p)
                b = b // _NINE
                store(D, b, iadd(load(D, b), p))
            if failing and lanes(above(excess, zero)) != 0:
                for row in range(u8(row_start[i]), end):  # rare: some bond may have passed its critical stretch
                    b = u8(row_offset[row])
                    o = u8(row) * V1
                    k = load(row_data, o)
                    gx = load(S, b + V3) - zx
                    gy = load(S, b + V4) - zy
                    gz = load(S, b + V5) - zz
                    f = fma(load(S, b) - ux, gx, fma(load(S, b + V1) - uy, gy, (load(S, b + V2) - uz) * gz))
                    f = f * k
                    square = fma(gx, gx, fma(gy, gy, gz * gz))
                    cluster = b // u8(9 * W)
                    broken = above(fnma(splat(critical[class_of[c], class_of[cluster]]), k * square, f), zero)
                    if lanes(broken) == 0:
                        continue
                    p = isub(fma(both(f, broken), square, M), M)
                    total = isub(total, p)
                    store(D, b // _NINE, isub(load(D, b // _NINE), p))
                    for lane in range(W):
                        if (lanes(broken) >> lane) & 1:
                            pairs[count, 0] = i
                            pairs[count, 1] = np.int64(cluster) * W + lane
                            strengths[count, 0] = row_data[o + u8(lane)]
                            row_data[o + u8(lane)] = 0
                            count += 1
            DI[i] += ihsum(total)
        extremes[0] = hmax(peak)
        counter[0] = count
        return after

    return add_dilatations


def _finite_sweep(closed, failing, weighted):
    """Build the sweep of finite kinematics, in closed form or as a series, with or without failure and weights."""

    @njit(**_options)
    def add_dilatations(
        first, last, row_start, row_offset, row_data, S, D, DI, table, weights, extremes,
        class_of, trigger, critical, pairs, strengths, counter,
    ):  # fmt: skip
        """Add ``k e`` of the bonds of the rows of points ``first:last`` to both of their points.

        Parameters and result are those of the linear sweep, with ``table`` from `constants` in place of the pattern,
        limits of ``e``, and ``extremes`` the largest and smallest ``e`` of intact bonds.
        """
        zero = splat(0.0)
        numbers = _lengthening_numbers(table)
        M = held(table[V5])
        peak = splat(extremes[0])
        floor = splat(extremes[1])
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
            top = zero
            total = zero
            while r < end:
                b = u8(row_offset[r])
                o = r * STEP
                r += ONE
                ask_ahead(row_offset, row_data, r, o)
                work = fma(
                    load(S, b) - ux, load(S, b + V3) - zx,
                    fma(load(S, b + V1) - uy, load(S, b + V4) - zy, (load(S, b + V2) - uz) * (load(S, b + V5) - zz)),
                )  # fmt: skip
                e = work * load(row_data, o + V1)
                top = largest(e, top)
                floor = smallest(e, floor)
                k = load(row_data, o)
                k = k + k
                h = lengthening_in_closed_form(e, numbers) if closed else lengthening_by_series(e, numbers)
                if weighted:
                    h = (k * work) * h
                    total = iadd(total, fma(h, load(weights, o), M))
                    p = fma(h, load(weights, o + V1), M)
                else:
                    p = fma(k * work, h, M)
                    total = iadd(total, p)
                b = b // _NINE
                store(D, b, iadd(load(D, b), p))
            if failing and lanes(above(top, splat(trigger[class_of[c]]))) != 0:
                top = zero
                for row in range(u8(row_start[i]), end):  # rare: some bond may have passed its critical stretch
                    b = u8(row_offset[row])
                    o = u8(row) * STEP
                    work = fma(
                        load(S, b) - ux, load(S, b + V3) - zx,
                        fma(load(S, b + V1) - uy, load(S, b + V4) - zy,
                            (load(S, b + V2) - uz) * (load(S, b + V5) - zz)),
                    )  # fmt: skip
                    e = work * load(row_data, o + V1)
                    cluster = b // u8(9 * W)
                    broken = above(e, splat(critical[class_of[c], class_of[cluster]]))
                    if lanes(broken) == 0:
                        top = largest(e, top)
                        continue
                    k = load(row_data, o)
                    k = k + k
                    h = lengthening_in_closed_form(e, numbers) if closed else lengthening_by_series(e, numbers)
                    p = isub(fma(both(k * work, broken), h, M), M)
                    total = isub(total, p)
                    store(D, b // _NINE, isub(load(D, b // _NINE), p))
                    top = largest(isub(e, both(e, broken)), top)  # e of the intact lanes, 0 on the broken
                    for lane in range(W):
                        if (lanes(broken) >> lane) & 1 and row_data[o + u8(lane)] != 0:
                            pairs[count, 0] = i
                            pairs[count, 1] = np.int64(cluster) * W + lane
                            strengths[count, 0] = row_data[o + u8(lane)]
                            strengths[count, 1] = row_data[o + u8(W + lane)]
                            row_data[o + u8(lane)] = 0
                            row_data[o + u8(W + lane)] = 0
                            count += 1
            peak = largest(top, peak)
            DI[i] += ihsum(total)
        extremes[0] = hmax(peak)
        extremes[1] = hmin(floor)
        counter[0] = count
        return after

    return add_dilatations


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
                phi = _response(one, e, numbers) if closed else response_by_series(one, e, numbers)
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
                b = b // _NINE
                store(D, b, iadd(load(D, b), p))
            DI[i] += ihsum(total)
        extremes[0] = hmax(peak)
        return last

    return add_dilatation_changes


add_dilatations_linear = _linear_sweep(failing=False, weighted=False)
add_dilatations_linear_failing = _linear_sweep(failing=True, weighted=False)
add_dilatations_linear_weighted = _linear_sweep(failing=False, weighted=True)
add_dilatations_series = _finite_sweep(closed=False, failing=False, weighted=False)
add_dilatations_closed = _finite_sweep(closed=True, failing=False, weighted=False)
add_dilatations_series_failing = _finite_sweep(closed=False, failing=True, weighted=False)
add_dilatations_closed_failing = _finite_sweep(closed=True, failing=True, weighted=False)
add_dilatations_series_weighted = _finite_sweep(closed=False, failing=False, weighted=True)
add_dilatations_closed_weighted = _finite_sweep(closed=True, failing=False, weighted=True)
add_dilatation_changes_series = _changes(closed=False, weighted=False)
add_dilatation_changes_closed = _changes(closed=True, weighted=False)
add_dilatation_changes_series_weighted = _changes(closed=False, weighted=True)
add_dilatation_changes_closed_weighted = _changes(closed=True, weighted=True)
#: By (finite, series, failing, weighted): bonds with fitted weights do not break.
SWEEPS = {
    (True, True, False, False): add_dilatations_series,
    (True, False, False, False): add_dilatations_closed,
    (True, True, True, False): add_dilatations_series_failing,
    (True, False, True, False): add_dilatations_closed_failing,
    (False, False, False, False): add_dilatations_linear,
    (False, False, True, False): add_dilatations_linear_failing,
    (True, True, False, True): add_dilatations_series_weighted,
    (True, False, False, True): add_dilatations_closed_weighted,
    (False, False, False, True): add_dilatations_linear_weighted,
}
#: Of the change, by (series, weighted).
CHANGES = {
    (True, False): add_dilatation_changes_series,
    (False, False): add_dilatation_changes_closed,
    (True, True): add_dilatation_changes_series_weighted,
    (False, True): add_dilatation_changes_closed_weighted,
}

_f8, _i8, _int = types.float64[::1], types.int64[::1], types.int64
_table = types.float64[:, ::1]
_rows = (_i8, types.uint32[::1], types.float32[::1])
_failing = (types.uint8[::1], _f8, _table, types.int64[:, ::1], types.float32[:, ::1], _i8)
_weights = types.float32[::1]
_linear = _int(_int, _int, *_rows, _f8, _f8, _i8, types.float64, _weights, _f8, *_failing)
_finite = _int(_int, _int, *_rows, _f8, _f8, _i8, _f8, _weights, _f8, *_failing)
_change = _int(_int, _int, *_rows, _f8, _f8, _i8, _f8, _weights, _f8)
SIGNATURES = {sweep: _finite if finite else _linear for (finite, _, _, _), sweep in SWEEPS.items()}
SIGNATURES |= dict.fromkeys(CHANGES.values(), _change)
