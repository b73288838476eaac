"""``RUNNING``: the file that keeps a second job out of a run folder."""

from __future__ import annotations

import contextlib
import errno
import json
import os
import socket
from pathlib import Path
from typing import Any

from pdfem_mpi.system.plain_files import read_plain

NAME = "RUNNING"
MOST_BYTES = 1 << 16


class Locked(Exception):
    """Another job writes into the folder; the sentence says which, and the remedy."""


class Lock:
    """A run folder that is this process' own until `release`.

    Parameters
    ----------
    folder : Path
        It must exist.
    job : str
        The batch system's number of the job, for whoever reads the file.
    steal : bool
        Take the folder from a job that cannot be asked: on another host, or of an unreadable file.

    Attributes
    ----------
    note : str or None
        What was found of a job that did not end by itself.

    Raises
    ------
    Locked
        A job that lives, or may live, has the folder.
    OSError
        The file cannot be written.
    """

    def __init__(self, folder: Path, job: str = "", steal: bool = False):
        self.path = folder / NAME
        self.note: str | None = None
        mine = {"host": socket.gethostname(), "pid": os.getpid(), "started": started(os.getpid()), "job": job}
        self._text = json.dumps(mine) + "\n"
        for _ in range(3):
            try:
                self._create()
                return
            except FileExistsError:
                self._remove_stale(steal)
        raise Locked(f"{self.path}: other jobs are starting in this folder. Use another folder with --out.")

    def release(self) -> None:
        """Remove the file, if it still is this job's."""
        with contextlib.suppress(OSError):
            if _read(self.path) == self._text:
                self.path.unlink()

    def _create(self) -> None:
        """Create the file with its text at once, so that a kill cannot leave one without."""
        whole = self.path.with_name(f"{NAME}.{os.getpid()}")
        try:
            whole.unlink(missing_ok=True)
            with open(whole, "x", encoding="utf-8") as file:
                file.write(self._text)
            os.link(whole, self.path)
        except FileExistsError:
            raise
        except OSError as error:
            if error.errno not in (errno.EPERM, errno.EOPNOTSUPP, errno.EMLINK):
                raise
            with open(self.path, "x", encoding="utf-8") as file:  # a file system without links
                file.write(self._text)
        finally:
            whole.unlink(missing_ok=True)

    def _remove_stale(self, steal: bool) -> None:
        """Remove the file of a job that is gone. It is moved aside first: of two jobs that try, one gets it."""
        try:
            text = _read(self.path)
        except FileNotFoundError:
            return
        owner = _parse(text)
        if alive(owner) is not False and not steal:
            who = _describe(owner)
            raise Locked(
                f"{self.path}: {who} writes into this folder. Wait for its end or use another folder with --out; if it "
                "is surely gone, add --steal-lock."
            )
        aside = self.path.with_name(f"{NAME}.{os.getpid()}")
        with contextlib.suppress(FileNotFoundError):
            os.rename(self.path, aside)
            if _read(aside) == text:
                self.note = f"the folder was left by {_describe(owner)}, which did not end by itself"
            else:  # another job was faster, and this is its file
                with contextlib.suppress(OSError):
                    os.link(aside, self.path)
            aside.unlink()


def owner_of(folder: Path) -> tuple[str, bool | None] | None:
    """Which job holds a folder, in words, and whether it lives (None: unknown); None if no job does."""
    try:
        owner = _parse(_read(folder / NAME))
    except OSError:
        return None
    return _describe(owner), alive(owner)


def alive(owner: dict[str, Any]) -> bool | None:
    """Whether the process lives; None if that cannot be seen from this host."""
    if owner.get("host") != socket.gethostname() or not isinstance(owner.get("pid"), int):
        return None
    now = started(owner["pid"])
    if now is not None:
        return now == owner.get("started")
    try:
        os.kill(owner["pid"], 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        return True
    return True


def started(pid: int) -> str | None:
    """When a process began: boot and clock ticks since; None if there is none. A reused pid began at another time."""
    try:
        ticks = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8", errors="replace").rpartition(")")[2].split()[19]
        boot = Path("/proc/sys/kernel/random/boot_id").read_text(encoding="utf-8").strip()
    except (OSError, IndexError):
        return None
    return f"{boot} {ticks}"


def _read(path: Path) -> str:
    return read_plain(path, MOST_BYTES).decode("utf-8", "replace")


def _parse(text: str) -> dict[str, Any]:
    try:
        owner = json.loads(text)
    except ValueError:
        return {}
    return owner if isinstance(owner, dict) else {}


def _describe(owner: dict[str, Any]) -> str:
    if not owner:
        return "a job that left no name"
    job = f" (job {owner['job']})" if owner.get("job") else ""
    return f"process {owner.get('pid')} on {owner.get('host')}{job}"
