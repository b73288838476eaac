"""Colours of lines on a terminal: errors red, warnings yellow, what is done green; none in files and pipes."""

from __future__ import annotations

import os
from typing import TextIO

RED, YELLOW, GREEN = "31", "33", "32"
#: How lines begin, and their colour.
BEGINNINGS = (
    ("warning:", YELLOW),
    ("pdfem: finished", GREEN),
    ("pdfem: stopped", YELLOW),
    ("pdfem: note:", ""),
    ("pdfem: not converged", RED),
    ("pdfem: results", RED),
)


def painted(text: str, stream: TextIO, colour: str = "") -> str:
    """A line in its colour where the stream is a terminal that shows some (see https://no-color.org).

    Parameters
    ----------
    colour : str
        Of a line whose beginning does not tell.
    """
    if not stream.isatty() or os.environ.get("NO_COLOR") or os.environ.get("TERM") == "dumb":
        return text
    found = next((colour for begin, colour in BEGINNINGS if text.startswith(begin)), colour)
    return f"\x1b[{found}m{text}\x1b[0m" if found else text
