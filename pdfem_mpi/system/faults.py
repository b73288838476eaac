"""Fault injection: ``PDFEM_CRASH_AT=PHASE:N`` ends the process without clean-up when a phase begins the N-th time.

Phases of writing a checkpoint, in their order: agree, flush, write, close, verify, replace, outcome, rotate. For the
tests of restarts; nothing happens unless the variable is set.
"""

import os
from collections import Counter

PHASES = ("agree", "flush", "write", "close", "verify", "replace", "outcome", "rotate")
VARIABLE = "PDFEM_CRASH_AT"
CRASHED = 99

_begun: Counter[str] = Counter()


def begin(phase: str) -> None:
    """End the process here if the variable says so: no clean-up, no flush, exit code 99."""
    where = os.environ.get(VARIABLE)
    if where is None:
        return
    _begun[phase] += 1
    name, _, count = where.partition(":")
    if name == phase and _begun[phase] == int(count or 1):
        os._exit(CRASHED)
