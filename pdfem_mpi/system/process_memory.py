"""What a process has in memory: all of it, and what is its own alone; now and at the largest.

Resident memory counts a page in every process that has touched it, though it exists once: the code of libraries, and
what MPI's ranks on one computer share, which grows with the number of ranks that a rank hears from. Private memory is
the rest: arrays, Python's objects, what libraries have taken for this process.
"""

from __future__ import annotations

import resource
from dataclasses import dataclass
from pathlib import Path

import psutil

STATUS = Path("/proc/self/status")


@dataclass(frozen=True)
class Footprint:
    """Bytes of a process.

    Attributes
    ----------
    resident, peak : int
        In memory now, and at the largest since it began.
    shared : int
        Of those in memory now: pages of files and of memory that others may have too. 0 where the system does not tell.
    """

    resident: int
    peak: int
    shared: int

    @property
    def private(self) -> int:
        """In memory now, of this process alone."""
        return self.resident - self.shared


def footprint() -> Footprint:
    """This process now."""
    try:
        lines = dict(line.split(":", 1) for line in STATUS.read_text().splitlines() if ":" in line)
        kib = {name: int(lines[name].split()[0]) for name in ("VmRSS", "VmHWM", "RssFile", "RssShmem")}
    except (OSError, KeyError):  # another system than Linux
        most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
        return Footprint(resident := resident_bytes(), max(most, resident), 0)
    return Footprint(1024 * kib["VmRSS"], 1024 * kib["VmHWM"], 1024 * (kib["RssFile"] + kib["RssShmem"]))


def resident_bytes() -> int:
    """Bytes of this process in memory."""
    return psutil.Process().memory_info().rss


def forget_peak() -> None:
    """Let the peak of `footprint` start from now, where the system allows it."""
    try:
        Path("/proc/self/clear_refs").write_text("5")
    except OSError:
        return


class MemoryWatch:
    """The largest private memory of this process since the watch began, from looks at the ends of its stages.

    The system keeps the largest resident memory only. Where that has grown since the last look, it was reached in
    between, with no more shared pages than there are now.

    Attributes
    ----------
    start : Footprint
        When the watch began.
    last : Footprint
        At the last look.
    private_peak : int
    """

    def __init__(self) -> None:
        self.start = self.last = footprint()
        self.private_peak = self.start.private

    def look(self) -> None:
        """Take what is in memory now, and what was since the last look, into account."""
        now = footprint()
        highest = now.peak - now.shared if now.peak > self.last.peak else 0
        self.private_peak = max(self.private_peak, now.private, highest)
        self.last = now
