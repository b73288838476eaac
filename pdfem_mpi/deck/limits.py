"""What no deck may have, whatever its keys mean: numbers beyond all use, depths without end, texts that are none.

Squares and products of such numbers are not finite, such depths end the libraries that read them, and such names no
file can have. They are found before anything else looks at the deck.
"""

from __future__ import annotations

from typing import Any

from pdfem_mpi.deck.table import LONGEST_NAME, Problem, show

#: Products of three such numbers, such as a volume, are still finite.
LARGEST = 1e100
#: What others are divided by, and the smallest that it may be.
SIZES = ("spacing", "scale", "internal_length", "cutoff_radius", "hole_radius", "radius", "youngs_modulus")
SMALLEST = 1e-100
#: Tables and lists within each other; a crack's polygon, the deepest of a deck, has four.
DEEPEST = 16


class Beyond:
    """Stands for a value that was beyond a limit; of no type that a key may have."""

    def __str__(self) -> str:
        return "beyond the limits"


def find_limits(data: dict[str, Any]) -> tuple[Any, list[Problem]]:
    """Find what is beyond the limits.

    Returns
    -------
    data
        With `Beyond` in place of what is beyond them.
    problems : list of Problem
    """
    problems: list[Problem] = []
    return _bounded(data, "", 0, problems), problems


def _bounded(value: Any, path: str, depth: int, problems: list[Problem]) -> Any:
    text = None
    if isinstance(value, dict | list | tuple):
        if depth >= DEEPEST:
            text = f"is nested more than {DEEPEST} levels deep, and no key of a deck is. Remove it."
        elif isinstance(value, dict):
            items = ((name, item, f"{path}.{name}" if path else name) for name, item in value.items())
            return {name: _bounded(item, where, depth + 1, problems) for name, item, where in items}
        else:
            return [_bounded(item, f"{path}.{index}", depth + 1, problems) for index, item in enumerate(value)]
    elif isinstance(value, bool):
        return value
    elif isinstance(value, int | float) and LARGEST <= abs(value) < float("inf"):
        text = f"= {show(value)} is beyond {LARGEST:g}, where products are not finite. Use a smaller number."
    elif isinstance(value, int | float) and 0.0 < abs(value) < SMALLEST and path.rpartition(".")[2] in SIZES:
        text = f"= {show(value)} is below {SMALLEST:g}, where quotients are not finite. Use a larger number."
    elif isinstance(value, str):
        text = _text_problem(value, path)
    if text is None:
        return value
    problems.append(Problem(path, text))
    return Beyond()


def _text_problem(value: str, path: str) -> str | None:
    if path.endswith(".name") and len(value) > LONGEST_NAME:
        return f"= {show(value)} has {len(value)} characters. Use a name of at most {LONGEST_NAME}."
    try:
        value.encode()
    except UnicodeEncodeError:
        return f"= {show(value)!a} has bytes that are not UTF-8 text. Write it, or name the file, in UTF-8."
    return None
