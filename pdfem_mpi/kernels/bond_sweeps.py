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

**Rows abreast.** Where the processor has AVX-512, two consecutive rows of a point are swept side by side in eight
lanes, a last odd one in four (`abreast`); elsewhere all are swept one by one, and so they are in closed form, which
waits for the division. Sums are exact in any order, so that forces have the same bits either way, and so have extremes,
records and stored numbers.

**Sums.** Each component ``p`` of a bond's force is rounded once to a multiple of the quantum ``q`` by ``fma(f, d, M)``,
``M = 1.5 * 2**52 q``, and the bit patterns are added as integers: exact, in any order, while ``|p| < 2**51 q``
for each single bond (integers wrap harmlessly in between). The rounding error of a point's force is at most
``q / 2`` a bond and ``q <= 2**-49`` of the largest bond force admitted by the bound; taking back a force is exact.
"""

from numba import njit, types

from pdfem_mpi.kernels.abreast import ROWS, add_to, for_all, held, numbers, of_first, places_of, spread, two_numbers
from pdfem_mpi.kernels.bond_response import (
    STEP,
    V1,
    V5,
    V6,
    V7,
    V8,
    add_own,
    added,
    added_first,
    ask_ahead,
    first_numbers,
    first_three,
    numbers_of,
    record_broken,
    response_by_series,
    response_in_closed_form,
    rounded,
    take_forces,
    three,
    u8,
    work_of,
)
from pdfem_mpi.kernels.simd import (
    W,
    above,
    both,
    fma,
    fnma,
    hmax,
    hmin,
    ihsum,
    isub,
    lanes,
    largest,
    magnitude,
    smallest,
    splat,
)

_options = {"cache": True, "nogil": True, "boundscheck": False, "error_model": "numpy"}


@njit(inline="always")
def _stretched(rows, row_data, r, S, b, u, z):
    """``K``, ``e`` and ``d + eta`` of the slots of rows from ``r`` on."""
    k, inverse_square = two_numbers(rows, row_data, r * STEP)
    work, eta, d = work_of(S, b, u, z)
    return k, work * inverse_square, (d[0] + eta[0], d[1] + eta[1], d[2] + eta[2])


@njit(inline="always")
def _give_back(S, SI, b, own, p):
    """Give the forces ``p`` of bonds back to their clusters, and take them from their common point."""
    add_to(S, b, V6, p[0])
    add_to(S, b, V7, p[1])
    add_to(S, b, V8, p[2])
    SI[own + 6 * W] -= ihsum(p[0])
    SI[own + 7 * W] -= ihsum(p[1])
    SI[own + 8 * W] -= ihsum(p[2])


@njit(inline="always")
def _break_stretched(
    i, own, start, end, row_offset, row_data, S, SI, u, z, response, M, closed,
    class_of, critical, pairs, strengths, count,
):  # fmt: skip
    """Visit the rows of a point again, one by one, and break the bonds beyond their critical stretch.

    Returns
    -------
    tuple
        Largest ``e`` of intact bonds, 0 on others, in four lanes; number of records.
    """
    top = splat(0.0)
    for row in range(start, end):
        b = places_of(1, row_offset, row)
        k, e, y = _stretched(1, row_data, row, S, b, u, z)
        other = b[0] // u8(9 * W)
        broken = above(e, splat(critical[class_of[i // W], class_of[other]]))
        if lanes(broken) == 0:
            top = largest(e, top)
            continue
        f = response_in_closed_form(k, e, response) if closed else response_by_series(k, e, response)
        p = rounded(both(f, broken), y, M)
        _give_back(S, SI, b, own, (isub(p[0], M), isub(p[1], M), isub(p[2], M)))
        top = largest(isub(e, both(e, broken)), top)
        count = record_broken(2, i, other, broken, row * STEP, row_data, pairs, strengths, count)
    return top, count


def finite_sweep(closed, failing, rows=ROWS):
    """Build the sweep with ``phi`` in closed form or as a series, with or without failure, for ``rows`` abreast.

    The three are constants to the compiler (a compiled function as a free variable could not be cached).
    """
    step, rest = u8(rows), u8(rows - 1)

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
        zero = spread(rows, 0.0)
        response = numbers_of(rows, table)
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
            sums = zero, zero, zero
            top = zero
            stop = end - ((end - r) & rest)
            if r < stop:
                # e of the first rows; later the e of the next ones is computed while these rows' forces are scattered
                b = places_of(rows, row_offset, r)
                k, e, y = _stretched(rows, row_data, r, S, b, u, z)
                while r < stop:
                    q = r + step  # past the last row this reads harmless numbers, hence one padding row
                    if rows > 1:
                        q = q if q < stop else r
                    ask_ahead(row_offset, row_data, q, q * STEP)
                    b_next = places_of(rows, row_offset, q)
                    k_next, e_next, y_next = _stretched(rows, row_data, q, S, b_next, u, z)
                    top = largest(e, top)
                    floor = smallest(e, floor)
                    if rows == 1:
                        k = numbers(rows, row_data, r * STEP)  # read late it takes no register
                    f = response_in_closed_form(k, e, response) if closed else response_by_series(k, e, response)
                    p = rounded(f, y, M)
                    sums = added(sums, p)
                    take_forces(S, b, p)
                    k, e, y, b = k_next, e_next, y_next, b_next
                    r += step
            if rows > 1 and r < end:  # a row is left
                b1 = places_of(1, row_offset, r)
                k1, e1, y1 = _stretched(1, row_data, r, S, b1, first_three(u), first_three(z))
                top = largest(for_all(rows, e1), top)
                floor = smallest(for_all(rows, e1), floor)
                numbers1 = first_numbers(response)
                f1 = response_in_closed_form(k1, e1, numbers1) if closed else response_by_series(k1, e1, numbers1)
                p1 = rounded(f1, y1, of_first(M))
                sums = added_first(rows, sums, p1)
                take_forces(S, b1, p1)
            add_own(SI, own, sums)
            if failing and lanes(above(top, spread(rows, trigger[class_of[c]]))) != 0:
                # rare: some bond of this point may have passed its critical stretch
                top1, count = _break_stretched(
                    i, own, u8(row_start[i]), end, row_offset, row_data, S, SI, first_three(u), first_three(z),
                    first_numbers(response), of_first(M), closed, class_of, critical, pairs, strengths, count,
                )  # fmt: skip
                top = for_all(rows, top1)
            peak = largest(top, peak)
        extremes[0] = hmax(peak)
        extremes[1] = hmin(floor)
        counter[0] = count
        return after

    return add_bond_forces


add_forces_series = finite_sweep(closed=False, failing=False)
add_forces_closed = finite_sweep(closed=True, failing=False, rows=1)
add_forces_series_failing = finite_sweep(closed=False, failing=True)
add_forces_closed_failing = finite_sweep(closed=True, failing=True, rows=1)


@njit(inline="always")
def _pulled(rows, row_data, r, S, b, u, z):
    """``K'``, ``K' (eta . xi)`` and ``xi`` of the slots of rows from ``r`` on."""
    k = numbers(rows, row_data, r * V1)
    work, _, xi = work_of(S, b, u, z)
    return k, work * k, xi


@njit(inline="always")
def _excess(limit, k, f, xi):
    """By how much ``K' (eta . xi)`` is above that of the critical stretch."""
    return fnma(limit, k * fma(xi[0], xi[0], fma(xi[1], xi[1], xi[2] * xi[2])), f)


