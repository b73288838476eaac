"""Checkpoint files: tables in global order and a header, written so that one complete verified file always exists.

A file is HDF5 (format v110, whose metadata have checksums; every dataset with fletcher32), after a seal of 512 bytes
that holds the format's number and the sha256 of all that follows: a changed bit, a missing byte or a file from
elsewhere is known before a number is read. HDF5's own tools open it as any other file.

    seal            "pdfem_mpi checkpoint", format, sha256
    header          JSON as bytes: what ran, where it was, what the results were then
    points/u ...    float64 (n, 3): the fields of the state on free points, in the order of cells, 8 each
    nodes/u ...     float64 (n, 3): the same on nodes
    broken          uint32 or uint64 (n, 2): bonds broken so far, point ids i < j, sorted; ids are 8 times the number
                    of the cell in the mesh, and 0 to 7 (format 1: its number among the cells with points);
                    (n, 3): with their teeth, where bonds soften

Broken bonds are pairs and not bits over all bonds: pairs need no enumeration of all bonds, which no rank has, and the
file stays small until most of the body is rubble (docs/restart.md has the sizes).

Protocol of a write, by rank 0: a temporary name in the same folder; close and fsync; open again and read everything;
seal and fsync; rename; fsync the folder; only then remove what is older than the newest few. Not MPI's business: the
collective side is restart.py.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import re
import stat
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import h5py
import numpy as np

from pdfem_mpi.results.checkpoint_content import find_fault
from pdfem_mpi.results.checkpoint_files import FORMAT
from pdfem_mpi.results.guarded import guarded
from pdfem_mpi.results.own_storage import elsewhere
from pdfem_mpi.system import faults
from pdfem_mpi.system.files import sync

MAGIC = b"pdfem_mpi checkpoint\n"
SEAL = 512
HEADER = "header"
ROWS_PER_CHUNK = 65536
BLOCK = 1 << 22


class Invalid(Exception):
    """A file that is no sound checkpoint of this program, and why.

    Attributes
    ----------
    newer : bool
        It was written by a later version of the program.
    """

    def __init__(self, reason: str, newer: bool = False):
        self.newer = newer
        super().__init__(reason)


class Shape(NamedTuple):
    """Rows and type of a table."""

    rows: int
    width: int
    dtype: np.dtype


class Writer:
    """Writes one checkpoint; errors are kept until `finish`, so that who sends the rows need not know.

    Parameters
    ----------
    path : Path
        Final name; its folder must exist.
    tables : mapping of name to (rows, width, dtype)
    job : str
        Ends the temporary name.

    Attributes
    ----------
    error : Exception or None
        The first error. After one, nothing more is written.
    """

    def __init__(self, path: Path, tables: Mapping[str, tuple[int, int, np.dtype]], job: str):
        self.path, self.temporary = path, path.with_name(f"{path.name}.tmp.{job}")
        self.error: Exception | None = None
        self._tables = {name: Shape(*shape) for name, shape in tables.items()}
        self._stack = contextlib.ExitStack()
        self._file: h5py.File | None = None
        try:
            self.temporary.unlink(missing_ok=True)  # a link or a pipe of that name must not be written through
            options = {"libver": ("v110", "v110"), "userblock_size": SEAL, "synced": True}
            self._file = self._stack.enter_context(guarded(self.temporary, "w", **options))
            for name, shape in self._tables.items():
                _create(self._file, name, shape)
        except (OSError, RuntimeError) as error:
            self.error = error

    def write_rows(self, name: str, first: int, rows: np.ndarray) -> None:
        """Write rows ``first, first + 1, ...`` of a table, shape (n, width)."""
        if self.error is not None or not len(rows):
            return
        try:
            self._file[name][first : first + len(rows)] = rows
        except (OSError, RuntimeError) as error:
            self.error = error

    def finish(self, header: Mapping[str, Any], beat: Callable[[], None] = bool) -> int:
        """Close, verify, seal and rename; return the file's bytes. ``beat`` is called now and then.

        Raises
        ------
        OSError, RuntimeError, Invalid
            The temporary file is removed then, and older checkpoints are as they were.
        """
        try:
            text = json.dumps(header).encode()
            if self.error is None:
                data = np.frombuffer(text, np.uint8)
                _create(self._file, HEADER, Shape(len(data), 0, data.dtype))
                self._file[HEADER][:] = data
            faults.begin("close")
            self._close()
            faults.begin("verify")
            _read_everything(self.temporary, text, self._tables, beat)
            _seal(self.temporary, beat)
            size = self.temporary.stat().st_size
            faults.begin("replace")
            os.replace(self.temporary, self.path)
            sync(self.path.parent)
            return size
        finally:
            self.discard()

    def discard(self) -> None:
        """Close, and remove the temporary file if it is there."""
        with contextlib.suppress(OSError, RuntimeError):
            self._close()
        with contextlib.suppress(OSError):
            self.temporary.unlink(missing_ok=True)

    def _close(self) -> None:
        self._file = None
        self._stack.close()
        if self.error is not None:
            raise self.error


def _create(file: h5py.File, name: str, shape: Shape) -> None:
    """A table in equal chunks; empty ones have none."""
    size = (shape.rows, shape.width) if shape.width else (shape.rows,)
    if not shape.rows:
        file.create_dataset(name, size, shape.dtype)
        return
    n_chunks = -(-shape.rows // ROWS_PER_CHUNK)
    chunk = (-(-shape.rows // n_chunks), *size[1:])
    file.create_dataset(name, size, shape.dtype, chunks=chunk, fletcher32=True)


def _read_everything(path: Path, header: bytes, tables: Mapping[str, Shape], beat: Callable[[], None]) -> None:
    """Read a file that was just written: checksums, sizes and header.

    Raises
    ------
    OSError
        Something is not what was written.
    """
    try:
        with h5py.File(path, "r", locking=False) as file:
            if file[HEADER][:].tobytes() != header:
                raise OSError("its header reads back otherwise")
            for name, shape in tables.items():
                if file[name].shape != (shape.rows, shape.width):
                    raise OSError(f"{name} reads back with shape {file[name].shape}")
                for first in range(0, shape.rows, ROWS_PER_CHUNK):
                    file[name][first : first + ROWS_PER_CHUNK]
                    beat()
    except (KeyError, ValueError, RuntimeError) as error:
        raise OSError(f"it does not read back: {error}") from None


def _seal_of(file, number: int = FORMAT, *, beat: Callable[[], None] = bool) -> bytes:
    """The seal of what follows the first bytes of an open file; the format's number is sealed too."""
    total = hashlib.sha256(f"{number}".encode())
    file.seek(SEAL)
    while block := file.read(BLOCK):
        total.update(block)
        beat()
    return (MAGIC + f"format {number}\nsha256 {total.hexdigest()}\n".encode()).ljust(SEAL, b"\0")


