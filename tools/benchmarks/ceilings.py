"""Ceilings of the machine, and a sweep with plain sums: what `tools/benchmarks/bench` compares kernels with.

Nothing here is used by a simulation.
"""

from numba import config, njit, types

from pdfem_mpi.kernels.bond_response import (
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
    u8,
)  # fmt: skip
from pdfem_mpi.kernels.simd import W, above, fma, fnma, hsum, lanes, largest, load, splat, store

_options = {"cache": True, "nogil": True, "boundscheck": False, "error_model": "numpy"}
#: Fused multiply-adds a turn of the loop of `multiply_add`: 12 independent chains hide their latency.
CHAINS = 12


@njit(**_options)
def read_stream(a, passes):
    """Sum of an array, read from end to end ``passes`` times.

    Parameters
    ----------
    a : float64, shape (n,)
        ``n`` a multiple of 32.

    Returns
    -------
    float
    """
    s0 = s1 = s2 = s3 = s4 = s5 = s6 = s7 = splat(0.0)
    for _ in range(passes):
        for k in range(0, a.size, 8 * W):
            s0 = s0 + load(a, k)
            s1 = s1 + load(a, k + W)
            s2 = s2 + load(a, k + 2 * W)
            s3 = s3 + load(a, k + 3 * W)
            s4 = s4 + load(a, k + 4 * W)
            s5 = s5 + load(a, k + 5 * W)
            s6 = s6 + load(a, k + 6 * W)
            s7 = s7 + load(a, k + 7 * W)
    return hsum((s0 + s1) + (s2 + s3) + ((s4 + s5) + (s6 + s7)))


@njit(**_options)
def triad(a, b, c, factor):
    """``a = b + factor c``: two numbers read and one written.

    Parameters
    ----------
    a, b, c : float64, shape (n,)
        ``n`` a multiple of 4; ``a`` is overwritten.
    factor : float
    """
    s = splat(factor)
    for k in range(0, a.size, W):
        store(a, k, fma(s, load(c, k), load(b, k)))


@njit(**_options)
def multiply_add(turns, x):
    """``turns * CHAINS`` fused multiply-adds of four numbers, 8 floating-point operations each.

    Parameters
    ----------
    turns : int
    x : float64, shape (2,)
        Factor and addend, so that the compiler knows neither.

    Returns
    -------
    float
    """
    a, b = splat(x[0]), splat(x[1])
    s0 = s1 = s2 = s3 = s4 = s5 = s6 = s7 = s8 = s9 = t0 = t1 = b
    for _ in range(turns):
        s0, s1, s2, s3 = fma(s0, a, b), fma(s1, a, b), fma(s2, a, b), fma(s3, a, b)
        s4, s5, s6, s7 = fma(s4, a, b), fma(s5, a, b), fma(s6, a, b), fma(s7, a, b)
        s8, s9, t0, t1 = fma(s8, a, b), fma(s9, a, b), fma(t0, a, b), fma(t1, a, b)
    return hsum((s0 + s1) + (s2 + s3) + ((s4 + s5) + (s6 + s7)) + ((s8 + s9) + (t0 + t1)))


@njit(**_options)
def gather(table, index):
    """Sum of three consecutive numbers at each of many places: the access of a bond list without clusters.

    Parameters
    ----------
    table : float64, shape (n,)
    index : uint32, shape (m,)
        Places, at most ``n - 3``.

    Returns
    -------
    float
    """
    x = y = z = 0.0
    for k in range(index.size):
        i = u8(index[k])
        x += table[i]
        y += table[i + u8(1)]
        z += table[i + u8(2)]
    return x + y + z


@njit(**_options)
def add_forces_plain_sums(first, last, row_start, row_offset, row_data, S, table, limit):
    """The row loop of `peridynamics.add_forces_series_failing` with plain float sums, whose bits depend on their order.

    Parameters are those of the sweep, without the integer view, and without the extremes of ``e`` that the quanta need.
    Bonds with ``e`` beyond the limit are noticed, not broken.

    Returns
    -------
    int
        Points with a bond beyond the limit.
    """
    zero = splat(0.0)
    numbers = numbers_of(1, table)
    count = 0
    for i in range(first, last):
        r, end = u8(row_start[i]), u8(row_start[i + 1])
        if end <= r:
            continue
        c = i // W
        own = c * 9 * W + (i - c * W)
        ux, uy, uz = splat(S[own]), splat(S[own + W]), splat(S[own + 2 * W])
        zx, zy, zz = splat(S[own + 3 * W]), splat(S[own + 4 * W]), splat(S[own + 5 * W])
        fx = fy = fz = top = zero
        b, o = u8(row_offset[r]), r * u8(2 * W)
        dx, gx = load(S, b) - ux, load(S, b + V3) - zx
        dy, gy = load(S, b + V1) - uy, load(S, b + V4) - zy
        dz, gz = load(S, b + V2) - uz, load(S, b + V5) - zz
        e = fma(dx, gx, fma(dy, gy, dz * gz)) * load(row_data, o + V1)
        gx, gy, gz = gx + dx, gy + dy, gz + dz
        while r < end:
            r += u8(1)
            b_next, o_next = u8(row_offset[r]), o + u8(2 * W)
            ask_ahead(row_offset, row_data, r, o_next)
            dx, hx = load(S, b_next) - ux, load(S, b_next + V3) - zx
            dy, hy = load(S, b_next + V1) - uy, load(S, b_next + V4) - zy
            dz, hz = load(S, b_next + V2) - uz, load(S, b_next + V5) - zz
            e_next = fma(dx, hx, fma(dy, hy, dz * hz)) * load(row_data, o_next + V1)
            hx, hy, hz = hx + dx, hy + dy, hz + dz
            top = largest(e, top)
            f = response_by_series(load(row_data, o), e, numbers)
            fx, fy, fz = fma(f, gx, fx), fma(f, gy, fy), fma(f, gz, fz)
            store(S, b + V6, fnma(f, gx, load(S, b + V6)))
            store(S, b + V7, fnma(f, gy, load(S, b + V7)))
            store(S, b + V8, fnma(f, gz, load(S, b + V8)))
            e, gx, gy, gz, b, o = e_next, hx, hy, hz, b_next, o_next
        if lanes(above(top, splat(limit))) != 0:
            count += 1
        S[own + 6 * W] += hsum(fx)
        S[own + 7 * W] += hsum(fy)
        S[own + 8 * W] += hsum(fz)
    return count


_f8, _int, _real = types.float64[::1], types.int64, types.float64
SIGNATURES = {
    read_stream: _real(_f8, _int),
    triad: types.void(_f8, _f8, _f8, _real),
    multiply_add: _real(_int, _f8),
    gather: _real(_f8, types.uint32[::1]),
    add_forces_plain_sums: _int(_int, _int, types.int64[::1], types.uint32[::1], types.float32[::1], _f8, _f8, _real),
}


def compile_kernels() -> None:
    """Compile all of them for the one signature each is called with, or load them from the cache."""
    if not config.DISABLE_JIT:
        for kernel, signature in SIGNATURES.items():
            kernel.compile(tuple(signature.args))