@njit(inline="always")
def _break_pulled(
    i, own, start, end, row_offset, row_data, S, SI, u, z, M, class_of, critical, pairs, strengths, count
):  # fmt: skip
    """Visit the rows of a point again, one by one, and break the bonds beyond their critical stretch.

    Returns
    -------
    int
        Number of records.
    """
    for row in range(start, end):
        b = places_of(1, row_offset, row)
        k, f, xi = _pulled(1, row_data, row, S, b, u, z)
        other = b[0] // u8(9 * W)
        limit = splat(critical[class_of[i // W], class_of[other]])
        broken = above(_excess(limit, k, f, xi), splat(0.0))
        if lanes(broken) == 0:
            continue
        p = rounded(both(f, broken), xi, M)
        _give_back(S, SI, b, own, (isub(p[0], M), isub(p[1], M), isub(p[2], M)))
        count = record_broken(1, i, other, broken, row * V1, row_data, pairs, strengths, count)
    return count


def linear_sweep(failing, rows=ROWS):
    """Build the linear sweep, with or without failure, for ``rows`` abreast, constants to the compiler."""
    step, rest = u8(rows), u8(rows - 1)

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
        zero = spread(rows, 0.0)
        M = held(rows, table[V5])
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
            sums = zero, zero, zero
            limit = spread(rows, trigger[class_of[c]]) if failing else zero
            excess = zero
            stop = end - ((end - r) & rest)
            if r < stop:
                b = places_of(rows, row_offset, r)
                k, f, xi = _pulled(rows, row_data, r, S, b, u, z)
                while r < stop:
                    q = r + step  # past the last row this reads harmless numbers, hence one padding row
                    if rows > 1:
                        q = q if q < stop else r
                    b_next = places_of(rows, row_offset, q)
                    ask_ahead(row_offset, row_data, q, q * V1)
                    k_next, f_next, xi_next = _pulled(rows, row_data, q, S, b_next, u, z)
                    peak = largest(magnitude(f), peak)
                    if failing:
                        excess = largest(_excess(limit, k, f, xi), excess)
                    p = rounded(f, xi, M)
                    sums = added(sums, p)
                    take_forces(S, b, p)
                    k, f, xi, b = k_next, f_next, xi_next, b_next
                    r += step
            if rows > 1 and r < end:  # a row is left
                b1 = places_of(1, row_offset, r)
                k1, f1, xi1 = _pulled(1, row_data, r, S, b1, first_three(u), first_three(z))
                peak = largest(for_all(rows, magnitude(f1)), peak)
                if failing:
                    excess = largest(for_all(rows, _excess(of_first(limit), k1, f1, xi1)), excess)
                p1 = rounded(f1, xi1, of_first(M))
                sums = added_first(rows, sums, p1)
                take_forces(S, b1, p1)
            add_own(SI, own, sums)
            if failing and lanes(above(excess, zero)) != 0:
                # rare: some bond of this point may have passed its critical stretch
                count = _break_pulled(
                    i, own, u8(row_start[i]), end, row_offset, row_data, S, SI, first_three(u), first_three(z),
                    of_first(M), class_of, critical, pairs, strengths, count,
                )  # fmt: skip
        extremes[0] = hmax(peak)
        counter[0] = count
        return after

    return add_bond_forces


add_forces_linear = linear_sweep(failing=False)
add_forces_linear_failing = linear_sweep(failing=True)
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
