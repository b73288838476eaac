"""The numbers of a section of a Gmsh file, in text or binary, handed out one after the other."""

from __future__ import annotations

import warnings

import numpy as np

from pdfem_mpi.mesh.raw import Refusal, excerpt

#: Whole numbers beyond this are not exact in double precision, and no file has so many nodes.
LARGEST_NUMBER = 2**53


class TextNumbers:
    """Numbers of a section in text.

    Parameters
    ----------
    name : str
        Of the section, as ``$Nodes``.
    text : bytes
    line : int
        Of the first line of the text in the file.
    """

    def __init__(self, name: str, text: bytes, line: int) -> None:
        self.name, self.text, self.line, self.place = name, text, line, 0
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            try:
                self.values = np.fromstring(text, np.float64, sep=" ")
            except (DeprecationWarning, ValueError):
                raise Refusal(self._rubbish()) from None

    def _rubbish(self) -> str:
        for number, row in enumerate(self.text.splitlines(), start=self.line):
            for item in row.split():
                try:
                    float(item)
                except ValueError:
                    what = f"{excerpt(item)} is no number, in the section {self.name}"
                    return f"line {number}: {what}. Write the mesh again."
        return f"the section {self.name} does not hold numbers only. Write the mesh again."

    def where(self) -> str:
        """The line of the next number, for messages."""
        seen = 0
        for number, row in enumerate(self.text.splitlines(), start=self.line):
            seen += len(row.split())
            if seen > self.place:
                return f"line {number}: "
        return f"line {self.line + len(self.text.splitlines()) - 1}: "

    @property
    def left(self) -> int:
        """How many numbers there are still."""
        return len(self.values) - self.place

    def reals(self, count: int) -> np.ndarray:
        """The next numbers; float64."""
        if not 0 <= count <= self.left:
            raise Refusal(_too_short(self, count))
        self.place += count
        return self.values[self.place - count : self.place]

    def peek(self, count: int) -> np.ndarray:
        """The next numbers, at most so many, which stay where they are; float64."""
        return self.values[self.place : self.place + count]

    def ints(self, count: int) -> np.ndarray:
        """The next numbers as whole ones; int64."""
        values = self.reals(count)
        wrong = ~(np.abs(values) <= LARGEST_NUMBER) | (values != np.floor(values))
        if wrong.any():
            self.place -= count - int(np.flatnonzero(wrong)[0])
            raise Refusal(
                f"{self.where()}{self.values[self.place]:.17g} is not a whole number that a node, an element or a "
                "count "
                f"can be, in the section {self.name}. Write the mesh again."
            )
        return values.astype(np.int64)

    sizes = ints

    def rows(self, count: int, layout: str) -> tuple[np.ndarray, ...]:
        """Rows of ``i`` (int), ``n`` (size) and ``d`` (double): a table (count, k) for each run of a letter."""
        width = len(layout)
        if not 0 <= count <= self.left // max(width, 1):
            raise Refusal(_too_short(self, count * width))
        start, tables, at = self.place, [], 0
        table = self.values[start : start + count * width].reshape(count, width)
        for letter, length in _runs(layout):
            part = table[:, at : at + length]
            if letter != "d":
                bad = ~(np.abs(part) <= LARGEST_NUMBER) | (part != np.floor(part))
                if bad.any():
                    row, column = np.argwhere(bad)[0]
                    self.place = start + row * width + at + column
                    self.ints(1)
                part = part.astype(np.int64)
            tables.append(part)
            at += length
        self.place = start + count * width
        return tuple(tables)

    def finish(self) -> None:
        """Refuse what the section holds beyond what it declares."""
        if self.left:
            raise Refusal(
                f"{self.where()}the section {self.name} holds {self.left} numbers more than it declares. Write the "
                "mesh "
                "again."
            )


class BinaryNumbers:
    """Numbers of a section in binary; `content` is the whole file, and `place` where the next number begins."""

    def __init__(self, name: str, content: bytes, place: int, swapped: bool) -> None:
        self.name, self.content, self.place = name, content, place
        order = ">" if swapped else "<"
        self.types = {"i": np.dtype(f"{order}i4"), "n": np.dtype(f"{order}u8"), "d": np.dtype(f"{order}f8")}

    def where(self) -> str:
        """The byte of the next number, for messages."""
        return f"byte {self.place}: "

    def _next(self, letter: str, count: int) -> np.ndarray:
        dtype = self.types[letter]
        if not 0 <= count <= (len(self.content) - self.place) // dtype.itemsize:
            raise Refusal(_too_short(self, count))
        values = np.frombuffer(self.content, dtype, count, self.place)
        self.place += count * dtype.itemsize
        return values

    def reals(self, count: int) -> np.ndarray:
        """The next doubles; float64."""
        return self._next("d", count).astype(np.float64)

    def ints(self, count: int) -> np.ndarray:
        """The next ints; int64."""
        return self._next("i", count).astype(np.int64)

    def sizes(self, count: int) -> np.ndarray:
        """The next sizes; int64."""
        return self._whole(self._next("n", count))

    def _whole(self, values: np.ndarray) -> np.ndarray:
        if (values > LARGEST_NUMBER).any():
            raise Refusal(
                f"{self.where()}the section {self.name} has a number of a node or element, or a count, of "
                f"{int(values.max())}. Write the mesh again."
            )
        return values.astype(np.int64)

    def rows(self, count: int, layout: str) -> tuple[np.ndarray, ...]:
        """Rows of a layout, as in text."""
        runs = _runs(layout)
        row = np.dtype([(str(k), self.types[letter], (length,)) for k, (letter, length) in enumerate(runs)])
        if not 0 <= count <= (len(self.content) - self.place) // max(row.itemsize, 1):
            raise Refusal(_too_short(self, count))
        table = np.frombuffer(self.content, row, count, self.place)
        self.place += count * row.itemsize
        parts = [table[str(k)] for k in range(len(runs))]
        return tuple(
            part.astype(np.float64) if letter == "d" else self._whole(part) if letter == "n" else part.astype(np.int64)
            for part, (letter, _) in zip(parts, runs, strict=True)
        )

    def finish(self) -> None:
        """Refuse a section that does not end where its numbers do."""
        after = self.content[self.place : self.place + len(self.name) + 8].lstrip()
        if not after.startswith(b"$End" + self.name[1:].encode()):
            raise Refusal(
                f"{self.where()}the section {self.name} does not end where its counts say. Write the mesh again."
            )


def _runs(layout: str) -> list[tuple[str, int]]:
    """Equal letters that follow each other: ``niii`` to ``[("n", 1), ("i", 3)]``."""
    runs: list[tuple[str, int]] = []
    for letter in layout:
        if runs and runs[-1][0] == letter:
            runs[-1] = letter, runs[-1][1] + 1
        else:
            runs.append((letter, 1))
    return runs


def _too_short(numbers: TextNumbers | BinaryNumbers, count: int) -> str:
    return (
        f"{numbers.where()}the section {numbers.name} ends before the {count} numbers that it declares here. It was "
        "cut "
        "off, or a count is wrong: write the mesh again."
    )
