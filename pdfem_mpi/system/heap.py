"""How the C library's malloc keeps arrays that were freed: not at all while a run is set up.

The GNU malloc takes small arrays from its heap and large ones from the system. Once a large array was freed, it takes
arrays of that size from the heap, where a small one that lives behind them keeps their pages. Set-up frees many arrays
that it needs once; with this, their pages go back at once, and those of the bonds come instead. In the loops of a
solver, and of a fit, the heap is the better place: a page from the system is cleared first. So it is for arrays that
are not so large, which set-up makes thousands of (docs/needs.md).
"""

from __future__ import annotations

import contextlib
import ctypes
from collections.abc import Iterator

# From the GNU C library's malloc.h; other libraries keep their own ways.
_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3
#: Arrays of at least so many bytes get pages of their own: while the model is made, while a solver is made for it, and
#: otherwise, where it is the most that the library allows.
APART, APART_BESIDE_BONDS, OTHERWISE = 1 << 20, 8 << 20, 32 << 20


_thresholds = [OTHERWISE]  # of the contexts entered, the innermost last


@contextlib.contextmanager
def large_arrays_apart(least: int = APART) -> Iterator[None]:
    """Give arrays of at least so many bytes pages of their own, which the system has back when they are freed."""
    with _entered(least):
        yield


@contextlib.contextmanager
def large_arrays_together() -> Iterator[None]:
    """Take arrays from the heap again, within `large_arrays_apart`: for loops that make arrays at every turn."""
    with _entered(OTHERWISE):
        yield


def give_back() -> None:
    """Give the pages that were freed on the heap back to the system."""
    with contextlib.suppress(AttributeError, OSError, TypeError):
        ctypes.CDLL(None).malloc_trim(ctypes.c_size_t(0))


@contextlib.contextmanager
def _entered(threshold: int) -> Iterator[None]:
    _thresholds.append(threshold)
    _set(threshold)
    try:
        yield
    finally:
        _thresholds.pop()
        _set(_thresholds[-1])


def _set(threshold: int) -> None:
    trim = 2 * threshold if threshold == OTHERWISE else threshold
    with contextlib.suppress(AttributeError, OSError, TypeError):
        mallopt = ctypes.CDLL(None).mallopt
        mallopt(_MMAP_THRESHOLD, threshold)
        mallopt(_TRIM_THRESHOLD, trim)
