"""Errors of the validation library as plain sentences about a deck."""

from __future__ import annotations

import types
from collections.abc import Iterable
from typing import Any, Literal, Union, get_args, get_origin

from pydantic.fields import FieldInfo

from pdfem_mpi.deck.partial import Place, is_table, kind_of, models_of, unwrap, walk
from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.deck.softening import PAIR
from pdfem_mpi.deck.table import Pair, Problem, Table, Vector, did_you_mean, show

WORDS = {float: "a number", int: "a whole number", str: 'a text in quotes ("...")', bool: "true or false"}
LIMITS = (("gt", "above {}"), ("ge", "of {} or more"), ("lt", "below {}"), ("le", "of {} or less"))


def sentences(errors: Iterable[Any], data: dict[str, Any]) -> list[Problem]:
    errors = list(errors)
    missing = {item["loc"] for item in errors if item["type"] == "missing"}
    explained = set()  # missing keys that a misspelt key beside them stands for
    misspelt = {}
    for item in errors:
        if item["type"] == "extra_forbidden":
            loc = item["loc"]
            place = walk(loc, data)
            absent = [other[-1] for other in missing - explained if other[:-1] == loc[:-1]]
            hint = did_you_mean(loc[-1], place.table.model_fields)
            misspelt[loc] = hint or _other_home(str(loc[-1]), place.table)
            explained |= {(*loc[:-1], name) for name in absent if hint == f" Did you mean {name}?"}
    problems = []
    for item in errors:
        loc = item["loc"]
        if item["type"] == "pdfem":
            prefix = walk(loc, data).path
            for problem in item["ctx"]["problems"]:
                problems.append(Problem(".".join(filter(None, (prefix, problem.key))), problem.text))
        elif item["type"] == "extra_forbidden":
            place = walk(loc, data)
            word = "table" if is_table(place.value) else "key"
            value = "" if is_table(place.value) else f" = {show(place.value)}"
            problems.append(Problem("", f"unknown {word} {place.path}{value}.{misspelt[loc]}"))
        elif loc not in explained and not (item["type"] == "too_short" and walk(loc, data).value):
            problem = _sentence(item, data)
            if problem not in problems:
                problems.append(problem)
    return problems


def _other_home(name: str, table: type[Table]) -> str:
    for field in Scene.model_fields.values():
        models = models_of(field.annotation)
        kinds = [kind_of(model) for model in models if table in models and name in model.model_fields]
        if kinds:
            return f' It is a key of kind = "{kinds[0]}": set that kind, or remove it.'
    homes = [
        other
        for other, field in Scene.model_fields.items()
        if get_origin(field.annotation) is not dict
        for model in models_of(field.annotation)[:1]
        if name in model.model_fields and model is not table
    ]
    if homes and name not in ("kind", "name"):
        return f" It is a key of {' and of '.join(homes)}: move it there."
    keys = ", ".join(table.model_fields)
    return f" Remove it; the keys here are {keys}."


