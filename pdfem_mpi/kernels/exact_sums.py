"""Exact sums of float64 numbers: integers in, one rounding at the very end.

A sum is kept as ``SIZE`` signed 64-bit integers, digits of weight ``2**(48 k)``. A term is cut into its digits
from the top down by adding and subtracting ``M_k = 1.5 * 2**52 * 2**(48 k)``, which is exact, and the digits are
added as integers, which is exact in any order. Two sums are added digit by digit, so one integer reduction
joins the ranks, and `value` rounds the total once. Terms below ``2**-960`` are dropped (each by itself, so still in any
order); the last digit counts blocks with terms that are not finite, or above ``2**1011``.

Blocks of terms of similar size, none smaller than some ``2**-48`` of the largest, take one pass with two digits of 51
bits that are aligned to the largest term; the sum is the same.

References
----------
Rounding by a large constant: Demmel & Nguyen, Fast Reproducible Floating-Point Summation, 2013. Long accumulators:
Kulisch, Computer Arithmetic and Validity, 2008.
"""

import math

import numpy as np
from numba import njit, types

from pdfem_mpi.kernels.simd import (
    PATTERN,
    bits,
    either,
    fma,
    from_bits,
    hmax,
    hsum,
    iadd,
    ihsum,
    isub,
    lanes,
    largest,
    load8,
    magnitude,
    splat8,
    store,
    unequal,
)

BITS = 48  #: of a digit
MOST_RANKS = 2 ** (63 - BITS)  #: whose digits an int64 holds the sum of
LOWEST, HIGHEST = -20, 20  #: exponents k of the digits
NOT_FINITE = HIGHEST - LOWEST + 2  #: place of the count of terms that are not finite (the place before takes carries)
SIZE = NOT_FINITE + 1
BLOCK = 512  #: terms cut together
AT_ONCE = 8  #: of them side by side
BLOCKS = 2**12  #: blocks after which digits are carried, so that they cannot overflow: each adds less than 2**51
LARGEST = 2.0**1011  #: terms from here on count as not finite
SMALL, LARGE = 2.0**-750, 2.0**900  #: between them the largest term of a block has its digits within the sum's

_PATTERNS = np.array([PATTERN * 2.0 ** (BITS * k) for k in range(LOWEST, HIGHEST + 1)])


_options = {"cache": True, "nogil": True, "boundscheck": False, "error_model": "numpy"}


@njit(inline="always")
def add_shifted(total, exponent, digits):
    """Add ``total * 2**exponent`` to the digits; at most ``2**48`` to each of the lower two."""
    place = (exponent - BITS * LOWEST) // BITS
    shift = exponent - BITS * (place + LOWEST)
    low = total & ((np.int64(1) << np.int64(BITS - shift)) - np.int64(1))
    high = total >> np.int64(BITS - shift)
    digits[place] += low << np.int64(shift)
    digits[place + 1] += high & ((1 << BITS) - 1)
    digits[place + 2] += high >> BITS


@njit(**_options)
def add_any_terms(terms, padded, digits):
    """Add terms of any size, digit by digit in the places of the sum; parameters as in `add_sized_terms`."""
    top = splat8(0.0)
    bad = splat8(0.0)
    for k in range(0, padded, AT_ONCE):
        x = load8(terms, k)
        top = largest(magnitude(x), top)
        bad = fma(x, splat8(0.0), bad)
    size = hmax(top)
    if hsum(bad) != 0.0 or size > LARGEST:
        digits[NOT_FINITE] += 1
        return
    place = HIGHEST - LOWEST
    while place > 0 and size < 2.0 ** (BITS * (place + LOWEST)) * 0.5:
        place -= 1
    while size > 0.0 and place >= 0:
        M = splat8(_PATTERNS[place])
        total = splat8(0.0)
        top = splat8(0.0)
        for k in range(0, padded, AT_ONCE):
            x = load8(terms, k)
            t = x + M
            x = x - (t - M)
            total = iadd(total, isub(t, M))
            top = largest(magnitude(x), top)
            store(terms, k, x)
        s = ihsum(total)
        digits[place] += s & ((1 << BITS) - 1)
        digits[place + 1] += s >> BITS
        size = hmax(top)
        place -= 1


