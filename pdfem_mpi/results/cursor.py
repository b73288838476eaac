"""Result files of a run that goes on: cut back to where the checkpoint was, so that nothing is there twice."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path

from pdfem_mpi.results.history import History
from pdfem_mpi.system.files import sync

Cursor = Mapping[str, int]


def flushed(out: Path, history: History, frame_files: Iterable[str]) -> dict[str, dict[str, int]]:
    """Bring the result files to the disk and return how far each is."""
    sync(history.path)
    results = {history.path.name: {"rows": history.rows, "bytes": history.size}}
    for name in frame_files:
        from pdfem_mpi.results import vtkhdf

        sync(out / name)
        results[name] = {"frames": vtkhdf.frames(out / name)}
    return results


def continue_history(path: Path, columns: Iterable[str], cursor: Cursor | None, note: Callable[[str], None]) -> History:
    """Reopen a history after the cursor's rows; without a cursor, or where the file is no good, begin a new one."""
    if cursor is None:
        return History(path, columns)
    try:
        history = History.reopen(path, columns, cursor["rows"])
        if history.size == cursor["bytes"]:
            return history
        reason = f"its {cursor['rows']} rows have {history.size} bytes, {cursor['bytes']} when they were written"
    except FileNotFoundError:
        reason = "it is missing"
    except ValueError as error:
        reason = str(error)
    set_aside(path, reason, note)
    return History(path, columns)


def continue_frames(path: Path, cursor: Cursor, note: Callable[[str], None]) -> bool:
    """Cut a file of frames back to the cursor; False if a new one has to be begun."""
    from pdfem_mpi.results import vtkhdf

    try:
        vtkhdf.truncate(path, cursor["frames"])
        return True
    except FileNotFoundError:
        reason = "it is missing"
    except (OSError, ValueError, KeyError, RuntimeError) as error:
        if isinstance(error, OSError) and not os.access(path, os.W_OK):
            raise
        reason = f"it cannot be read: {error}"
    set_aside(path, reason, note)
    return False


def set_aside(path: Path, reason: str, note: Callable[[str], None], fate: str = "damaged") -> None:
    """Rename a file that cannot be gone on with, and say so."""
    renamed = path.with_name(f"{path.name}.{fate}")
    kept = ""
    if path.exists():
        os.replace(path, renamed)
        kept = f"; it is now {renamed.name}"
    note(f"{path.name} begins anew: {reason}{kept}")
