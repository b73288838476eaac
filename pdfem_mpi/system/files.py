"""Files that appear whole or not at all: written under a temporary name, flushed to disk, then renamed."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def replacing(path: str | Path) -> Iterator[Path]:
    """Give a temporary path beside ``path`` and rename it to ``path`` when the block ends without an error.

    After an error the temporary file is removed and an older file of that name is left as it was.

    Parameters
    ----------
    path : str or Path
        Final name of the file; its folder must exist.

    Yields
    ------
    Path
        ``path`` with ``.tmp`` added: the block writes this file and closes it.
    """
    path = Path(path)
    temporary = path.with_name(path.name + ".tmp")
    # what a killed process left, or a link or a pipe of that name, must not be written through
    temporary.unlink(missing_ok=True)
    try:
        yield temporary
        sync(temporary)
        os.replace(temporary, path)
        sync(path.parent)
    finally:
        temporary.unlink(missing_ok=True)


def sync(path: str | Path) -> None:
    """Make the operating system write a file, or the entries of a folder, to the disk now."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
