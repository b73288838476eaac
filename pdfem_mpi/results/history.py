"""history.csv: one row per load step or event, every number with all its digits."""

import csv
import hashlib
import io
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Self

import numpy as np

WALL_SECONDS = "wall_seconds"
#: The column of history.csv that holds words; all others are numbers.
WORDS = "event"


class History:
    """A CSV file that grows by one row at a time; the ``wall_seconds`` column is always the last one.

    Floats are written by ``repr`` (they read back as the same bits), None as an empty field. The file is
    closed between rows, so each row has reached the operating system when ``append`` returns.

    Parameters
    ----------
    path : str or Path
        The file; an existing one is replaced.
    columns : iterable of str
        Names in order; ``wall_seconds``, listed or not, goes last.

    Attributes
    ----------
    columns : tuple of str
    rows : int
        Rows in the file, the header not counted.
    size : int
        Bytes in the file.
    sha256 : str
        Digest of these bytes, as they were written.
    """

    def __init__(self, path: str | Path, columns: Iterable[str]) -> None:
        self._name(path, columns)
        line = _line(self.columns)
        self.path.write_bytes(line)
        self.rows, self.size, self._hash = 0, len(line), hashlib.sha256(line)

    @property
    def sha256(self) -> str:
        """Digest of the file's bytes."""
        return self._hash.hexdigest()

    @classmethod
    def reopen(
        cls, path: str | Path, columns: Iterable[str], rows: int, size: int | None = None, sha256: str | None = None
    ) -> Self:
        """Continue an existing file after its first ``rows`` rows; whatever follows them is cut off.

        Columns that the file does not have yet are empty in these rows.

        Parameters
        ----------
        size, sha256 : int, str or None
            Bytes of these rows and of the header, and their digest, if they are known.

        Raises
        ------
        ValueError
            The file has columns that are not asked for, fewer complete rows, or is not what was written. It is left as
            it was.
        """
        history = cls.__new__(cls)
        history._name(path, columns)
        with history.path.open("r+b") as file:
            lines = read_rows(file, path, rows, size, sha256)
            if lines[0] != _line(history.columns):
                lines = _widened(lines, history.columns, path)
                file.seek(0)
                file.write(b"".join(lines))
            history.rows, history.size = rows, sum(map(len, lines))
            history._hash = hashlib.sha256(b"".join(lines))
            file.truncate(history.size)
        return history

    def append(self, row: Mapping[str, Any]) -> None:
        """Write one row, which names every column and no other.

        Raises
        ------
        ValueError
            A missing or unknown column, or text with a line break. Nothing is written then.
        """
        missing = [name for name in self.columns if name not in row]
        unknown = [name for name in row if name not in self.columns]
        if missing or unknown:
            raise ValueError(f"{self.path}: row with missing columns {missing} and unknown columns {unknown}")
        line = _line(_text(row[name]) for name in self.columns)
        with self.path.open("ab") as file:
            file.write(line)
        self.rows += 1
        self.size += len(line)
        self._hash.update(line)

    def last(self) -> dict[str, str] | None:
        """Return the last row as text by column; None if there is none."""
        with self.path.open(newline="", encoding="utf-8") as file:
            row = None
            for row in csv.DictReader(file):  # noqa: B007 - the last one stays
                pass
        return row

    def _name(self, path: str | Path, columns: Iterable[str]) -> None:
        self.path = Path(path)
        self.columns = (*(name for name in columns if name != WALL_SECONDS), WALL_SECONDS)
        if len(set(self.columns)) < len(self.columns):
            raise ValueError(f"{self.path}: a column is named twice in {list(self.columns)}")


def read_rows(file, path: str | Path, rows: int, size: int | None, sha256: str | None) -> list[bytes]:
    """Return the header and the first rows of an open history, after a check that they are what was written.

    Raises
    ------
    ValueError
    """
    lines = [file.readline() for _ in range(rows + 1)]
    if not lines[-1].endswith(b"\n"):
        complete = max(sum(line.endswith(b"\n") for line in lines) - 1, 0)
        raise ValueError(f"{path}: has {complete} complete rows, expected at least {rows}")
    found = sum(map(len, lines))
    if size is not None and found != size:
        raise ValueError(f"{path}: its {rows} rows have {found} bytes, {size} when they were written")
    if sha256 is not None and hashlib.sha256(b"".join(lines)).hexdigest() != sha256:
        raise ValueError(f"{path}: its {rows} rows are not those that were written")
    return lines


def read_history(path: str | Path) -> dict[str, np.ndarray]:
    """The columns of a history.csv: float64 with NaN where a field is empty, and words in the column ``event``.

    Raises
    ------
    OSError, ValueError
        The file cannot be read, or a field is no number.
    """
    return read_columns(path, WORDS)


def read_columns(path: str | Path, words: str) -> dict[str, np.ndarray]:
    """The columns of a CSV file: numbers, NaN where a field is empty, but for one column of words."""
    with Path(path).open(newline="", encoding="utf-8") as file:
        reader = csv.DictReader(file)
        rows = list(reader)
        names = reader.fieldnames or ()
    return {
        name: np.array([row[name] for row in rows], str)
        if name == words
        else np.array([float(row[name]) if row[name] else np.nan for row in rows])
        for name in names
    }


def _widened(lines: list[bytes], columns: tuple[str, ...], path: str | Path) -> list[bytes]:
    """The same rows with more columns, which are empty.

    Raises
    ------
    ValueError
        The rows have columns that are not asked for.
    """
    rows = list(csv.DictReader(io.StringIO(b"".join(lines).decode())))
    if not set(rows[0] if rows else csv.DictReader(io.StringIO(lines[0].decode())).fieldnames or ()) <= set(columns):
        raise ValueError(f"{path}: other columns than {', '.join(columns)}")
    return [_line(columns), *(_line(row.get(name, "") for name in columns) for row in rows)]


def _text(value: Any) -> str:
    """Return the field of one value: ``repr`` of a float, nothing for None."""
    if value is None:
        return ""
    if isinstance(value, (float, np.floating)):
        return repr(float(value))
    if isinstance(value, (bool, np.bool_)):
        return "true" if value else "false"
    text = str(value)
    if "\n" in text or "\r" in text:
        raise ValueError(f"a history field cannot hold a line break: {text!r}")
    return text


def _line(fields: Iterable[str]) -> bytes:
    """Return one line of the file, fields quoted where CSV asks for it."""
    line = io.StringIO()
    csv.writer(line, lineterminator="\n").writerow(fields)
    return line.getvalue().encode()
