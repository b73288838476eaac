"""The lines of an Abaqus or CalculiX file: keywords with their options, and numbers with the lines they stand on.

Comments (``**``) and blank lines may stand anywhere, keywords and options in any case, and a keyword line that ends
with a comma goes on on the next.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from pdfem_mpi.mesh.raw import Refusal, excerpt

#: A whole number as a field of a row.
WHOLE = re.compile(rb"[+-]?\d+")
#: Whole numbers beyond this are no numbers of nodes or elements.
LARGEST_NUMBER = 2**62


@dataclass
class Card:
    """A keyword line and its rows.

    Attributes
    ----------
    word : str
        In upper case.
    options : dict from str to str
        Names in upper case, values as they stand, an empty one for an option without.
    line : int
        Of the keyword, counted from 1.
    rows : list of bytes
        Neither blank nor comments.
    lines : list of int
        Of each row.
    """

    word: str
    options: dict[str, str]
    line: int
    rows: list[bytes]
    lines: list[int]

    def allow(self, *names: str) -> None:
        """Refuse options that are not among these."""
        for name in self.options:
            if name not in names:
                raise Refusal(
                    f"line {self.line}: *{self.word} has the option {excerpt(name)}, which is not read. Write the "
                    "mesh without it."
                )


def cards_of(content: bytes) -> Iterator[Card]:
    """Yield the cards of a file in their order."""
    lines = content.removeprefix(b"\xef\xbb\xbf").splitlines()
    stars = [k for k, line in enumerate(lines) if line[:1] == b"*" or line.lstrip()[:1] == b"*"]
    keywords = [k for k in stars if not lines[k].lstrip().startswith(b"**")]
    comments = set(stars).difference(keywords)
    first = next((k for k, line in enumerate(lines) if line.strip() and k not in comments), 0)
    if not keywords or first < keywords[0]:
        raise Refusal(
            f"line {first + 1}: {excerpt(lines[first] if lines else '')} stands before any keyword. Begin with "
            "*HEADING or *NODE."
        )
    for k, end in zip(keywords, [*keywords[1:], len(lines)], strict=True):
        kept = [n for n in range(k, end) if n not in comments and lines[n].strip()]
        head = 0
        while lines[kept[head]].rstrip().endswith(b",") and head + 1 < len(kept):
            head += 1
        keyword = b"".join(lines[n] for n in kept[: head + 1]).decode("utf-8", "replace")
        rows = kept[head + 1 :]
        yield Card(*_keyword(keyword, k + 1), k + 1, [lines[n] for n in rows], [n + 1 for n in rows])


def _keyword(text: str, line: int) -> tuple[str, dict[str, str]]:
    """The word of a keyword line in upper case, and its options; quoted values may hold commas."""
    first, *rest = re.findall(r'(?:"[^"]*"|[^,])+', text.strip()[1:]) or [""]
    options: dict[str, str] = {}
    for item in rest:
        name, _, value = item.partition("=")
        name = " ".join(name.upper().split())
        if name in options:
            raise Refusal(f"line {line}: {excerpt(text)} gives {name} twice. Give it once.")
        if name:
            options[name] = value.strip().strip('"').strip()
    return " ".join(first.upper().split()), options


def number_table(card: Card, columns: int, whole: bool) -> np.ndarray | None:
    """Rows of so many numbers each, at once; None where a row is otherwise and must be looked at by itself.

    Returns
    -------
    int64 if whole else float64, shape (n, columns)
    """
    rows = card.rows
    if not rows or any(row.count(b",") != columns - 1 for row in rows):
        return None
    text = b",".join(rows)
    if not whole:
        text = text.replace(b"D", b"E").replace(b"d", b"e")
    values = numbers_in(text, whole)
    return None if values is None or len(values) != len(rows) * columns else values.reshape(-1, columns)


def numbers_in(text: bytes, whole: bool, separator: str = " , ") -> np.ndarray | None:
    """All numbers of a text, or None if something in it is none."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            return np.fromstring(text, np.int64 if whole else np.float64, sep=separator)
        except (DeprecationWarning, ValueError):
            return None


def fields_of(row: bytes) -> list[bytes]:
    """The fields of a row without blanks around them; what follows a comma at its end is no field."""
    fields = [field.strip() for field in row.split(b",")]
    return fields[:-1] if len(fields) > 1 and not fields[-1] else fields


def whole_number(field: bytes, line: int, of: str) -> int:
    """A whole number of a row."""
    if WHOLE.fullmatch(field) and abs(int(field[:25])) < LARGEST_NUMBER and len(field) < 25:
        return int(field)
    raise Refusal(
        f"line {line}: {excerpt(field)} is not the number of {of}. Correct the line, or write the file again."
    )


def real_number(field: bytes, line: int) -> float:
    """A coordinate; a blank field is 0, and exponents may be written with D."""
    try:
        if b"_" in field:  # which Python would read past
            raise ValueError
        return float(field.upper().replace(b"D", b"E")) if field else 0.0
    except ValueError:
        raise Refusal(
            f"line {line}: {excerpt(field)} is not a coordinate. Correct the line, or write the file again."
        ) from None
