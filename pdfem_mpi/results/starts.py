"""``starts.jsonl``: every start of a run, with its seconds; also those that ended without a new checkpoint.

A start has a line when it begins, one at each checkpoint and one when it ends. One that was killed has the seconds of
its last sign of life: of its last line here or in run.log.
"""

from __future__ import annotations

import contextlib
import json
import os
import time
from pathlib import Path
from typing import Any

from pdfem_mpi.system.plain_files import read_plain

NAME = "starts.jsonl"
_MOST_BYTES = 1 << 26


class Starts:
    """The starts of a run, this one the last of them.

    Parameters
    ----------
    folder : Path
        The run folder.
    anew : bool
        The run begins anew: earlier starts were of another one.
    before : (float, list of dict)
        Seconds and restarts that only a checkpoint has: of another folder, or from before this file.

    Attributes
    ----------
    seconds_before : float
        Of all earlier starts.
    restarts : list of dict
        One entry for each start but the first.
    idle : int
        So many starts before this one, one after the other, ended where they began.
    """

    def __init__(self, folder: Path, anew: bool, before: tuple[float, list[dict[str, Any]]] = (0.0, [])):
        self.path = folder / NAME
        self._anew, self._lines = anew, []
        lines = [] if anew else _read(self.path)
        starts: list[dict[str, Any]] = []
        for line in lines:
            if "began" in line:
                starts.append(dict(line))
            elif starts:
                starts[-1] |= line
                if starts[-1].get("restart") and "notes" in line:
                    starts[-1]["restart"] = starts[-1]["restart"] | {"notes": line["notes"]}
        self._before = before if not starts else (starts[0]["seconds_before"], starts[0]["restarts_before"])
        if starts and "ended" not in starts[-1]:
            starts[-1]["seconds"] = max(starts[-1].get("seconds", 0.0), _last_sign(folder, starts[-1]))
        self.seconds_before = self._before[0] + sum(start.get("seconds", 0.0) for start in starts)
        self.restarts = [*self._before[1], *(start["restart"] for start in starts if start.get("restart"))]
        self.idle = _idle(starts)
        self.is_first = not starts and not before[1] and not before[0]
        # written down now: once this start writes to the log, nothing shows any more when the killed one ended
        self._close = starts[-1]["seconds"] if starts and "ended" not in starts[-1] else None
        self._size = 0

    def begin(self, restart: dict[str, Any] | None) -> None:
        """Note that this start begins; ``restart`` is what summary.json says of it, None of a first start."""
        if restart is not None:
            self.restarts.append(restart)
        with contextlib.suppress(OSError):
            self._size = self.path.stat().st_size
        if self._close is not None:
            self._write({"seconds": self._close, "ended": None})
        self._write(
            {
                "began": time.time(),
                "seconds_before": self._before[0],
                "restarts_before": self._before[1],
                "restart": restart,
            }
        )

    def commit(self) -> None:
        """This start has begun to change the folder: the lines of another run are removed."""
        if self._anew:
            self._anew = False
            with contextlib.suppress(OSError):
                self.path.unlink(missing_ok=True)
            lines, self._lines = self._lines, []
            for line in lines:
                self._write(line)

    def note(self, seconds: float) -> None:
        """This start has taken so many seconds, and a checkpoint is about to be written."""
        self._write({"seconds": seconds})

    def end(self, seconds: float, code: int | None, did_nothing: bool, notes: list[str]) -> None:
        """This start has ended; without a code, in the middle."""
        self._write({"seconds": seconds, "ended": code, "did_nothing": did_nothing, "notes": notes})

    def withdraw(self) -> None:
        """This start was refused: its lines are removed."""
        if not self._anew:
            with contextlib.suppress(OSError):
                if self._size:
                    os.truncate(self.path, self._size)
                else:
                    self.path.unlink(missing_ok=True)

    def _write(self, line: dict[str, Any]) -> None:
        """Append a line; a full disk does not stop the run. A run that begins anew keeps its lines until `commit`."""
        if self._anew:
            self._lines.append(line)
            return
        with contextlib.suppress(OSError), open(self.path, "a", encoding="utf-8") as file:
            file.write(json.dumps(line) + "\n")


def _read(path: Path) -> list[dict[str, Any]]:
    """The complete lines of a file; one that a kill has cut off is left out."""
    try:
        text = read_plain(path, _MOST_BYTES).decode("utf-8", "replace")
    except OSError:
        return []
    found = []
    for line in text.splitlines():
        with contextlib.suppress(ValueError, RecursionError):
            entry = json.loads(line)
            if isinstance(entry, dict):
                found.append(entry)
    if found and not {"began", "seconds_before", "restarts_before"} <= found[0].keys():
        return []
    return found


def _last_sign(folder: Path, start: dict[str, Any]) -> float:
    """Seconds from the beginning of a start to the last line of the log, by the clock on the wall."""
    with contextlib.suppress(OSError):
        return max(0.0, (folder / "run.log").stat().st_mtime - start["began"])
    return 0.0


def _idle(starts: list[dict[str, Any]]) -> int:
    """How many of the last starts did nothing, one after the other."""
    count = 0
    for start in reversed(starts):
        if not start.get("did_nothing"):
            break
        count += 1
    return count
