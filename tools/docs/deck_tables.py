"""The tables of a deck and their keys, read off the models of `pdfem_mpi.deck`."""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Literal, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from pdfem_mpi.deck.partial import models_of
from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.deck.schema import words_of_keys

KIND = "kind"


@dataclass(frozen=True)
class DeckTable:
    """One table of the deck, in one of its kinds.

    Attributes
    ----------
    path : str
        Such as ``mesh.remove``; empty for the keys that stand above all tables.
    header : str
        As a deck has it: ``[mesh]``, ``[[mesh.remove]]``, ``[materials.NAME]``.
    kind : str or None
        Its ``kind``, where there are several.
    model : class
    by_default : bool
        A table without a ``kind`` is one of this kind.
    """

    path: str
    header: str
    kind: str | None
    model: type[BaseModel]
    by_default: bool = False

    @property
    def title(self) -> str:
        """The heading, of letters alone so that every renderer makes the same anchor of it."""
        return f"{self.path} {self.kind}" if self.kind else self.path or "title"

    @property
    def words(self) -> str:
        """The first sentence of its class, without the names that the page says before it."""
        if not self.path:
            return "Above all tables."
        text = " ".join(inspect.cleandoc(self.model.__doc__ or "").split("\n\n")[0].split())
        text = re.split(r"[;:.,] (?:(?:an?|deck|further) )*(?:tables? )?``(?=\[|kind)|[;.] Deck table", text)[0]
        return plain(text.rstrip(".") + ".")

    @property
    def keys(self) -> Iterator[tuple[str, FieldInfo, str]]:
        """Name, field and meaning of each key that is no table by itself; the kind comes first."""
        words = words_of_keys(self.model)
        fields = [(name, field) for name, field in self.model.model_fields.items() if not models_of(field.annotation)]
        for name, field in sorted(fields, key=lambda item: item[0] != KIND):
            _, told = words.get(name, ("", ""))
            if name == KIND and self.kind:
                told = "Which table this is." + (" It may be left out." if self.by_default else "")
            yield name, field, plain(told)


def deck_tables() -> list[DeckTable]:
    """All tables, in the order of the deck."""
    return [DeckTable("", "", None, Scene), *_tables_of(Scene, "")]


def _tables_of(model: type[BaseModel], path: str) -> Iterator[DeckTable]:
    for name, field in model.model_fields.items():
        models = models_of(field.annotation)
        place = f"{path}.{name}" if path else name
        named = get_origin(field.annotation) is dict
        several = get_origin(field.annotation) is tuple
        header = f"[{place}.NAME]" if named else f"[[{place}]]" if several else f"[{place}]"
        for one in models:
            choices = get_args(one.model_fields[KIND].annotation) if KIND in one.model_fields else ()
            kind = choices[0] if len(choices) == 1 else None
            by_default = one is models[0] and kind is not None and not one.model_fields[KIND].is_required()
            yield DeckTable(f"{place}.NAME" if named else place, header, kind, one, by_default)
            yield from _tables_of(one, place)


def plain(text: str) -> str:
    """Words of a docstring as a page has them: a deck has no None, and no module."""
    text = text.replace("``", "`")
    text = re.sub(r"\bNone \(default\)(?=[ :])", "left out", text)
    text = re.sub(r"\bNone (?=sets)", "left out, it ", text)
    text = re.sub(r"\bNone\b", "left out", text)
    text = re.sub(r"(^|[.:] )left out", lambda found: f"{found[1]}Left out", text)
    text = re.sub(r"\(see `deck\.formulas`\)|\(see `deck/formulas\.py`\)", "(see [formulas](#formulas))", text)
    text = re.sub(r"\(see `[A-Z]\w+`\)|; see `[A-Z]\w+`", "", text)
    text = re.sub(r" ?\(`[a-z]+\.[a-z]+`\)", "", text)
    text = re.sub(r"; deck tables? (?=`)|; an? (?=`\[)", ": ", text)
    return " ".join(text.split())


def kind_of(annotation: Any) -> str:
    """The type of a value in the words of a deck."""
    origin, parts = get_origin(annotation), get_args(annotation)
    simple = {float: "number", int: "whole number", bool: "true or false", str: "text", type(None): ""}
    if annotation in simple:
        return simple[annotation]
    if origin is Literal:
        return " or ".join(f'`"{part}"`' for part in parts)
    if origin is tuple:
        inner = kind_of(parts[0])
        if len(parts) == 2 and parts[1] is ...:
            return f"list of {_plural(inner)}"
        return f"{len(parts)} {_plural(inner)}"
    if hasattr(annotation, "__metadata__"):  # Annotated
        return kind_of(parts[0])
    return " or ".join(filter(None, (kind_of(part) for part in parts)))


def _plural(kind: str) -> str:
    if kind == "3 numbers":
        return "points"
    if kind == "2 numbers":
        return "pairs of numbers"
    return f"{kind}s" if kind in ("number", "text", "whole number") else kind


def range_of(field: FieldInfo) -> str:
    """Limits of a value."""
    signs = (("gt", ">"), ("ge", ">="), ("lt", "<"), ("le", "<="))
    limits = [(sign, getattr(one, name)) for name, sign in signs for one in field.metadata if hasattr(one, name)]
    found = [f"{sign} {show(limit)}" for sign, limit in limits]
    for one in field.metadata:
        if hasattr(one, "min_length"):
            found.append("not empty" if one.min_length == 1 else f"at least {one.min_length}")
    return ", ".join(found) or "-"


def show(value: Any) -> str:
    """A value as a deck has it."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return '"' + value.replace("\\", "\\\\").replace('"', '\\"') + '"'
    if isinstance(value, list | tuple):
        return f"[{', '.join(show(item) for item in value)}]"
    return repr(value)


def default_of(field: FieldInfo) -> str:
    """What a key is when it is left out."""
    if field.is_required():
        return "required"
    value = field.get_default(call_default_factory=True)
    return "-" if value is None else f"`{show(value)}`"


def unit_of(field: FieldInfo) -> str:
    """The dimension in the deck's units."""
    extra = field.json_schema_extra
    return (extra.get("dimension") if isinstance(extra, dict) else "") or "-"


def remedy_of(field: FieldInfo) -> str:
    """What an error says to do where the key is missing."""
    extra = field.json_schema_extra
    return (extra.get("remedy") if isinstance(extra, dict) else "") or ""
