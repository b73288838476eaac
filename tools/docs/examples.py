"""An example of each key of a deck: of its own, of its error's remedy, its default, or its first choice."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any, Literal, get_args, get_origin

from pydantic import TypeAdapter, ValidationError
from pydantic.fields import FieldInfo

from tools.docs.deck_tables import DeckTable, remedy_of, show

#: Examples of keys that neither default nor remedy gives, by ``table.key`` or ``key``.
EXAMPLES = tomllib.loads((Path(__file__).parent / "words" / "examples.toml").read_text("utf-8"))


class NoExample(Exception):
    """A key that has no example."""


def example_of(table: DeckTable, name: str, field: FieldInfo) -> str:
    """A line of a deck with the key.

    Raises
    ------
    NoExample
    """
    for value in (
        EXAMPLES.get(f"{table.path} {table.kind}.{name}"),
        EXAMPLES.get(f"{table.path}.{name}"),
        _of_remedy(field),
        EXAMPLES.get(name),
        None if field.is_required() else field.get_default(call_default_factory=True),
        _first_choice(field.annotation),
    ):
        if value not in (None, "", (), []):
            return f"{name} = {show(value)}"
    where = f"{table.header or 'the deck'}{f' of kind {table.kind}' if table.kind else ''}"
    raise NoExample(f"{where}: {name} has no example. Add a line to tools/docs/words/examples.toml.")


def is_valid(field: FieldInfo, line: str) -> bool:
    """Whether the value of an example is one that the key takes."""
    value = _frozen(next(iter(tomllib.loads(line).values())))
    try:
        TypeAdapter(field.annotation, config={"strict": True}).validate_python(value)
    except ValidationError:
        return False
    low = [value >= one.ge for one in field.metadata if hasattr(one, "ge")]
    low += [value > one.gt for one in field.metadata if hasattr(one, "gt")]
    high = [value <= one.le for one in field.metadata if hasattr(one, "le")]
    high += [value < one.lt for one in field.metadata if hasattr(one, "lt")]
    return all(low + high + [len(value) >= one.min_length for one in field.metadata if hasattr(one, "min_length")])


def _of_remedy(field: FieldInfo) -> Any:
    """What stands behind "for example" in the remedy, where that is a value of a deck."""
    found = re.search(r"(?:for example|e\.g\.) (.+?)\.?$", remedy_of(field))
    try:
        return tomllib.loads(f"value = {found[1]}")["value"] if found else None
    except tomllib.TOMLDecodeError:
        return None


def _first_choice(annotation: Any) -> Any:
    if get_origin(annotation) is Literal:
        return get_args(annotation)[0]
    return next((choice for part in get_args(annotation) if (choice := _first_choice(part)) is not None), None)


def _frozen(value: Any) -> Any:
    return tuple(map(_frozen, value)) if isinstance(value, list) else value
