"""Files that have an end: opening a pipe can wait for ever, and reading a device need never be over."""

from __future__ import annotations

import errno
import os
import stat
from pathlib import Path
from typing import BinaryIO

_KINDS = (
    (stat.S_ISFIFO, "a pipe (FIFO)"),
    (stat.S_ISSOCK, "a socket"),
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
)


class NotPlain(OSError):
    """What is there is no file that can be read to its end; ``strerror`` says what it is."""


def strange_kind(path: str | Path) -> str | None:
    """Return what a name leads to in words, a pipe, a socket or a device; None for files, folders and nothing."""
    try:
        mode = os.stat(path).st_mode
    except OSError:
        return None
    return next((words for test, words in _KINDS if test(mode)), None)


def open_plain(path: str | Path) -> BinaryIO:
    """Open a file to read its bytes; never waits.

    Raises
    ------
    NotPlain, OSError
    """
    descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    mode = os.fstat(descriptor).st_mode
    if not stat.S_ISREG(mode):
        os.close(descriptor)
        if stat.S_ISDIR(mode):
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
        words = next((words for test, words in _KINDS if test(mode)), "something else")
        raise NotPlain(errno.EINVAL, f"it is {words}, not a file", str(path))
    return open(descriptor, "rb")


def read_plain(path: str | Path, most: int) -> bytes:
    """Return the bytes of a file with an end.

    Parameters
    ----------
    most : int
        Bytes that no such file has; files of the system have no size before they are read.

    Raises
    ------
    NotPlain
        Also for a file with more bytes.
    OSError
    """
    with open_plain(path) as file:
        content = file.read(most + 1)
    if len(content) > most:
        raise NotPlain(errno.EFBIG, f"it has more than {most:,} bytes", str(path))
    return content