def _seal(path: Path, beat: Callable[[], None] = bool) -> None:
    with open(path, "r+b", buffering=0) as file:
        seal = _seal_of(file, beat=beat)
        file.seek(0)
        if file.write(seal) != SEAL:
            raise OSError("its seal could not be written")
        os.fsync(file.fileno())


def check(path: Path) -> dict[str, Any]:
    """Read all of a checkpoint, and return its header.

    Raises
    ------
    Invalid
        It is not there, cannot be read, is damaged, incomplete, of another program or of a newer format.
    """
    try:
        if not stat.S_ISREG(os.stat(path).st_mode):
            raise Invalid("it is not a file")
        with open(path, "rb") as file:
            seal = file.read(SEAL)
            if not seal:
                raise Invalid("it is empty")
            if not seal.startswith(MAGIC):
                cut = MAGIC.startswith(seal)
                raise Invalid("it is cut off" if cut else "it is no checkpoint of pdfem_mpi, or its start is damaged")
            match = re.match(rb"format (\d{1,6})\n", seal[len(MAGIC) :])
            number = int(match[1]) if match else FORMAT
            if _seal_of(file, number) != seal:
                raise Invalid("it is damaged or cut off: its sha256 is not the one it was sealed with")
            if number > FORMAT:
                raise Invalid(f"it has format {number}, of a newer pdfem_mpi; this one reads {FORMAT}", newer=True)
        with h5py.File(path, "r", locking=False) as file:
            if reason := elsewhere(file):
                raise Invalid(f"it {reason}")
            header = json.loads(file[HEADER][:].tobytes())
            if reason := find_fault(file, header):
                raise Invalid(reason)
            return header
    except FileNotFoundError:
        raise Invalid("there is no such file") from None
    except OSError as error:
        raise Invalid(f"it cannot be read: {error.strerror or error}") from None
    except (KeyError, ValueError, RuntimeError, TypeError, AttributeError, RecursionError) as error:
        raise Invalid(f"it cannot be read: {error}") from None


class Reader:
    """The tables of a checkpoint that `check` found sound."""

    def __init__(self, file: h5py.File):
        self._file = file

    def shape(self, name: str) -> tuple[int, ...] | None:
        """Shape of a table; None where there is none."""
        return self._file[name].shape if name in self._file else None

    def rows(self, name: str) -> int:
        """Length of a table; 0 where there is none."""
        return len(self._file[name]) if name in self._file else 0

    def read_rows(self, name: str, first: int, last: int) -> np.ndarray:
        """Rows ``first .. last - 1`` of a table."""
        return self._file[name][first:last]


@contextlib.contextmanager
def open_checkpoint(path: Path) -> Iterator[Reader]:
    """Open a checkpoint to read its tables.

    Raises
    ------
    OSError
        Also for what HDF5 does not call so.
    """
    try:
        with h5py.File(path, "r", locking=False) as file:
            yield Reader(file)
    except (KeyError, ValueError, RuntimeError) as error:
        raise OSError(f"{path}: {error}") from None
