"""Python's search for garbage: it finds none while modules and kernels are loaded, and need not look at them later."""

from __future__ import annotations

import contextlib
import gc
from collections.abc import Iterator


@contextlib.contextmanager
def no_search_for_garbage() -> Iterator[None]:
    """Load modules or kernels within: they make 140,000 objects that stay, and Python would look at them often."""
    searched = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if searched:
            gc.enable()


def keep_for_good() -> None:
    """Count what was made up to here as no garbage ever, at the end of the process neither.

    For a process of this program's own: what another program had left to be found is never found.
    """
    gc.freeze()
