"""The base of all deck tables: frozen, complete, and refused in plain sentences."""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Iterable, Iterator, Sequence
from typing import Any, Literal, NamedTuple, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator
from pydantic_core import PydanticCustomError

Vector = tuple[float, float, float]
Pair = tuple[float, float]
Face = Literal["x-", "x+", "y-", "y+", "z-", "z+"]
AXES = ("x", "y", "z")
LONGEST_NAME = 200  # characters: line_NAME.png.tmp is a file, whose name may have 255 bytes
MOST_HINTS = 50  # findings of one kind that get a hint of what may have been meant: more would take minutes


class SceneError(Exception):
    """A scene that cannot be simulated; every problem is one plain sentence.

    Attributes
    ----------
    messages : list of str
        All problems found, each with the key, the value and the remedy.
    """

    def __init__(self, messages: Iterable[str]):
        self.messages = list(messages)
        super().__init__("\n".join(self.messages))


class DeckError(SceneError):
    """A deck that cannot be read or is not a scene; ``messages`` holds all problems."""


class Problem(NamedTuple):
    """One finding: the key's path, and the rest of the sentence (``= 0.07 does not ... Use 0.05.``)."""

    key: str
    text: str


def did_you_mean(word: object, known: Iterable[str]) -> str:
    """Return `` Did you mean X?`` for the nearest of ``known``, or an empty string."""
    known = list(known)
    near = difflib.get_close_matches(str(word), known, n=1, cutoff=0.65)
    if not near:
        same = {name.casefold(): name for name in known}
        near = [same[str(word).casefold()]] if str(word).casefold() in same else []
    return f" Did you mean {near[0]}?" if near else ""


def show(value: object) -> str:
    """Return a value as a deck would print it, shortened to 60 characters."""
    if isinstance(value, bool):
        text = "true" if value else "false"
    elif isinstance(value, str):
        text = '"' + value.replace("\n", "\\n") + '"'
    elif isinstance(value, int) and abs(value) >= 10**20:
        text = f"a whole number of {int(math.log10(abs(value))) + 1} digits"
    elif isinstance(value, tuple | list):
        text = "[" + ", ".join(show(item) for item in value[:8]) + (", ..." if len(value) > 8 else "") + "]"
    elif isinstance(value, dict):
        text = "a table"
    else:
        text = repr(value) if isinstance(value, float | int) else str(value)
    return text if len(text) <= 60 else text[:57] + "..."


def leaves(value: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """Dotted paths and values of nested tables and lists of tables; other lists are values."""
    if isinstance(value, dict):
        items: Iterable[tuple[Any, Any]] = value.items()
    elif isinstance(value, list) and value and all(isinstance(item, dict) for item in value):
        items = enumerate(value)
    else:
        yield path, value
        return
    for name, item in items:
        yield from leaves(item, f"{path}.{name}" if path else str(name))


def key(default: Any = ..., *, dimension: str = "", remedy: str = "", **limits: Any) -> Any:
    """Return a pydantic field with the dimension and remedy that error sentences and documents print."""
    return Field(default, json_schema_extra={"dimension": dimension, "remedy": remedy}, **limits)


def _refuse(problems: Sequence[Problem]) -> None:
    """Raise the problems of one table as one pydantic error that ``deck.py`` can take apart."""
    if problems:
        text = " ".join(f"{problem.key} {problem.text}".strip() for problem in problems)
        raise PydanticCustomError("pdfem", "{text}", {"text": text, "problems": list(problems)})


class FieldMissing(AttributeError):
    """A field was read that is not there, or is wrong by itself: the check that reads it has nothing to say.

    Any other error in a check is a mistake of the program, and is not caught.
    """


class Table(BaseModel):
    """Base of all deck tables: frozen, unknown keys refused, no silent conversion, no nan or inf."""

    # built when a deck is read: each table by itself as well would be twice the work
    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False, defer_build=True)

    def __getattr__(self, name: str) -> Any:
        """Called for what is not there: a field of a table that was made without it, or a misspelt name."""
        if name in type(self).model_fields:
            raise FieldMissing(name)
        return super().__getattr__(name)  # type: ignore[misc]

    def problems(self) -> list[Problem]:
        """Return what is wrong between the keys of this table; each key by itself is sound."""
        return []

    @model_validator(mode="after")
    def _check(self) -> Self:
        _refuse(self.problems())
        return self


class Absent:
    """Stands for an item of a list that is no table of any kind: no field of it can be read."""

    def __getattr__(self, name: str) -> Any:
        raise FieldMissing(name)


def plain_name(name: str | None) -> list[Problem]:
    """What is wrong with a name that columns are called by; None is none."""
    if name is None or re.fullmatch(r"[A-Za-z0-9_-]+", name):
        return []
    return [Problem("name", f"= {show(name)} names columns of history.csv. Use letters, digits, - and _ only.")]


class Units(Table):
    """Names of the units, for labels only; nothing is converted. Deck table ``[units]``.

    Attributes
    ----------
    length, force : str
        Such as "mm" and "N"; stresses are then in force / length^2.
    """

    length: str = key("")
    force: str = key("")
