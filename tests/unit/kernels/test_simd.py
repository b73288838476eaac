"""Lanes of four: every operation against numpy, compiled and with NUMBA_DISABLE_JIT."""

import numba
import numpy as np
import pytest
from numba import njit

from pdfem_mpi.kernels import simd
from pdfem_mpi.kernels.simd import (
    PATTERN,
    W,
    above,
    bits,
    both,
    either,
    fma,
    fnma,
    from_bits,
    held,
    hmax,
    hmin,
    hsum,
    iadd,
    ihsum,
    isub,
    lanes,
    largest,
    load,
    load8,
    magnitude,
    prefetch,
    root,
    smallest,
    splat,
    splat8,
    store,
    unequal,
)  # fmt: skip
from support import helpers

QUANTUM = 2.0**-40
INTEGERS = np.array([3, -5, 2**50, -(2**62)])
X = np.array([1.5, -2.25, 0.0, 7.0])
Y = np.array([-3.0, -2.25, 4.0, 0.5])
Z = np.array([0.25, 8.0, -1.0, -3.5])
MASK = np.array([-1, 0, 0, -1]).view(float)


@njit
def apply_add(x, y, out):
    store(out, 0, load(x, 0) + load(y, 0))


@njit
def apply_sub(x, y, out):
    store(out, 0, load(x, 0) - load(y, 0))


@njit
def apply_mul(x, y, out):
    store(out, 0, load(x, 0) * load(y, 0))


@njit
def apply_div(x, y, out):
    store(out, 0, load(x, 0) / load(y, 0))


@njit
def apply_fma(x, y, z, out):
    store(out, 0, fma(load(x, 0), load(y, 0), load(z, 0)))


@njit
def apply_fnma(x, y, z, out):
    store(out, 0, fnma(load(x, 0), load(y, 0), load(z, 0)))


@njit
def apply_root(x, out):
    store(out, 0, root(load(x, 0)))


@njit
def apply_magnitude(x, out):
    store(out, 0, magnitude(load(x, 0)))


@njit
def apply_largest(x, y, out):
    store(out, 0, largest(load(x, 0), load(y, 0)))


@njit
def apply_smallest(x, y, out):
    store(out, 0, smallest(load(x, 0), load(y, 0)))


@njit
def apply_above(x, y, out):
    store(out, 0, above(load(x, 0), load(y, 0)))


@njit
def apply_iadd(x, y, out):
    store(out, 0, iadd(load(x, 0), load(y, 0)))


@njit
def apply_isub(x, y, out):
    store(out, 0, isub(load(x, 0), load(y, 0)))


@njit
def apply_both(x, y, out):
    store(out, 0, both(load(x, 0), load(y, 0)))


@njit
def apply_either(x, y, out):
    store(out, 0, either(load(x, 0), load(y, 0)))


@njit
def apply_unequal(x, y, out):
    store(out, 0, unequal(load(x, 0), load(y, 0)))


@njit
def apply_held(x, out):
    prefetch(x, 10**6)
    prefetch(x, -(10**6))
    store(out, 0, held(x[1]))


@njit
def number_of(pattern):
    return from_bits(pattern)


@njit
def horizontal(x):
    v = load(x, 0)
    return hmax(v), hmin(v), hsum(v), ihsum(v), lanes(v)


@njit
def apply_splat(x, out):
    store(out, 0, splat(x))


@njit
def copy_lanes(source, index, out, at):
    store(out, at, load(source, index))


@njit
def pattern_of(x):
    return bits(x)


def result(operation, *arguments):
    """The four lanes that an operation stores."""
    out = np.full(W, 77.0)
    operation(*arguments, out)
    return out


def as_integers(x):
    return x.view(np.int64)


def same_bits(x, y):
    return (as_integers(np.asarray(x)) == as_integers(np.asarray(y))).all()


@pytest.mark.nojit
@pytest.mark.parametrize(
    ("operation", "expected"),
    [(apply_add, X + Y), (apply_sub, X - Y), (apply_mul, X * Y), (apply_div, X / Y)],
    ids=["add", "sub", "mul", "div"],
)
def test_arithmetic(operation, expected):
    """Lane by lane, in the order written."""
    assert same_bits(result(operation, X, Y), expected)


