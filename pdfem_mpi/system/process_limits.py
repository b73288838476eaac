"""What a process may take: its own limits, those of its container or job, and the room that MPI needs in /dev/shm.

The computer's free memory says nothing about them, and a process that goes beyond is killed without a message.
"""

from __future__ import annotations

import os
import resource
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

SHARED_MEMORY = Path("/dev/shm")
#: Of MPICH 5.0 on one node: bytes of a rank, and beside them. With 2, 4 and 8 ranks it ends in a bus error or a
#: segmentation fault at some sizes below (seen up to 17, 22 and 40 MiB), and at none of the tried sizes above.
SHARED_BYTES_OF_RANK, SHARED_BYTES_BESIDE = int(5.2 * 2**20), 8 * 2**20
#: One rank alone makes do with less; at 1 MiB it ends in a bus error.
SHARED_BYTES_ALONE = 2 * 2**20
#: A group's limit from which on it stands for none.
NO_LIMIT = 2**60


class Limit(NamedTuple):
    """Bytes that may still be taken, and what limits them, in words."""

    bytes: float
    what: str


def own_limit(proc: Path = Path("/proc/self")) -> Limit | None:
    """What this process may still take by its own limits (``ulimit -v`` and ``-d``); None without any."""
    found = []
    try:
        pages = (proc / "statm").read_text().split()
    except OSError:
        return None
    page = resource.getpagesize()
    for number, field, name in ((resource.RLIMIT_AS, 0, "ulimit -v"), (resource.RLIMIT_DATA, 5, "ulimit -d")):
        soft, _ = resource.getrlimit(number)
        if soft != resource.RLIM_INFINITY:
            found.append(Limit(max(soft - page * int(pages[field]), 0), f"the limit of a process ({name})"))
    return min(found, default=None)


def group_limit(proc: Path = Path("/proc/self"), mount: Path = Path("/sys/fs/cgroup")) -> Limit | None:
    """What the control group of this process, a container's or a batch job's, may still take; None without a limit.

    Groups lie within groups: the one with the least room counts. File pages that the system may drop are room.
    """
    found = []
    for folder, names in _groups(proc, mount):
        limit, usage = (_number(folder / name) for name in names[:2])
        if limit is None or usage is None or limit >= NO_LIMIT:
            continue
        room = limit - usage + _droppable(folder / "memory.stat", names[2])
        found.append(Limit(max(min(room, limit), 0), "the memory limit of the container or job"))
    return min(found, default=None)


def _groups(proc: Path, mount: Path) -> Iterator[tuple[Path, tuple[str, str, str]]]:
    """Folders of the groups of a process, with the names of their limit, usage and droppable pages."""
    try:
        lines = (proc / "cgroup").read_text().splitlines()
    except OSError:
        return
    for line in lines:
        number, kinds, path = [*line.split(":", 2), "", ""][:3]
        if number == "0" and not kinds:
            roots, names = (mount, mount / "unified"), ("memory.max", "memory.current", "inactive_file")
        elif "memory" in kinds.split(","):
            roots = (mount / "memory",)
            names = ("memory.limit_in_bytes", "memory.usage_in_bytes", "total_inactive_file")
        else:
            continue
        for root in roots:
            # in a container the path may be that of the host, and the container's own group is the root
            inner = Path(path.strip("/"))
            for folder in dict.fromkeys((root / inner, *(root / parent for parent in inner.parents), root)):
                yield folder, names


def _number(path: Path) -> int | None:
    """The number in a file; None where there is none, also for ``max``."""
    try:
        return int(path.read_text())
    except (OSError, ValueError):
        return None


def _droppable(path: Path, name: str) -> int:
    try:
        lines = [line.split() for line in path.read_text().splitlines()]
        return next((int(line[1]) for line in lines if len(line) == 2 and line[0] == name), 0)
    except (OSError, ValueError):
        return 0


def shared_memory_problem(ranks: int, started: bool = False, folder: Path = SHARED_MEMORY) -> str | None:
    """A sentence about too little shared memory for so many ranks on this computer; None if it suffices.

    Parameters
    ----------
    started : bool
        Ranks are starting: some may have taken their share, and the whole counts instead of what is free.
    """
    try:
        room = os.statvfs(folder)
    except OSError:  # MPI uses another place then
        return None
    available = room.f_frsize * (room.f_blocks if started else room.f_bavail)
    needed = SHARED_BYTES_ALONE if ranks == 1 else SHARED_BYTES_BESIDE + ranks * SHARED_BYTES_OF_RANK
    if not room.f_blocks or available >= needed:
        return None
    who, kind = f"{ranks} ranks" if ranks > 1 else "one rank", "in all" if started else "free"
    return (
        f"{folder} has {available / 2**20:.1f} MiB {kind}, and the MPI library of {who} needs "
        f"{needed / 2**20:.0f} MiB there. Make it larger (docker run --shm-size=1g, or mount -o remount,size=1g "
        f"{folder}), or use fewer ranks."
    )
