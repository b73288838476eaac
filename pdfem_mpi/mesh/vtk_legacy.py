"""VTK legacy files (.vtk): an unstructured grid in text or binary, with its integer arrays."""

from __future__ import annotations

import re
import warnings

import numpy as np

from pdfem_mpi.mesh.raw import RawMesh, Refusal, excerpt
from pdfem_mpi.mesh.vtk_cells import add_cell_array, add_point_array, make_mesh, whole

TYPES = {
    "unsigned_char": "u1", "char": "i1", "short": "i2", "unsigned_short": "u2", "int": "i4", "unsigned_int": "u4",
    "long": "i8", "unsigned_long": "u8", "float": "f4", "double": "f8", "vtkidtype": "i4", "vtktypeint64": "i8",
    "vtktypeint32": "i4", "vtktypeint16": "i2", "vtktypeint8": "i1", "vtktypeuint64": "u8", "vtktypeuint32": "u4",
    "vtktypeuint16": "u2", "vtktypeuint8": "u1",
}  # fmt: skip
#: Values that each item of an attribute has; the words after its name are the type, or (0) have no use here.
ATTRIBUTES = {"VECTORS": 3, "NORMALS": 3, "TENSORS": 9, "TENSORS6": 6, "GLOBAL_IDS": 1, "PEDIGREE_IDS": 1}
#: A line of words, at which numbers in text end.
WORDS = re.compile(rb"(?m)^[ \t]*(?!(?:nan|inf|infinity)\b)[A-Za-z_][^\n]*", re.IGNORECASE)
#: Digits of a count.
LONGEST_COUNT = 15


