"""Checkpoints in a folder: their names, which there are, and which of them are kept."""

from __future__ import annotations

import contextlib
import os
import re
from pathlib import Path

#: Of a file; it rises with the content, and earlier ones are read. The header has it as ``schema``. Here, since a run
#: that writes no checkpoint need not load h5py.
FORMAT = 2
_NAME = re.compile(r"ckpt-(\d{6,})\.h5")


def checkpoint_path(folder: Path, number: int) -> Path:
    """Name of a checkpoint."""
    return folder / f"ckpt-{number:06d}.h5"


def list_checkpoints(folder: Path) -> list[tuple[int, Path]]:
    """Numbers and names of all checkpoints in a folder, newest first; nothing is opened."""
    try:
        names = os.listdir(folder)
    except (FileNotFoundError, NotADirectoryError):
        return []
    found = [(int(match[1]), folder / name) for name in names if (match := _NAME.fullmatch(name))]
    return sorted(found, reverse=True)


def remove_stale(folder: Path) -> int:
    """Remove what writers that were killed left behind; return how many files."""
    stale = list(folder.glob("ckpt-*.h5.tmp.*"))
    for path in stale:
        path.unlink(missing_ok=True)
    return len(stale)


def rotate(folder: Path, keep: int) -> None:
    """Remove all but the newest ``keep`` checkpoints."""
    for _, path in list_checkpoints(folder)[keep:]:
        with contextlib.suppress(IsADirectoryError, PermissionError):
            path.unlink(missing_ok=True)