@pytest.mark.nojit
def test_multiply_and_add():
    """Products that need no rounding: both ways of computing agree."""
    assert same_bits(result(apply_fma, X, Y, Z), X * Y + Z)
    assert same_bits(result(apply_fnma, X, Y, Z), Z - X * Y)


def test_fma_rounds_once():
    """(1 + a) (1 - a) - 1 = -a^2, which two roundings lose."""
    a = 2.0 ** -np.array([30.0, 31.0, 40.0, 53.0 / 2 + 4.5])
    one = np.ones(W)
    assert same_bits(result(apply_fma, 1 + a, 1 - a, -one), -(a**2))
    assert same_bits(result(apply_fnma, 1 + a, 1 - a, one), a**2)


@pytest.mark.nojit
def test_root_and_magnitude():
    """Square root correctly rounded; the sign bit cleared, also of -0."""
    assert same_bits(result(apply_root, np.array([2.0, 0.0, 1e-300, 9.0])), np.sqrt([2.0, 0.0, 1e-300, 9.0]))
    x = np.array([-0.0, -3.0, 5.0, -np.inf])
    assert same_bits(result(apply_magnitude, x), np.array([0.0, 3.0, 5.0, np.inf]))


@pytest.mark.nojit
def test_largest_and_smallest_keep_the_second_of_equals_and_of_nan():
    """``x if x > y else y``: a NaN in x is passed over, one in y stays."""
    x = np.array([1.0, 5.0, np.nan, 2.0])
    y = np.array([3.0, -1.0, 4.0, np.nan])
    assert same_bits(result(apply_largest, x, y), np.array([3.0, 5.0, 4.0, np.nan]))
    assert same_bits(result(apply_smallest, x, y), np.array([1.0, -1.0, 4.0, np.nan]))
    zeros = np.array([0.0, 0.0, 0.0, 0.0])
    assert same_bits(result(apply_largest, zeros, -zeros), -zeros)
    assert same_bits(result(apply_smallest, zeros, -zeros), -zeros)


@pytest.mark.nojit
def test_unequal_is_a_full_mask():
    """All bits set where the numbers differ, or one is none; zeros of both signs are equal."""
    x, y = np.array([2.0, 1.0, np.nan, -0.0]), np.array([1.0, 1.0, np.nan, 0.0])
    assert (as_integers(result(apply_unequal, x, y)) == [-1, 0, -1, 0]).all()


@pytest.mark.nojit
def test_either_and_from_bits():
    x, y = np.array([3, 0, -1, 8]).view(float), np.array([5, 0, 2, 1]).view(float)
    assert (as_integers(result(apply_either, x, y)) == [7, 0, -1, 9]).all()
    assert number_of(pattern_of(-1.5)) == -1.5


@pytest.mark.nojit
def test_what_is_held_or_asked_for_keeps_its_bits():
    """Memory far outside of an array may be asked for; nothing is read there."""
    assert same_bits(result(apply_held, X), np.full(W, X[1]))


@pytest.mark.nojit
def test_above_is_a_full_mask():
    """All bits set where x > y; never for equals or NaN."""
    x, y = np.array([2.0, 1.0, np.nan, -1.0]), np.array([1.0, 1.0, 0.0, -2.0])
    assert (as_integers(result(apply_above, x, y)) == [-1, 0, 0, -1]).all()


@pytest.mark.nojit
def test_integers_in_lanes():
    """Bit patterns add and subtract as 64-bit integers that wrap."""
    a, b = np.array([1, -7, 2**62, 2**63 - 1]), np.array([5, 9, 2**62, 1])
    expected = np.array([6, 2, -(2**63), -(2**63)])
    assert (as_integers(result(apply_iadd, a.view(float), b.view(float))) == expected).all()
    assert (as_integers(result(apply_isub, expected.view(float), b.view(float))) == a).all()


@pytest.mark.nojit
def test_both_selects_lanes():
    """A masked lane keeps its bits, another becomes +0."""
    assert same_bits(result(apply_both, Y, MASK), np.array([-3.0, 0.0, 0.0, 0.5]))


