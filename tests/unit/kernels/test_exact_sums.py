"""Exact sums against math.fsum and fractions, in any order and any parts."""

import math
from fractions import Fraction

import numpy as np
import pytest

from pdfem_mpi.kernels.exact_sums import (
    BITS,
    BLOCK,
    HIGHEST,
    LOWEST,
    NOT_FINITE,
    SIZE,
    add_any_terms,
    add_products,
    add_terms,
    carry,
    value,
)  # fmt: skip

pytestmark = pytest.mark.filterwarnings("ignore:invalid", "ignore:overflow")  # meant to happen

SMALLEST = 2.0 ** (BITS * LOWEST)  # terms are rounded to multiples of it
LARGEST = 2.0 ** (BITS * HIGHEST + 51)


def empty():
    return np.zeros(SIZE, np.int64)


def add(terms, digits, block=BLOCK):
    """Add terms in blocks of some length."""
    for start in range(0, len(terms), block):
        scratch = np.full(BLOCK, 99.0)  # what is left of other blocks must not matter
        m = min(block, len(terms) - start)
        scratch[:m] = terms[start : start + m]
        add_terms(scratch, m, digits)
    carry(digits)
    return digits


def total(terms):
    """The exact sum as a fraction."""
    return sum(map(Fraction, terms.tolist()), Fraction(0))


def exact(digits):
    """What the digits hold, not rounded."""
    return sum(Fraction(2) ** (BITS * (k + LOWEST)) * d for k, d in enumerate(digits[:NOT_FINITE].tolist()))


def wide(n, low=-900, high=950, seed=1):
    """Terms of both signs, with exponents spread evenly."""
    rng = np.random.default_rng(seed)
    return np.ldexp(rng.uniform(-1.0, 1.0, n), rng.integers(low, high, n))


CASES = {
    "like sizes": lambda: np.random.default_rng(2).normal(size=1300),
    "all exponents": lambda: wide(2000),
    "cancelling": lambda: np.concatenate([wide(700), -wide(700)[::-1], [1e-200]]),
    "cancelling to nothing": lambda: np.concatenate([wide(700), -wide(700)[::-1]]),
    "one large, many small": lambda: np.concatenate([[1e200], np.full(999, -1e184), [-1e200]]),
    "ties": lambda: np.array([1.0, 2.0**-53, 2.0**-53, -(2.0**-106)]),
    "half digits": lambda: np.ldexp(np.array([1.0, -1.0, 1.0, 3.0, -3.0, 1.0]), [-1, 47, 47, 46, 95, 143]),
    "one": lambda: np.array([-1e-30]),
    "none": lambda: np.empty(0),
    "zeros": lambda: np.array([0.0, -0.0, 0.0]),
}
cases = pytest.mark.parametrize("terms", [make() for make in CASES.values()], ids=list(CASES))


@pytest.mark.nojit
@cases
def test_the_sum_is_rounded_once(terms):
    """As math.fsum, which rounds the exact sum once."""
    assert value(add(terms, empty())) == math.fsum(terms.tolist()) == float(total(terms))


@cases
@pytest.mark.parametrize("block", [1, 2, 3, 5, 127, 511])
def test_digits_hold_the_exact_sum_in_any_blocks_and_order(terms, block):
    """The digits themselves, not only the rounded value, hold one exact number."""
    digits = add(np.random.default_rng(block).permutation(terms), empty(), block)
    assert exact(digits) == total(terms)


SPREADS = {"one size": 0, "within two digits": 45, "within three digits": 95, "beyond": 300}


@pytest.mark.nojit
@pytest.mark.parametrize("spread", SPREADS.values(), ids=SPREADS)
@pytest.mark.parametrize("exponent", [-955, -900, -760, -740, -200, 0, 31, 880, 905, 1000])
def test_digits_below_the_largest_term_are_those_of_the_sum(spread, exponent):
    """Two or three digits aligned to a block's largest term hold the same sum as a pass for each digit of the sum."""
    rng = np.random.default_rng(abs(exponent) + spread)
    terms = np.ldexp(rng.uniform(-1.0, 1.0, BLOCK), exponent - rng.integers(0, spread + 1, BLOCK))
    terms[rng.integers(0, BLOCK, 40)] = 0.0
    digits = empty()
    add_any_terms(terms.copy(), BLOCK, digits)
    carry(digits)
    assert add(terms, empty()).tolist() == digits.tolist()


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, 2.0**1012])
def test_a_block_with_a_term_that_is_none_is_counted_and_adds_nothing(bad):
    terms = np.random.default_rng(8).normal(size=BLOCK)
    terms[77] = bad
    digits = add(terms, empty())
    assert digits[NOT_FINITE] == 1
    assert not digits[:NOT_FINITE].any()


