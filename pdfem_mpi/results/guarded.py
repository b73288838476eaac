"""HDF5 files whose write errors are raised once, when the file is closed.

HDF5 that cannot write (a full disk) does not close its file either: the space of the file stays taken after it was
removed, and the process ends in a segmentation fault. So HDF5 writes through an object that keeps the first error to
itself; the error is raised after HDF5 has let go of the file. A file that HDF5 cannot open through such an object would
stay with it, and end the process in a segmentation fault as well: it is opened as a plain file first.
"""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import h5py


class _Sink:
    """An unbuffered file for h5py; after an error nothing more is written, and nothing more is said."""

    def __init__(self, path: Path, mode: str):
        self.file = open(path, {"w": "w+b", "r+": "r+b"}[mode], buffering=0)  # noqa: SIM115 - closed by `guarded`
        self.error: OSError | None = None

    def seek(self, *position: int) -> int:
        return self.file.seek(*position)

    def tell(self) -> int:
        return self.file.tell()

    def read(self, size: int = -1) -> bytes:  # h5py knows a file by it
        return self.file.read(size)

    def readinto(self, buffer) -> int:
        return self.file.readinto(buffer)

    def write(self, data) -> int:
        with memoryview(data).cast("B") as view:
            written = 0
            while self.error is None and written < len(view):
                try:
                    written += self.file.write(view[written:])
                except OSError as error:
                    self.error = error
            return len(view)

    def truncate(self, size: int | None = None) -> int | None:
        if self.error is None:
            try:
                self.file.truncate(size)
            except OSError as error:
                self.error = error
        return size

    def flush(self) -> None:
        pass


@contextmanager
def guarded(path: str | Path, mode: str, *, synced: bool = False, **options: Any) -> Iterator[h5py.File]:
    """Open an HDF5 file for writing; it is closed when the block ends, whatever happened.

    Parameters
    ----------
    path : str or Path
    mode : "w" or "r+"
    synced : bool
        Make the operating system write it to the disk before it is closed.
    options
        Of ``h5py.File``.

    Raises
    ------
    OSError
        At once: the file cannot be opened. At the end of the block: the first error of writing, with the file's name.
    """
    if mode == "r+":
        with h5py.File(path, "r", locking=False):
            pass
    sink = _Sink(Path(path), mode)
    try:
        with h5py.File(sink, mode, **options) as file:
            yield file
        if synced and sink.error is None:
            os.fsync(sink.file.fileno())
    except OSError as error:
        sink.error = sink.error or error
    finally:
        sink.file.close()
    if sink.error is not None:
        raise OSError(sink.error.errno, sink.error.strerror or str(sink.error), str(path)) from None
