"""Result files of a run that goes on are cut back to the checkpoint, so that no row and no frame is there twice."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

from pdfem_mpi.results.frame_digest import FrameDigest
from pdfem_mpi.results.history import History, read_rows
from pdfem_mpi.system.files import sync

Cursor = Mapping[str, Any]


def flushed(out: Path, history: History, frame_files: Mapping[str, FrameDigest]) -> dict[str, dict[str, Any]]:
    """Bring the result files to the disk; return how far each is, and the digest of what was written."""
    sync(history.path)
    results = {history.path.name: {"rows": history.rows, "bytes": history.size, "sha256": history.sha256}}
    for name, digest in frame_files.items():
        from pdfem_mpi.results import vtkhdf
        from pdfem_mpi.results.read_frames import deck_of

        sync(out / name)
        results[name] = {"frames": vtkhdf.frames(out / name), "sha256": digest.hexdigest(), "deck": deck_of(out / name)}
    return results


def continue_history(path: Path, columns: Iterable[str], cursor: Cursor | None, note: Callable[[str], None]) -> History:
    """Reopen a history after the cursor's rows; without a cursor, or where the file is damaged, begin a new one."""
    if cursor is None:
        return History(path, columns)
    try:
        return History.reopen(path, columns, cursor["rows"], cursor["bytes"], cursor.get("sha256"))
    except FileNotFoundError:
        reason = "it is missing"
    except IsADirectoryError:
        reason = "it is a folder"
    except ValueError as error:
        reason = _without(path, error)
    set_aside(path, reason, note)
    return History(path, columns)


def continue_frames(path: Path, cursor: Cursor, note: Callable[[str], None]) -> FrameDigest | None:
    """Cut a file of frames back to the cursor, and return its digest; None if a new one has to be begun."""
    from pdfem_mpi.results import vtkhdf

    reason, digest = _check_frames(path, cursor)
    if reason is None:
        try:
            vtkhdf.truncate(path, cursor["frames"])
            return digest
        except (OSError, ValueError, KeyError, RuntimeError) as error:
            if isinstance(error, OSError) and not os.access(path, os.W_OK):
                raise
            reason = f"it cannot be cut back: {error}"
    set_aside(path, reason, note)
    return None


def find_damage(out: Path, results: Mapping[str, Cursor]) -> list[str]:
    """Which result files are not what was written when a checkpoint noted how far they were; nothing is changed."""
    found = []
    for name, cursor in results.items():
        if "rows" in cursor:
            reason = _check_history(out / name, cursor)
        else:
            reason, _ = _check_frames(out / name, cursor)
        if reason:
            found.append(f"{name} is damaged: {reason}")
    return found


def unchecked(results: Mapping[str, Cursor]) -> list[str]:
    """A line about results that cannot be checked: checkpoints of older versions have no digests of them."""
    names = [name for name, cursor in results.items() if "sha256" not in cursor]
    return [f"taken as they are, since the checkpoint has no digest of them: {', '.join(names)}"] if names else []


def _check_history(path: Path, cursor: Cursor) -> str | None:
    try:
        with path.open("rb") as file:
            read_rows(file, path, cursor["rows"], cursor["bytes"], cursor.get("sha256"))
    except FileNotFoundError:
        return "it is missing"
    except OSError as error:
        return f"it cannot be read: {error.strerror}"
    except ValueError as error:
        return _without(path, error)
    return None


def _check_frames(path: Path, cursor: Cursor) -> tuple[str | None, FrameDigest | None]:
    """Why a file does not have the cursor's frames, or its digest."""
    from pdfem_mpi.results import vtkhdf
    from pdfem_mpi.results.read_frames import deck_of

    try:
        digest = vtkhdf.digest_of(path, cursor["frames"])
    except FileNotFoundError:
        return "it is missing", None
    except ValueError as error:
        reason = str(error)
    except (OSError, KeyError, RuntimeError, TypeError, IndexError, MemoryError) as error:
        reason = f"it cannot be read: {error}"
    else:
        if cursor.get("sha256") in (None, digest.hexdigest()):
            return None, digest
        reason = f"its {cursor['frames']} frames are not those that were written"
    if cursor.get("deck") not in (None, deck_of(path)) and deck_of(path):
        reason = "it is of another run"
    return reason, None


def _without(path: Path, error: ValueError) -> str:
    """A reason without the name of the file, which stands before it already."""
    return str(error).removeprefix(f"{path}: ")


def set_aside(path: Path, reason: str, note: Callable[[str], None], fate: str = "damaged") -> None:
    """Rename a file that cannot be gone on with, and say so."""
    kept = ""
    if path.exists():
        renamed = free_name(path, fate)
        os.rename(path, renamed)
        kept = f"; it is now {renamed.name}"
    note(f"{path.name} begins anew: {reason}{kept}")


def free_name(path: Path, fate: str) -> Path:
    """A name beside a file that nothing has: one that stepped aside earlier stays."""
    names = (path.with_name(f"{path.name}.{fate}{number}") for number in ("", *(f".{k}" for k in range(2, 1000))))
    return next((name for name in names if not os.path.lexists(name)), path.with_name(f"{path.name}.{fate}"))
