"""Folders of which nobody but this user can change the content: compiled code is loaded from them and run.

Nothing here imports mpi4py, numpy or numba: the folder has to be known before they load.
"""

from __future__ import annotations

import contextlib
import grp
import os
import pwd
import shutil
import stat
import tempfile
from pathlib import Path

#: Owner and nobody else may enter.
PRIVATE = 0o700
_WRITABLE_BY_OTHERS = stat.S_IWGRP | stat.S_IWOTH


def make_private(folder: Path) -> str | None:
    """Make a folder that only this user can enter, or see to it that one which is there already is such a folder.

    A folder of this user that others could write is closed and emptied: nobody knows who left what is in it.

    Parameters
    ----------
    folder : Path
        Absolute, without links: what is above it is looked at too. What is missing is made, for this user alone.

    Returns
    -------
    str or None
        Why the folder does not serve, in words that follow its name; None if it does.
    """
    if not folder.is_absolute():
        return "is not an absolute path"
    try:
        for above in reversed(folder.parents):
            with contextlib.suppress(FileExistsError):
                os.mkdir(above, PRIVATE)
            if reason := why_others_decide(above):
                return f"is not safe: {above} {reason}"
        with contextlib.suppress(FileExistsError):
            os.mkdir(folder, PRIVATE)
        return _close(folder)
    except OSError as error:
        return f"cannot be used: {error.strerror or error}"


def why_others_decide(folder: Path) -> str | None:
    """Return why another user can put something else in the place of what a folder holds; None if nobody can.

    Nobody can where root or this user owns it and no one else may write into it, or where only owners may remove their
    files (the sticky bit of ``/tmp``).
    """
    found = os.lstat(folder)
    if not stat.S_ISDIR(found.st_mode):
        return "is not a folder"
    if found.st_uid not in (0, os.geteuid()) and not _stands_for_root(found.st_uid):
        return f"belongs to {_user(found.st_uid)}"
    if found.st_mode & stat.S_ISVTX or not found.st_mode & _WRITABLE_BY_OTHERS:
        return None
    if not found.st_mode & stat.S_IWOTH and _is_private_group(found.st_gid):
        return None
    return f"can be written by others (mode {stat.S_IMODE(found.st_mode):04o})"


def make_fresh() -> Path | None:
    """Make a private folder under a name that nobody can guess, in a temporary folder that is safe; None if none is."""
    for place in dict.fromkeys((tempfile.gettempdir(), "/var/tmp", "/dev/shm")):
        above = Path(os.path.realpath(place))
        with contextlib.suppress(OSError):
            if not any(why_others_decide(folder) for folder in (above, *above.parents)):
                return Path(tempfile.mkdtemp(prefix="pdfem_mpi-", dir=above))
    return None


def is_own_file(descriptor: int) -> bool:
    """Return whether an open file is this user's (or root's) and no stranger may write it."""
    found = os.fstat(descriptor)
    return found.st_uid in (0, os.geteuid()) and not found.st_mode & stat.S_IWOTH


def _close(place: Path) -> str | None:
    """Shut a folder to others; what they could have left in it goes first."""
    descriptor = os.open(place, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
    try:
        found = os.fstat(descriptor)
        if found.st_uid != os.geteuid():
            return f"is not safe: it belongs to {_user(found.st_uid)}"
        os.fchmod(descriptor, PRIVATE)
        if found.st_mode & _WRITABLE_BY_OTHERS:
            for entry in os.scandir(descriptor):
                if entry.is_dir(follow_symlinks=False):
                    shutil.rmtree(entry.name, dir_fd=descriptor)
                else:
                    os.unlink(entry.name, dir_fd=descriptor)
        probe = f".probe.{os.getpid()}"  # a read-only or full disk shows here
        os.close(os.open(probe, os.O_CREAT | os.O_WRONLY | os.O_TRUNC | os.O_NOFOLLOW, 0o600, dir_fd=descriptor))
        os.unlink(probe, dir_fd=descriptor)
    finally:
        os.close(descriptor)
    return None


def _is_private_group(group: int) -> bool:
    """Return whether a group is the one that many systems give to each user, with nobody else in it."""
    with contextlib.suppress(KeyError):
        user, entry = pwd.getpwuid(os.geteuid()), grp.getgrgid(group)
        return entry.gr_name == user.pw_name and group == user.pw_gid and set(entry.gr_mem) <= {user.pw_name}
    return False


def _stands_for_root(owner: int) -> bool:
    """Return whether an owner is the number that a user namespace shows for everybody outside of it, root included."""
    try:
        whole = Path("/proc/self/uid_map").read_text(encoding="ascii").split() == ["0", "0", "4294967295"]
        overflow = int(Path("/proc/sys/kernel/overflowuid").read_text(encoding="ascii"))
    except (OSError, ValueError):
        return False
    return not whole and owner == overflow


def _user(number: int) -> str:
    with contextlib.suppress(KeyError):
        return pwd.getpwuid(number).pw_name
    return f"user {number}"
