"""The JSON schema of decks, by which editors complete and check them; descriptions are those of the tables' classes."""

from __future__ import annotations

import inspect
import re
from typing import Any

from pdfem_mpi.deck.adaptive import AUTO
from pdfem_mpi.deck.partial import models_of
from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.deck.table import Table

#: The file's name beside a deck, whose first line is ``#:schema pdfem-schema.json``.
SCHEMA_FILE = "pdfem-schema.json"
DRAFT = "http://json-schema.org/draft-07/schema#"
#: Words of the validation library that say nothing to an editor.
_DROPPED = ("dimension", "remedy", "discriminator", "title")


def deck_schema() -> dict[str, Any]:
    """The schema of a deck, draft 7 of JSON schema, which editors of TOML know.

    It knows keys, types, ranges and words; what holds between keys, `pdfem check` says.
    """
    raw = Scene.model_json_schema(ref_template="#/definitions/{model}")
    definitions, models = raw.pop("$defs"), {model.__name__: model for model in _all_tables(Table)}
    tables = {name: _table(table, models[name]) for name, table in sorted(definitions.items())}
    scene = _table(raw, Scene)
    for model in (Scene, *(models[name] for name in tables)):
        for field in model.model_fields.values():
            for kind in models_of(field.annotation)[1:]:  # the first is the one that a table without `kind` is
                if "kind" in kind.model_fields:
                    table = tables[kind.__name__]
                    table["required"] = sorted({*table.get("required", ()), "kind"})
    regions = scene["properties"]["regions"]  # or the one word that stands for a single table
    words = regions.pop("description")
    scene["properties"]["regions"] = {"anyOf": [regions, {"enum": [AUTO]}], "description": words}
    return {"$schema": DRAFT, "title": "A deck of pdfem_mpi", **scene, "definitions": tables}


def _all_tables(model: type[Table]) -> list[type[Table]]:
    return [one for child in model.__subclasses__() for one in (child, *_all_tables(child))]


def describe_keys(model: type[Table]) -> dict[str, str]:
    """What the attributes of a table's docstring say, by the names of the keys."""
    return {
        name: told
        for name, (kind, words) in words_of_keys(model).items()
        if (told := " ".join(filter(None, (kind and f"{kind}.", words))))
    }


def words_of_keys(model: type[Table]) -> dict[str, tuple[str, str]]:
    """Kind and meaning of each key as a table's docstring has them, by the names of the keys."""
    found = {}
    for owner in reversed(model.__mro__):
        text = inspect.cleandoc(owner.__doc__ or "") if issubclass(owner, Table) else ""
        _, _, section = text.partition("Attributes\n----------\n")
        for entry in re.finditer(r"^(\w[\w, ]*)(?: : (.+))?\n((?:    .*\n?|\n)*)", section + "\n", re.MULTILINE):
            names, kind, words = entry.groups(default="")
            told = kind.replace("``", "`"), " ".join(words.split()).replace("``", "`")
            found |= {name.strip(): told for name in names.split(",")}
    return found


def _table(raw: dict[str, Any], model: type[Table]) -> dict[str, Any]:
    """One table's schema without what no editor needs, with a description of each key."""
    table = _plain(raw)
    table["description"] = _first_sentence(model)
    words = describe_keys(model)
    for name, properties in table["properties"].items():
        field = model.model_fields[name]
        extra = field.json_schema_extra if isinstance(field.json_schema_extra, dict) else {}
        if "$ref" in properties:
            continue
        if kinds := models_of(field.annotation):
            properties["description"] = words.get(name) or _of_kinds(kinds)
        elif text := words.get(name) or extra.get("remedy") or (name == "kind" and "Which table this is."):
            properties["description"] = str(text)
    return table


def _plain(value: Any) -> Any:
    """A schema in the words of draft 7, without keys that are None: TOML has no such value."""
    if isinstance(value, list):
        return [_plain(item) for item in value]
    if not isinstance(value, dict):
        return value
    if "$ref" in value:
        return {"$ref": value["$ref"]}
    plain = {}
    for name, item in value.items():
        if name in _DROPPED and not isinstance(item, dict):
            continue
        if name == "discriminator" or (name == "default" and item is None):
            continue
        if name == "prefixItems":
            plain["items"] = _plain(item[0])
        else:
            plain["anyOf" if name == "oneOf" else name] = _plain(item)
    given = [item for item in plain.get("anyOf", ()) if item.get("type") != "null"]
    if plain.pop("anyOf", None):
        plain |= given[0] if len(given) == 1 else {"anyOf": given}
    return plain


def _first_sentence(model: type[Table]) -> str:
    return " ".join(inspect.cleandoc(model.__doc__ or "").split("\n\n")[0].split()).replace("``", "`")


def _of_kinds(models: list[type[Table]]) -> str:
    return " Or: ".join(_first_sentence(model) for model in models)