class _Source:
    """The file from a place on: lines of words, and numbers in text or binary."""

    def __init__(self, content: bytes) -> None:
        head = re.match(
            rb"\s*# vtk DataFile Version[^\n]*\n[^\n]*\n\s*(ASCII|BINARY)\b[^\n]*\n", content, re.IGNORECASE
        )
        if not head:
            raise Refusal("line 3: neither ASCII nor BINARY. Write the mesh again.")
        self.content, self.place, self.text = content, head.end(), head[1].upper() == b"ASCII"

    def where(self) -> str:
        """The line of the place, or the byte in a binary file."""
        if self.text:
            line = self.content.count(b"\n", 0, self.place) + 1
            return f"line {line}: "
        return f"byte {self.place}: "

    def words(self) -> list[str]:
        """The next line that is not blank; empty at the end of the file."""
        while self.place < len(self.content):
            end = self.content.find(b"\n", self.place)
            end = len(self.content) if end < 0 else end
            line, self.place = self.content[self.place : end], end + 1
            if line.strip():
                return line.decode("utf-8", "replace").split()
        return []

    def skip_paragraph(self) -> None:
        """Go on after the next blank line."""
        blank = re.compile(rb"\n[ \t\r]*\n").search(self.content, max(self.place - 1, 0))
        self.place = blank.end() if blank else len(self.content)

    def numbers(self, kind: str, count: int, what: str) -> np.ndarray:
        """So many numbers of a type."""
        dtype = np.dtype(">" + TYPES.get(kind.lower(), "V1")) if kind.lower() in TYPES else None
        if dtype is None:
            raise Refusal(
                f"{self.where()}{what} are of type {excerpt(kind)}, which is not read. Write them as int or double."
            )
        if not self.text:
            if count > (len(self.content) - self.place) // dtype.itemsize:
                raise Refusal(self._short(what, count, (len(self.content) - self.place) // dtype.itemsize))
            values = np.frombuffer(self.content, dtype, count, self.place)
            self.place += count * dtype.itemsize
            return values.astype(dtype.newbyteorder("="))
        end = WORDS.search(self.content, self.place)
        end = end.start() if end else len(self.content)
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            try:
                wide = np.float64 if dtype.kind == "f" else np.int64
                values = np.fromstring(self.content[self.place : end], wide, sep=" ")
            except (DeprecationWarning, ValueError):
                raise Refusal(f"{self.where()}{what} hold what is no number. Write the mesh again.") from None
        if len(values) != count:
            raise Refusal(self._short(what, count, len(values)))
        self.place = end
        return values

    def _short(self, what: str, count: int, found: int) -> str:
        return (
            f"{self.where()}{what} declare {count} numbers, and {found} are there. The file was cut off, or the count "
            "is "
            "wrong: write it again."
        )


def read_vtk(content: bytes) -> RawMesh:
    """Read the content of a file.

    Raises
    ------
    Refusal
        With the line or byte, what was found and what to do.
    """
    source = _Source(content)
    parts: dict[str, np.ndarray] = {}
    arrays: list[tuple[str, str, np.ndarray]] = []
    about, items = "", 0
    while words := source.words():
        word = words[0].upper()
        if word == "DATASET":
            if words[1:2] != ["UNSTRUCTURED_GRID"]:
                raise Refusal(
                    f"{source.where()}the file holds {excerpt(' '.join(words[1:2]))}, and unstructured grids are read. "
                    "Write it as one (in ParaView: Append Datasets)."
                )
        elif word == "POINTS":
            n = _count(words, 1, source)
            parts["points"] = source.numbers(_word(words, 2), 3 * n, "points").astype(np.float64).reshape(-1, 3)
        elif word == "CELLS":
            parts["offsets"], parts["connectivity"] = _cells(words, source)
        elif word == "CELL_TYPES":
            parts["types"] = source.numbers("int", _count(words, 1, source), "cell types")
        elif word in ("CELL_DATA", "POINT_DATA"):
            about, items = word, _count(words, 1, source)
            if items != len(parts.get("types" if about == "CELL_DATA" else "points", ())):
                raise Refusal(f"{source.where()}{word} of {items} is not the number of them. Write the mesh again.")
        elif word == "METADATA":
            source.skip_paragraph()
        else:
            arrays += [(about, name, values) for name, values in _attribute(word, words, source, items)]
    if missing := [key for key in ("points", "connectivity", "types") if key not in parts]:
        raise Refusal(f"{source.where()}the file ends without {' and '.join(missing)}. It was cut off: write it again.")
    if len(parts["types"]) != len(parts["offsets"]):
        raise Refusal(
            f"the file has {len(parts['offsets'])} cells and the types of {len(parts['types'])}. Write the mesh again."
        )
    raw = make_mesh(parts["points"], parts["types"].astype(np.int64), parts["offsets"], parts["connectivity"])
    for table, name, values in arrays:
        if table:
            (add_cell_array if table == "CELL_DATA" else add_point_array)(raw, name, values)
    return raw


def _word(words: list[str], place: int) -> str:
    return words[place] if place < len(words) else ""


def _count(words: list[str], place: int, source: _Source) -> int:
    text = _word(words, place)
    if not text.isdigit() or len(text) > LONGEST_COUNT:
        raise Refusal(f"{source.where()}{excerpt(' '.join(words))} has no count. Write the mesh again.")
    return int(text)


def _cells(words: list[str], source: _Source) -> tuple[np.ndarray, np.ndarray]:
    """Ends of the nodes of each cell, and the nodes; from version 5 on they are written so."""
    first, second = _count(words, 1, source), _count(words, 2, source)
    place = source.place
    head = source.words()
    if head[:1] == ["OFFSETS"]:
        offsets = whole(source.numbers(_word(head, 1), first, "offsets of cells"), "offsets")
        head = source.words()
        if head[:1] != ["CONNECTIVITY"]:
            raise Refusal(f"{source.where()}CONNECTIVITY is missing. Write the mesh again.")
        return offsets[1:], whole(source.numbers(_word(head, 1), second, "nodes of cells"), "nodes")
    source.place = place
    table = source.numbers("int", second, "cells").astype(np.int64)
    if first and second % first == 0 and (table[:: second // first] == second // first - 1).all():
        width = second // first
        return np.arange(1, first + 1) * (width - 1), table.reshape(first, width)[:, 1:].reshape(-1)
    sizes, at = np.empty(first, np.int64), 0
    keep = np.ones(second, bool)
    for cell in range(first):
        if at >= second or not 0 <= table[at] < second - at:
            raise Refusal(f"cell {cell} does not fit into the numbers of CELLS. Write the mesh again.")
        sizes[cell], keep[at] = table[at], False
        at += 1 + table[at]
    if at != second:
        raise Refusal(f"CELLS declares {second} numbers, and its {first} cells have {at}. Write the mesh again.")
    return np.cumsum(sizes), table[keep]


def _attribute(word: str, words: list[str], source: _Source, items: int) -> list[tuple[str, np.ndarray]]:
    """Read one attribute of points or cells; the names and values of those with one whole number an item."""
    name = _word(words, 1)
    if word == "FIELD":
        found = []
        for _ in range(_count(words, 2, source)):
            head = source.words()
            while head[:1] == ["METADATA"]:
                source.skip_paragraph()
                head = source.words()
            width, rows = _count(head, 1, source), _count(head, 2, source)
            values = source.numbers(_word(head, 3), width * rows, f"values of {excerpt(head[0])}")
            found += [(head[0], values)] if width == 1 and rows == items else []
        return found
    if word == "SCALARS":
        width = _count(words, 3, source) if len(words) > 3 else 1
        place = source.place
        if source.words()[:1] != ["LOOKUP_TABLE"]:
            source.place = place
        values = source.numbers(_word(words, 2), width * items, f"values of {excerpt(name)}")
        return [(name, values)] if width == 1 else []
    if word == "LOOKUP_TABLE":
        source.numbers("float" if source.text else "unsigned_char", 4 * _count(words, 2, source), "colours")
    elif word == "COLOR_SCALARS":
        source.numbers("float" if source.text else "unsigned_char", _count(words, 2, source) * items, "colours")
    elif word == "TEXTURE_COORDINATES":
        source.numbers(_word(words, 3), _count(words, 2, source) * items, f"values of {excerpt(name)}")
    elif word in ATTRIBUTES:
        values = source.numbers(_word(words, 2), ATTRIBUTES[word] * items, f"values of {excerpt(name)}")
        return [(name, values)] if ATTRIBUTES[word] == 1 else []
    else:
        raise Refusal(f"{source.where()}{excerpt(' '.join(words))} is no keyword that is known. Write the mesh again.")
    return []
