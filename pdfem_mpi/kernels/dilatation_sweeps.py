"""Dilatation of the peridynamic points, the first of two sweeps where Poisson's ratio is not 1/4.

The volumetric part of the energy is ``1/2 sum_i M_i w_i theta_i^2`` with ``w_i theta_i = sum_j A_ij e_ij``, ``e_ij``
the extension of a bond and ``A_ij = k_ij / (10 mu_ij)``, ``k_ij = c exp(-r0^2) g_ij w_i w_j``
(`peridynamics.volumetric`). The sweeps here add ``k_ij e_ij`` to both points of every bond, from the numbers that
bonds store anyway::

    linear          k e = K' r0^2 (eta . xi)
    finite          k e = 2 K (eta . d) / (1 + (1 + e)^(1/2))

``e`` in the last is the number of `bond_sweeps`; rows go abreast as there. Terms are rounded to multiples of a quantum
and added as integers, as forces are: the sums have the same bits in any order.

Bonds break here, before the forces are swept: a broken bond has no part in the dilatation of its points any more, and
what it gave is taken back exactly.
"""

import numpy as np
from numba import njit, types

from pdfem_mpi.kernels.abreast import (
    ROWS,
    add_to,
    for_all,
    for_first,
    held,
    numbers,
    of_first,
    places_of,
    points_of,
    spread,
    two_numbers,
)
from pdfem_mpi.kernels.bond_response import (
    STEP,
    V1,
    V5,
    V6,
    ZERO,
    ask_ahead,
    first_numbers,
    first_three,
    record_broken,
    three,
    u8,
    work_of,
)
from pdfem_mpi.kernels.bond_response import constants as response_constants
from pdfem_mpi.kernels.simd import (
    W,
    above,
    both,
    fma,
    fnma,
    hmax,
    hmin,
    iadd,
    ihsum,
    isub,
    lanes,
    largest,
    magnitude,
    root,
    smallest,
    splat,
)

#: Coefficients of ``1 / (1 + (1 + e)^(1/2)) = 1/2 - 1/8 e + ...``
SERIES = (1 / 2, -1 / 8, 1 / 16, -5 / 128, 7 / 256)
_A0, _A1, _A2, _A3, _A4 = (u8(W * k) for k in range(8, 13))

_options = {"cache": True, "nogil": True, "boundscheck": False, "error_model": "numpy"}


def constants(pattern):
    """What the sweeps of finite kinematics read: `bond_response.constants`, then the coefficients of ``SERIES``.

    Returns
    -------
    float64, shape (52,)
    """
    return np.concatenate([response_constants(pattern), np.repeat(np.array(SERIES), W)])