@njit(**_options)
def add_sized_terms(terms, padded, size, digits):
    """Add terms whose largest is known, in two digits of 51 bits below it; what is left of any, in digits of the sum.

    Parameters
    ----------
    terms : float64, shape (BLOCK,)
        Destroyed.
    padded : int
        Number of terms, a multiple of `AT_ONCE`.
    size : float
        Largest magnitude of a term that is a number.
    digits : int64, shape (SIZE,)
        Added to.
    """
    if not SMALL < size < LARGE:
        add_any_terms(terms, padded, digits)
        return
    exponent = np.int64((bits(size) >> 52) & 2047) - 1022  # size < 2**exponent
    first = exponent - 50
    second = first - 51
    high = PATTERN * from_bits((first + 1023) << 52)
    low = PATTERN * from_bits((second + 1023) << 52)
    M = splat8(high)
    L = splat8(low)
    upper = splat8(0.0)
    lower = splat8(0.0)
    rest = splat8(0.0)
    for k in range(0, padded, AT_ONCE):
        x = load8(terms, k)
        t = x + M
        x = x - (t - M)
        u = x + L
        upper = iadd(upper, t)
        lower = iadd(lower, u)
        rest = either(rest, x - (u - L))  # 0 and NaN: some bit below the sign is set
    if lanes(unequal(magnitude(rest), splat8(0.0))) != 0:
        third = second - 51
        lowest = PATTERN * from_bits((third + 1023) << 52)
        N = splat8(lowest)
        third_sum = splat8(0.0)
        rest = splat8(0.0)
        for k in range(0, padded, AT_ONCE):
            x = load8(terms, k)
            x = x - ((x + M) - M)
            x = x - ((x + L) - L)
            t = x + N
            third_sum = iadd(third_sum, t)
            x = x - (t - N)
            rest = either(rest, x)
            store(terms, k, x)
        if lanes(unequal(magnitude(rest), splat8(0.0))) != 0:
            before = digits[NOT_FINITE]
            add_any_terms(terms, padded, digits)
            if digits[NOT_FINITE] != before:
                return
        add_shifted(ihsum(third_sum) - padded * bits(lowest), third, digits)
    add_shifted(ihsum(upper) - padded * bits(high), first, digits)
    add_shifted(ihsum(lower) - padded * bits(low), second, digits)


@njit(**_options)
def add_terms(terms, n, digits):
    """Add the first ``n <= BLOCK`` terms to a sum; `carry` after at most ``BLOCKS`` calls.

    Parameters
    ----------
    terms : float64, shape (BLOCK,)
        Destroyed.
    n : int
    digits : int64, shape (SIZE,)
        Added to.
    """
    padded = (n + AT_ONCE - 1) // AT_ONCE * AT_ONCE
    for k in range(n, padded):
        terms[k] = 0.0
    top = splat8(0.0)
    for k in range(0, padded, AT_ONCE):
        top = largest(magnitude(load8(terms, k)), top)
    add_sized_terms(terms, padded, hmax(top), digits)


@njit(**_options)
def add_products(x, y, digits):
    """Add the dot product of two vectors to a sum (each product rounded once to float64).

    Parameters
    ----------
    x, y : float64, shape (n,)
    digits : int64, shape (SIZE,)
        Added to.
    """
    terms = np.empty(BLOCK)
    n = x.size
    whole = n // BLOCK * BLOCK
    block = terms.size  # not the literal, for which numba would compile `add_sized_terms` once more
    for start in range(0, whole, BLOCK):
        top = splat8(0.0)
        for k in range(0, BLOCK, AT_ONCE):
            product = load8(x, start + k) * load8(y, start + k)
            top = largest(magnitude(product), top)
            store(terms, k, product)
        add_sized_terms(terms, block, hmax(top), digits)
        if start // BLOCK % BLOCKS == BLOCKS - 1:
            carry(digits)
    for k in range(n - whole):
        terms[k] = x[whole + k] * y[whole + k]
    add_terms(terms, n - whole, digits)
    carry(digits)


@njit(cache=True, nogil=True, boundscheck=False, error_model="numpy")
def carry(digits):
    """Bring the digits below ``2**48`` again, so that sums of 2**15 blocks and 2**15 ranks cannot overflow."""
    for place in range(NOT_FINITE - 1):
        digits[place + 1] += digits[place] >> BITS
        digits[place] &= (1 << BITS) - 1


def value(digits):
    """The sum, rounded once.

    Parameters
    ----------
    digits : int64, shape (SIZE,)
        Joined over all ranks.

    Returns
    -------
    float
        NaN if a term was not finite.
    """
    if digits[NOT_FINITE]:
        return math.nan
    total = 0
    for digit in digits[NOT_FINITE - 1 :: -1].tolist():
        total = (total << BITS) + digit
    exponent = BITS * LOWEST
    try:
        return total / (1 << -exponent)  # true division of integers rounds once
    except OverflowError:
        return math.inf if total > 0 else -math.inf


_f8, _i8 = types.float64[::1], types.int64[::1]
SIGNATURES = {
    add_products: types.void(_f8, _f8, _i8),
    carry: types.void(_i8),
}