def _sentence(item: Any, data: dict[str, Any]) -> Problem:
    kind, loc = item["type"], item["loc"]
    place = walk(loc, data)
    equals = f"= {show(place.value)}"
    expected = _expected(place.field, place.annotation)
    remedy = (place.field.json_schema_extra or {}).get("remedy", "") if place.field else ""
    if kind == "missing" and isinstance(loc[-1], int):
        whole = walk(loc[:-1], data)
        return Problem(
            whole.path,
            f"= {show(whole.value)} has {len(whole.value)} numbers. Write {_words(whole.annotation)}.",
        )
    if kind == "missing":
        return Problem(place.path, f"is missing. {remedy or f'Give {expected}.'}")
    if kind in ("union_tag_not_found", "union_tag_invalid"):
        kinds = [kind_of(model) for model in models_of(place.annotation)]
        choices = " or ".join(f'kind = "{name}"' for name in kinds)
        if kind == "union_tag_not_found":
            return Problem(place.path, f"has no kind. Give {choices}.")
        given = place.value["kind"]
        return Problem(f"{place.path}.kind", f"= {show(given)} is unknown. Give {choices}.{did_you_mean(given, kinds)}")
    if kind in ("model_type", "model_attributes_type", "tuple_type", "dict_type") and models_of(place.annotation):
        return Problem(place.path, _table_or_list(place, equals))
    if kind == "literal_error" and get_origin(unwrap(place.annotation)) is Literal:
        near = did_you_mean(place.value, [str(choice) for choice in get_args(unwrap(place.annotation))])
        return Problem(place.path, f"{equals} is not among the choices. Use {expected}.{near}")
    if kind == "finite_number":
        return Problem(place.path, f"{equals} is not finite. Use {expected}.")
    if kind in ("too_short", "string_too_short"):
        return Problem(place.path, f"{equals} is empty. {remedy or f'Give {expected}.'}")
    if kind == "too_long" and isinstance(place.value, tuple):
        return Problem(place.path, f"{equals} has {len(place.value)} numbers. Write {_words(place.annotation)}.")
    if kind in ("greater_than", "greater_than_equal", "less_than", "less_than_equal"):
        return Problem(place.path, f"{equals} is out of range. Use {expected}.")
    if kind == "float_type" and isinstance(place.value, int) and not isinstance(place.value, bool):
        return Problem(place.path, f"{equals} is too large. Use {expected}.")
    return Problem(place.path, f"{equals} is not {_words(place.annotation)}. Use {expected}.")


def _table_or_list(place: Place, equals: str) -> str:
    if place.path.rpartition(".")[2].isdigit():
        name = place.path.rpartition(".")[0]
        return f"{equals} is not a table. Write each item as a table under [[{name}]]."
    home = place.path.partition(".")[0]
    if get_origin(Scene.model_fields[home].annotation) is dict:
        near = did_you_mean(home, [name for name in Scene.model_fields if name != home])
        return f"{equals} is not a table. Write the keys of each under a line [{home}.NAME].{near}"
    if get_origin(unwrap(place.annotation)) is tuple:
        if isinstance(place.value, dict):
            return f"is one table and must be a list of tables. Write [[{place.path}]] with two brackets."
        return f"{equals} is not a list of tables. Write each item as a table under [[{place.path}]]."
    if isinstance(place.value, tuple):
        return f"is a list and must be one table. Write [{place.path}] with single brackets, once."
    return f"{equals} is not a table. Write its keys under a line [{place.path}]."


def _words(annotation: Any) -> str:
    """Return the type of a field in words."""
    annotation = unwrap(annotation)
    origin = get_origin(annotation)
    if origin is Literal:
        choices = [show(choice) for choice in get_args(annotation)]
        return choices[0] if len(choices) == 1 else "one of " + ", ".join(choices)
    if annotation == Vector:
        return "three numbers [x, y, z]"
    if annotation == PAIR:
        return "two numbers [opening, traction]"
    if annotation == Pair:
        return "two numbers"
    if origin is tuple:
        if models_of(annotation):
            return "a list of tables"
        return "a list of texts in quotes" if get_args(annotation)[0] is str else "a list of numbers"
    if get_origin(annotation) in (types.UnionType, Union):
        return " or ".join(_words(part) for part in get_args(annotation) if part is not type(None))
    return WORDS.get(annotation, "a table" if models_of(annotation) else "another value")


def _expected(field: FieldInfo | None, annotation: Any) -> str:
    """Return the allowed values of a field in words: type, range, dimension."""
    words = _words(annotation)
    extra = (field.json_schema_extra or {}) if field else {}
    limits = []
    for limit in field.metadata if field else ():
        for attribute, phrase in LIMITS:
            if getattr(limit, attribute, None) is not None:
                limits.append(phrase.format(getattr(limit, attribute)))
    if limits:
        words += " " + " and ".join(limits)
    dimension = extra.get("dimension", "")
    return words + (f" (dimension {dimension})" if dimension not in ("", "1") else "")
