"""The response of a stretched bond (2), for the sweeps of forces and of their tangent, and the rows of their table.

``phi = 1 - (1 + e)^(-1/2)`` with ``e`` of eq. (3) is summed as a series while ``|e| <= SERIES_LIMIT`` on every bond of
every rank; its relative error is about ``0.45 |e|^5``, 1.3e-8 at the limit, 1e-14 at a stretch of 1e-3. Beyond, it is
``e / ((1 + e) + sqrt(1 + e))``. The functions are inlined into the sweeps.
"""

import numpy as np
from numba import njit

from pdfem_mpi.kernels.abreast import for_first, gather, held, of_first, spread, take_from
from pdfem_mpi.kernels.simd import W, fma, iadd, ihsum, lanes, largest, prefetch, root

#: Coefficients of ``phi / e = 1/2 - 3/8 e + ...``
SERIES = (1 / 2, -3 / 8, 5 / 16, -35 / 128, 63 / 256)
#: Largest ``|e|`` for which the series is used.
SERIES_LIMIT = 2.0**-5
#: ``1 + e`` of a bond compressed to nothing is held at this value (a thousandth of its length).
SMALLEST_SQUARE = 1e-6

u8 = np.uint64
#: Places of a cluster's rows in the table, in numbers, and of the slots of a row in its data.
ZERO, ONE, STEP = u8(0), u8(1), u8(2 * W)
V1, V2, V3, V4, V5, V6, V7, V8 = (u8(W * k) for k in range(1, 9))
#: How far ahead of a row, in numbers, the sweeps ask for the rows behind it: the hardware does not keep that stream
#: ahead of them. Between 1 and 8 kB it makes little difference.
AHEAD = 768


def constants(pattern):
    """Numbers the sweeps read as full vectors: five coefficients, ``M``, 1 and the smallest square.

    Parameters
    ----------
    pattern : float
        ``M = 1.5 * 2**52 * quantum``.

    Returns
    -------
    float64, shape (32,)
    """
    return np.repeat(np.array((*SERIES, pattern, 1.0, SMALLEST_SQUARE)), W)


@njit(inline="always")
def ask_ahead(row_offset, row_data, r, o):
    """Ask for the numbers of rows some way behind row ``r``, whose own begin at ``o``."""
    prefetch(row_data, o + u8(AHEAD))
    prefetch(row_offset, r + u8(AHEAD // W))


@njit(inline="always")
def numbers_of(rows, table):
    """The table's numbers but for ``M``, in registers: read in the loop, each would take the time of a load."""
    return (
        held(rows, table[ZERO]),
        held(rows, table[V1]),
        held(rows, table[V2]),
        held(rows, table[V3]),
        held(rows, table[V4]),
        held(rows, table[V6]),
        held(rows, table[V7]),
    )


@njit(inline="always")
def first_numbers(numbers):
    """`numbers_of` the table for one row."""
    a, b, c, d, e, f, g = numbers
    return of_first(a), of_first(b), of_first(c), of_first(d), of_first(e), of_first(f), of_first(g)


@njit(inline="always")
def three(rows, S, own):
    """Three components of a point, from ``own`` on in the table, in all lanes."""
    return spread(rows, S[own]), spread(rows, S[own + W]), spread(rows, S[own + 2 * W])


@njit(inline="always")
def first_three(v):
    """Three components for one row."""
    return of_first(v[0]), of_first(v[1]), of_first(v[2])


@njit(inline="always")
def work_of(S, b, u, z):
    """``eta . d`` of the slots of rows, ``eta`` and ``d``; ``u`` and ``z`` are `three` of the rows' point."""
    dx = gather(S, b, ZERO) - u[0]
    gx = gather(S, b, V3) - z[0]
    dy = gather(S, b, V1) - u[1]
    gy = gather(S, b, V4) - z[1]
    dz = gather(S, b, V2) - u[2]
    gz = gather(S, b, V5) - z[2]
    return fma(dx, gx, fma(dy, gy, dz * gz)), (dx, dy, dz), (gx, gy, gz)


@njit(inline="always")
def rounded(f, d, M):
    """Bit patterns of ``f d``, rounded to multiples of the quantum."""
    return fma(f, d[0], M), fma(f, d[1], M), fma(f, d[2], M)


@njit(inline="always")
def added(sums, p):
    """Sums of bit patterns and one more of each."""
    return iadd(sums[0], p[0]), iadd(sums[1], p[1]), iadd(sums[2], p[2])


@njit(inline="always")
def added_first(rows, sums, p):
    """Sums of bit patterns of all rows and one more of each of the first."""
    return added(sums, (for_first(rows, p[0]), for_first(rows, p[1]), for_first(rows, p[2])))


@njit(inline="always")
def add_own(SI, own, sums):
    """Add the sums over the lanes to the force of the rows' point."""
    SI[own + 6 * W] += ihsum(sums[0])
    SI[own + 7 * W] += ihsum(sums[1])
    SI[own + 8 * W] += ihsum(sums[2])


@njit(inline="always")
def take_forces(S, b, p):
    """Take the forces of the slots of rows from their clusters."""
    take_from(S, b, V6, p[0])
    take_from(S, b, V7, p[1])
    take_from(S, b, V8, p[2])


@njit(inline="always")
def record_broken(per_slot, i, other, broken, o, row_data, pairs, strengths, count):
    """Record the broken bonds of a row, and set their numbers to 0.

    Parameters
    ----------
    per_slot : 1 or 2
        Numbers that a slot has.
    i, other : int
        Point and cluster of the row.
    broken : vector
        Bits set in the lanes of broken bonds.
    o : uint64
        Where the numbers of the row stand.

    Returns
    -------
    int
        Number of records.
    """
    for lane in range(W):
        if (lanes(broken) >> lane) & 1 and row_data[o + u8(lane)] != 0:
            pairs[count, 0] = i
            pairs[count, 1] = np.int64(other) * W + lane
            strengths[count, 0] = row_data[o + u8(lane)]
            row_data[o + u8(lane)] = 0
            if per_slot == 2:
                strengths[count, 1] = row_data[o + u8(W + lane)]
                row_data[o + u8(W + lane)] = 0
            count += 1
    return count


@njit(inline="always")
def response_by_series(k, e, numbers):
    """``K phi(e)`` by its series, with `numbers_of` the table; ``K e`` is formed while the series is summed."""
    e2 = e * e
    high = fma(e2, numbers[4], fma(numbers[3], e, numbers[2]))
    return (k * e) * fma(e2, high, fma(numbers[1], e, numbers[0]))


@njit(inline="always")
def response_in_closed_form(k, e, numbers):
    """``K phi(e)`` in closed form, for large stretch and compression."""
    square = largest(numbers[5] + e, numbers[6])
    return k * ((square - numbers[5]) / (square + root(square)))