def test_products_of_long_vectors_are_those_of_short_ones():
    """Whole blocks are multiplied in lanes; the digits are those of the terms, also where products overflow."""
    rng = np.random.default_rng(9)
    x, y = rng.normal(size=(2, 3 * BLOCK + 5)) * 10.0 ** rng.integers(-170, 150, (2, 3 * BLOCK + 5))
    digits = empty()
    add_products(x, y, digits)
    assert digits.tolist() == add(x * y, empty()).tolist()


@cases
@pytest.mark.parametrize("n_parts", [2, 3, 4, 7])
def test_parts_join_to_the_same_value(terms, n_parts):
    """One integer sum joins the ranks, of which some have no terms."""
    shuffled = np.random.default_rng(n_parts).permutation(terms)
    joined = sum(add(piece, empty()) for piece in np.array_split(shuffled, n_parts))
    assert value(joined) == value(add(terms, empty()))


@pytest.mark.nojit
def test_small_terms_round_each_by_itself():
    """Below 2^-960 a term is rounded to a multiple, whatever stands beside it; ties to even."""
    small = SMALLEST * np.array([0.5, 1.5, 0.75, -0.5, 1e-5, 2.25])
    assert value(add(small, empty())) == SMALLEST * (0 + 2 + 1 + 0 + 0 + 2)
    beside = add(np.concatenate([[1.0, 1e250], small, [-1e250, -1.0]]), empty())
    assert value(beside) == SMALLEST * 5
    assert value(add(np.array([5e-324, 1e-310]), empty())) == 0.0


@pytest.mark.parametrize("exponent", [940, 959, 960, 1000, 1011])
def test_large_terms(exponent):
    """The highest digit holds terms up to 2^1011."""
    terms = np.ldexp(np.array([1.0, -0.75, 0.5 + 2.0**-40, 1.0 - 2.0**-53]), exponent)
    assert value(add(terms, empty())) == float(total(terms))


def test_carries_reach_the_place_above_the_highest_digit():
    """Sums beyond the range of one term, of either sign."""
    for sign in (1.0, -1.0):
        terms = np.full(5000, sign * LARGEST)
        assert value(add(terms, empty())) == 5000 * sign * LARGEST


@pytest.mark.nojit
def test_carry_keeps_the_number():
    """Digits end below 2^48, the sign in the place for carries."""
    rng = np.random.default_rng(4)
    digits = empty()
    digits[:NOT_FINITE] = rng.integers(-(2**62), 2**62, NOT_FINITE)
    weights = [Fraction(2) ** (BITS * k) for k in range(NOT_FINITE)]
    before = sum(w * d for w, d in zip(weights, digits.tolist(), strict=False))
    carry(digits)
    assert sum(w * d for w, d in zip(weights, digits.tolist(), strict=False)) == before
    assert (digits[: NOT_FINITE - 1] >= 0).all()
    assert (digits[: NOT_FINITE - 1] < 2**BITS).all()


@pytest.mark.nojit
@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("place", [0, 3, 600])
def test_a_term_that_is_not_finite_makes_the_sum_nan(bad, place):
    """On whichever rank, in whichever lane; another infinity does not cancel it."""
    terms = np.ones(700)
    terms[place] = bad
    assert math.isnan(value(add(terms, empty())))
    assert math.isnan(value(add(np.ones(3), empty()) + add(terms, empty()) + add(-terms, empty())))


def test_overflow_of_the_sum_is_infinite():
    """Finite terms whose sum is beyond float64: only the last rounding overflows."""
    digits = add(np.full(4, LARGEST), empty())
    assert value(digits << 12) == math.inf
    assert value(-(digits << 12)) == -math.inf


@pytest.mark.nojit
@pytest.mark.parametrize("n", [0, 1, 5, BLOCK, BLOCK + 1, 3 * BLOCK - 1])
def test_products(n):
    """A dot product is the exact sum of the rounded products, added to what is there."""
    x, y = wide(n, -400, 400, 5), wide(n, -400, 400, 6)
    digits = add(np.array([0.5]), empty())
    add_products(x, y, digits)
    assert exact(digits) == total(x * y) + Fraction(1, 2)
    assert (x == wide(n, -400, 400, 5)).all()


def test_products_that_overflow_are_not_finite():
    """A product beyond float64 is counted, not lost."""
    digits = empty()
    add_products(np.array([1.0, 1e200]), np.array([1.0, 1e200]), digits)
    assert math.isnan(value(digits))


def test_sums_continue():
    """Adding in two calls is adding all."""
    terms = wide(1500, seed=7)
    digits = add(terms[:301], empty())
    assert value(add(terms[301:], digits)) == math.fsum(terms.tolist())