@njit(inline="always")
def _lengthening_numbers(rows, table):
    """Coefficients of ``SERIES``, one and nought, in registers."""
    return (
        held(rows, table[_A0]),
        held(rows, table[_A1]),
        held(rows, table[_A2]),
        held(rows, table[_A3]),
        held(rows, table[_A4]),
        held(rows, table[V6]),
        spread(rows, 0.0),
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
    return one / (one + root(largest(one + e, numbers[6])))


@njit(inline="always")
def _rounded(rows, f, h, weights, r, M, weighted):
    """Bit patterns of ``f h``, or of its parts by the fitted weights, for the rows' point and for the others."""
    if weighted:
        here, there = two_numbers(rows, weights, r * STEP)
        f = f * h
        return fma(f, here, M), fma(f, there, M)
    p = fma(f, h, M)
    return p, p


@njit(inline="always")
def _pulled(rows, row_data, r, S, b, u, z):
    """``K'``, ``K' (eta . xi)`` and ``r0^2`` of the slots of rows from ``r`` on."""
    k = numbers(rows, row_data, r * V1)
    work, _, xi = work_of(S, b, u, z)
    return k, work * k, fma(xi[0], xi[0], fma(xi[1], xi[1], xi[2] * xi[2]))


@njit(inline="always")
def _stretched(rows, row_data, r, S, b, u, z):
    """``2 K (eta . d)`` and ``e`` of the slots of rows from ``r`` on."""
    k, inverse_square = two_numbers(rows, row_data, r * STEP)
    work, _, _ = work_of(S, b, u, z)
    return (k + k) * work, work * inverse_square


@njit(inline="always")
def _break_pulled(
    i, start, end, row_offset, row_data, S, D, DI, u, z, M, class_of, critical, pairs, strengths, count
):  # fmt: skip
    """Visit the rows of a point again, break the bonds beyond their critical stretch; return the number of records."""
    for row in range(start, end):
        b = places_of(1, row_offset, row)
        k, f, square = _pulled(1, row_data, row, S, b, u, z)
        other = b[0] // u8(9 * W)
        broken = above(fnma(splat(critical[class_of[i // W], class_of[other]]), k * square, f), splat(0.0))
        if lanes(broken) == 0:
            continue
        p = isub(M, fma(both(f, broken), square, M))
        DI[i] += ihsum(p)
        add_to(D, points_of(b), ZERO, p)
        count = record_broken(1, i, other, broken, row * V1, row_data, pairs, strengths, count)
    return count


@njit(inline="always")
def _break_stretched(
    i, start, end, row_offset, row_data, S, D, DI, u, z, lengthening, M, closed,
    class_of, critical, pairs, strengths, count,
):  # fmt: skip
    """Visit the rows of a point again; as `_break_pulled`, with the largest ``e`` of intact bonds besides."""
    top = splat(0.0)
    for row in range(start, end):
        b = places_of(1, row_offset, row)
        f, e = _stretched(1, row_data, row, S, b, u, z)
        other = b[0] // u8(9 * W)
        broken = above(e, splat(critical[class_of[i // W], class_of[other]]))
        if lanes(broken) == 0:
            top = largest(e, top)
            continue
        h = lengthening_in_closed_form(e, lengthening) if closed else lengthening_by_series(e, lengthening)
        p = isub(M, fma(both(f, broken), h, M))
        DI[i] += ihsum(p)
        add_to(D, points_of(b), ZERO, p)
        top = largest(isub(e, both(e, broken)), top)  # e of the intact lanes, 0 on the broken
        count = record_broken(2, i, other, broken, row * STEP, row_data, pairs, strengths, count)
    return top, count


def linear_sweep(failing, weighted, rows=ROWS):
    """Build the sweep of linear kinematics, with or without failure and fitted weights, for ``rows`` abreast."""
    step, rest = u8(rows), u8(rows - 1)  # all are constants to the compiler

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
        zero = spread(rows, 0.0)
        M = spread(rows, pattern)
        peak = spread(rows, extremes[0])
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
            u, z = three(rows, S, own), three(rows, S, own + 3 * W)
            total = zero
            stop = end - ((end - r) & rest)
            limit = spread(rows, trigger[class_of[c]]) if failing else zero
            excess = zero
            while r < stop:
                b = places_of(rows, row_offset, r)
                ask_ahead(row_offset, row_data, r, r * V1)
                k, f, square = _pulled(rows, row_data, r, S, b, u, z)
                peak = largest(magnitude(f), peak)
                if failing:
                    excess = largest(fnma(limit, k * square, f), excess)
                own_part, p = _rounded(rows, f, square, weights, r, M, weighted)
                total = iadd(total, own_part)
                add_to(D, points_of(b), ZERO, p)
                r += step
            if rows > 1 and r < end:  # a row is left
                b1 = places_of(1, row_offset, r)
                k1, f1, square1 = _pulled(1, row_data, r, S, b1, first_three(u), first_three(z))
                peak = largest(for_all(rows, magnitude(f1)), peak)
                if failing:
                    excess = largest(for_all(rows, fnma(of_first(limit), k1 * square1, f1)), excess)
                own_part1, p1 = _rounded(1, f1, square1, weights, r, of_first(M), weighted)
                total = iadd(total, for_first(rows, own_part1))
                add_to(D, points_of(b1), ZERO, p1)
            DI[i] += ihsum(total)
            if failing and lanes(above(excess, zero)) != 0:  # rare: some bond may have passed its critical stretch
                count = _break_pulled(
                    i, u8(row_start[i]), end, row_offset, row_data, S, D, DI, first_three(u), first_three(z),
                    of_first(M), class_of, critical, pairs, strengths, count,
                )  # fmt: skip
        extremes[0] = hmax(peak)
        counter[0] = count
        return after

    return add_dilatations


def finite_sweep(closed, failing, weighted, rows=ROWS):
    """Build the sweep of finite kinematics, in closed form or as a series, with or without failure and weights."""
    step, rest = u8(rows), u8(rows - 1)

    @njit(**_options)
    def add_dilatations(
        first, last, row_start, row_offset, row_data, S, D, DI, table, weights, extremes,
        class_of, trigger, critical, pairs, strengths, counter,
    ):  # fmt: skip
        """Add ``k e`` of the bonds of the rows of points ``first:last`` to both of their points.

        Parameters and result are those of the linear sweep, with ``table`` from `constants` in place of the pattern,
        limits of ``e``, and ``extremes`` the largest and smallest ``e`` of intact bonds.
        """
        zero = spread(rows, 0.0)
        lengthening = _lengthening_numbers(rows, table)
        M = held(rows, table[V5])
        peak, floor = spread(rows, extremes[0]), spread(rows, extremes[1])
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
            u, z = three(rows, S, own), three(rows, S, own + 3 * W)
            total = zero
            stop = end - ((end - r) & rest)
            top = zero
            while r < stop:
                b = places_of(rows, row_offset, r)
                ask_ahead(row_offset, row_data, r, r * STEP)
                f, e = _stretched(rows, row_data, r, S, b, u, z)
                top = largest(e, top)
                floor = smallest(e, floor)
                h = lengthening_in_closed_form(e, lengthening) if closed else lengthening_by_series(e, lengthening)
                own_part, p = _rounded(rows, f, h, weights, r, M, weighted)
                total = iadd(total, own_part)
                add_to(D, points_of(b), ZERO, p)
                r += step
            first_ones = first_numbers(lengthening)
            if rows > 1 and r < end:  # a row is left
                b1 = places_of(1, row_offset, r)
                f1, e1 = _stretched(1, row_data, r, S, b1, first_three(u), first_three(z))
                top = largest(for_all(rows, e1), top)
                floor = smallest(for_all(rows, e1), floor)
                h1 = lengthening_in_closed_form(e1, first_ones) if closed else lengthening_by_series(e1, first_ones)
                own_part1, p1 = _rounded(1, f1, h1, weights, r, of_first(M), weighted)
                total = iadd(total, for_first(rows, own_part1))
                add_to(D, points_of(b1), ZERO, p1)
            DI[i] += ihsum(total)
            if failing and lanes(above(top, spread(rows, trigger[class_of[c]]))) != 0:  # rare
                top1, count = _break_stretched(
                    i, u8(row_start[i]), end, row_offset, row_data, S, D, DI, first_three(u), first_three(z),
                    first_ones, of_first(M), closed, class_of, critical, pairs, strengths, count,
                )  # fmt: skip
                top = for_all(rows, top1)
            peak = largest(top, peak)
        extremes[0] = hmax(peak)
        extremes[1] = hmin(floor)
        counter[0] = count
        return after

    return add_dilatations


add_dilatations_linear = linear_sweep(failing=False, weighted=False)
add_dilatations_linear_failing = linear_sweep(failing=True, weighted=False)
add_dilatations_linear_weighted = linear_sweep(failing=False, weighted=True)
add_dilatations_series = finite_sweep(closed=False, failing=False, weighted=False)
add_dilatations_closed = finite_sweep(closed=True, failing=False, weighted=False, rows=1)
add_dilatations_series_failing = finite_sweep(closed=False, failing=True, weighted=False)
add_dilatations_closed_failing = finite_sweep(closed=True, failing=True, weighted=False, rows=1)
add_dilatations_series_weighted = finite_sweep(closed=False, failing=False, weighted=True)
add_dilatations_closed_weighted = finite_sweep(closed=True, failing=False, weighted=True, rows=1)
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

_f8, _i8, _int = types.float64[::1], types.int64[::1], types.int64
_table = types.float64[:, ::1]
_rows = (_i8, types.uint32[::1], types.float32[::1])
_failing = (types.uint8[::1], _f8, _table, types.int64[:, ::1], types.float32[:, ::1], _i8)
_weights = types.float32[::1]
_linear = _int(_int, _int, *_rows, _f8, _f8, _i8, types.float64, _weights, _f8, *_failing)
_finite = _int(_int, _int, *_rows, _f8, _f8, _i8, _f8, _weights, _f8, *_failing)
SIGNATURES = {sweep: _finite if finite else _linear for (finite, _, _, _), sweep in SWEEPS.items()}