@pytest.mark.nojit
def test_horizontal_operations():
    """Over the four lanes; the sum pairs neighbours; lane k is bit k."""
    x = np.array([1e16, 1.0, -1e16, -3.0])
    assert horizontal(x)[:3] == (1e16, -1e16, (1e16 + 1.0) + (-1e16 - 3.0))
    assert horizontal(INTEGERS.view(float))[3] == INTEGERS.sum()
    for k in range(2**W):
        sign = np.where((k >> np.arange(W)) & 1, -1.0, 1.0)
        assert horizontal(sign)[4] == k


@pytest.mark.nojit
def test_load_and_store_at_an_offset():
    """Four entries from any place, singles widened, and no entry beside them written."""
    source = np.arange(10) / 7.0
    for dtype in (np.float64, np.float32):
        out = np.full(10, -1.0)
        copy_lanes(source.astype(dtype), 3, out, 5)
        expected = np.full(10, -1.0)
        expected[5:9] = source[3:7].astype(dtype)
        assert same_bits(out, expected)


@pytest.mark.nojit
def test_splat_and_bits():
    """One number in all lanes; its bit pattern."""
    assert same_bits(result(apply_splat, 0.1), np.full(W, 0.1))
    assert pattern_of(-0.1) == np.float64(-0.1).view(np.int64)


@pytest.mark.nojit
def test_pattern_rounds_to_quanta():
    """bits(p + M) = bits(M) + round(p / q), ties to even, alike for p and -p."""
    M = PATTERN * QUANTUM
    edge = 2.0**51 - 1.0
    quanta = np.array([0.0, 0.5, 1.5, 2.5, -0.5, -1.5, 0.49, 1e9 + 0.51, 2.0**49 + 0.5, edge, -edge, -3.75])
    out = np.concatenate(
        [result(apply_fma, quanta[k : k + W] * QUANTUM, np.ones(W), np.full(W, M)) for k in range(0, 12, W)]
    )
    expected = np.rint(quanta).astype(np.int64)
    assert (as_integers(out) - pattern_of(M) == expected).all()
    mirrored = np.concatenate(
        [result(apply_fma, quanta[k : k + W] * QUANTUM, -np.ones(W), np.full(W, M)) for k in range(0, 12, W)]
    )
    assert (as_integers(mirrored) - pattern_of(M) == -expected).all()


def test_without_jit_bad_indices_raise():
    """A place outside the array is an IndexError for loads and stores, at both ends."""
    code = """
import numpy as np, pytest
from pdfem_mpi.kernels.simd import load, splat, store
for index in (-1, 5, np.uint64(5), np.uint64(2**63)):
    for access in (lambda: load(np.zeros(8), index), lambda: store(np.zeros(8), index, splat(1.0))):
        with pytest.raises(IndexError):
            access()
assert (load(np.arange(8.0), np.uint64(4)) == [4, 5, 6, 7]).all()
"""
    done = helpers.run_python("-c", code, NUMBA_DISABLE_JIT="1")
    assert done.returncode == 0, done.stderr


def test_both_builds_have_the_same_names():
    """What kernels may import exists compiled and not."""
    code = "from pdfem_mpi.kernels import simd; print(*sorted(n for n in vars(simd) if n[0] != '_'))"
    done = helpers.run_python("-c", code, NUMBA_DISABLE_JIT="1")
    plain = set(done.stdout.split())
    assert len(plain) > 20
    assert plain <= set(vars(simd))
    intrinsics = (n for n, v in vars(simd).items() if isinstance(v, numba.core.extending._Intrinsic))
    assert set(intrinsics) <= plain


@njit
def apply_to_eight(x, y, out):
    a, b = load8(x, 0), load8(y, 0)
    store(out, 0, fma(a, b, splat8(3.0)))
    store(out, 8, largest(magnitude(a), b))
    out[16] = hmax(a)
    out[17] = ihsum(b)
    out[18] = lanes(above(a, b))


def test_eight_lanes():
    """Every lane is computed, whatever the width of the processor's registers."""
    x, y = np.concatenate([X, 3.0 * Y]), np.concatenate([Z, X])
    out = np.zeros(19)
    apply_to_eight(x, y, out)
    assert (out[:8] == x * y + 3.0).all()  # few digits: exact, rounded once or twice
    assert (out[8:16] == np.maximum(np.abs(x), y)).all()
    assert out[16] == x.max()
    assert out[17] == float(y.view(np.int64).sum())
    assert out[18] == sum(1 << k for k in range(8) if x[k] > y[k])
