"""Decks: TOML text -> ``Scene`` and back, with overrides; every problem becomes one plain sentence.

Sentences read ``FILE: key.path = value is ... Remedy.`` All problems of a deck are collected before anyone
raises, and nothing of the validation library's own wording reaches the user.
"""

from __future__ import annotations

import contextlib
import json
import os
import tomllib
import types
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, Literal, NamedTuple, Union, get_args, get_origin

from pydantic import ValidationError
from pydantic.fields import FieldInfo

from pdfem_mpi.deck.limits import find_limits
from pdfem_mpi.deck.scene import Problem, Scene, SceneError, Table, Vector, did_you_mean, find_problems, show
from pdfem_mpi.system.plain_files import NotPlain, read_plain

MISSING = object()
#: Sentences about a deck that are shown, and characters of one: nobody reads more, and a program should not write it.
MOST_PROBLEMS, LONGEST_SENTENCE = 50, 2000
MOST_BYTES = 1 << 24  # a file without an end is not read
WORDS = {float: "a number", int: "a whole number", str: 'a text in quotes ("...")', bool: "true or false"}
LIMITS = (("gt", "above {}"), ("ge", "of {} or more"), ("lt", "below {}"), ("le", "of {} or less"))


class DeckError(SceneError):
    """A deck that cannot be read or is not a scene; ``messages`` holds all problems."""


def read_deck(path: str | Path, overrides: Sequence[str] = ()) -> Scene:
    """Read a deck, apply ``key=value`` overrides, and validate it as a whole.

    Parameters
    ----------
    path : str or Path
    overrides : sequence of str
        Like ``mesh.spacing=0.1``; see ``parse_overrides``.

    Raises
    ------
    DeckError
        With every problem found.
    """
    return parse_deck(read_text(path), str(path), overrides)


def read_text(path: str | Path) -> str:
    """Return the text of a deck, or raise ``DeckError`` with the reason and the remedy."""
    file = Path(path)
    try:
        return read_plain(file, MOST_BYTES).decode("utf-8")
    except FileNotFoundError:
        try:
            near = [str(other) for other in file.parent.glob("*.toml")]
        except OSError:
            near = []
        remedy = did_you_mean(file, near) or " Give the path of a deck (a .toml file)."
        message = f"{path}: there is no such file.{remedy}"
    except IsADirectoryError:
        message = f"{path}: this is a folder. Give the path of a deck (a .toml file) in it."
    except UnicodeDecodeError as error:
        message = f"{path}: byte {error.start} is not UTF-8 text. Give a TOML deck saved as UTF-8."
    except NotPlain as error:
        message = f"{path}: {error.strerror}. Give the path of a deck (a .toml file)."
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        message = f"{path}: cannot be read: {reason}. Give a deck that this user may read."
    raise DeckError([message])


def parse_deck(text: str, name: str, overrides: Sequence[str] = ()) -> Scene:
    """Return the validated scene of a deck's text; ``name`` opens every sentence.

    Raises
    ------
    DeckError
        With every problem found.
    """
    try:
        data = tomllib.loads(text)
    except (ValueError, RecursionError) as error:  # ValueError: not TOML, or a number of 4301 digits
        reason = str(error) if isinstance(error, ValueError) else "too deeply nested"
        raise DeckError(
            [f"{name}: this is not a TOML file: {reason}. Correct that place: decks have lines key = value."]
        ) from None
    messages = []
    overridden = set()
    for override in parse_overrides(overrides, messages):
        try:
            overridden.add(_apply(data, override))
        except _OverrideProblem as problem:
            messages.append(f"--set {override.text}: {problem}")
    _resolve_mesh_path(data, Path(name).parent)
    data, beyond = find_limits(data)
    scene, problems = _validate(_freeze(data), {problem.key for problem in beyond})
    problems = beyond + problems
    for problem in problems[:MOST_PROBLEMS]:
        origin = " (This value was given by --set.)" if problem.key in overridden else ""
        messages.append(_shortened(f"{name}: " + f"{problem.key} {problem.text}".strip() + origin))
    if len(problems) > MOST_PROBLEMS:
        more = f"{len(problems) - MOST_PROBLEMS:,} more of {len(problems):,} problems are not shown"
        messages.append(f"{name}: {more}. Mend these first.")
    if messages or scene is None:
        raise DeckError(messages)
    return scene


def _shortened(sentence: str) -> str:
    return sentence if len(sentence) <= LONGEST_SENTENCE else f"{sentence[: LONGEST_SENTENCE - 4]} ..."


# --- overrides -------------------------------------------------------------------------------------------


class Override(NamedTuple):
    """One ``key=value`` of the command line: path, TOML value, and the text as typed."""

    path: tuple[str, ...]
    value: Any
    text: str


class _OverrideProblem(Exception):
    """Sentence that follows the override's text."""


def parse_overrides(overrides: Sequence[str], messages: list[str] | None = None) -> list[Override]:
    """Split overrides like ``mesh.spacing=0.1``; values are TOML, bare words are texts.

    Items of lists are addressed by index or by name: ``loads.0.total=[1.0, 0.0, 0.0]``,
    ``regions.left.model=peridynamics``.

    Parameters
    ----------
    overrides : sequence of str
    messages : list of str, optional
        Added to: one sentence for each override that cannot be understood.

    Raises
    ------
    DeckError
        If there are such overrides and ``messages`` is not given.
    """
    found: list[str] = []
    parsed = []
    for text in overrides:
        key, equals, value = text.partition("=")
        path = tuple(part.strip() for part in key.split("."))
        value = value.strip()
        if not equals or not all(path) or not value:
            found.append(f"--set {text}: must read key.path=value, for example mesh.spacing=0.1.")
            continue
        try:
            parsed.append(Override(path, _toml_value(value), text))
        except _OverrideProblem as problem:
            found.append(f"--set {text}: {problem}")
    if messages is None:
        if found:
            raise DeckError(found)
    else:
        messages += found
    return parsed


def _toml_value(text: str) -> Any:
    try:
        table = tomllib.loads(f"value = {text}")
        if set(table) == {"value"}:
            return table["value"]
    except (ValueError, RecursionError):
        pass
    if text[0] in "[{\"'" or "\n" in text:
        raise _OverrideProblem(
            f"{show(text)} is not a TOML value. Quote it for the shell: --set 'key=[1.0, 2.0]'."
        )
    return text


def _apply(data: dict[str, Any], override: Override) -> str:
    """Set one value in nested dicts and lists; return its dotted path with indices."""
    node: Any = data
    path: list[str] = []
    for depth, part in enumerate(override.path):
        last = depth == len(override.path) - 1
        where = ".".join(path)
        if isinstance(node, list):
            index = _find_item(node, part, where)
            path.append(str(index))
            if last:
                node[index] = override.value
            else:
                node = node[index]
        elif isinstance(node, dict):
            path.append(part)
            if last:
                node[part] = override.value
            else:
                node = node.setdefault(part, {})
        else:
            raise _OverrideProblem(f"{where} = {show(node)} is not a table. Remove .{part} from the key.")
    return ".".join(path)


def _find_item(items: list[Any], part: str, where: str) -> int:
    if part.isascii() and part.isdigit() and int(part) < len(items):
        return int(part)
    names = [item.get("name") for item in items if isinstance(item, dict)]
    if part in names:
        return names.index(part)
    named = [name for name in names if isinstance(name, str) and name]
    choices = f"0 to {len(items) - 1}" if items else "none, the list is empty"
    if named:
        choices += ", or by name " + ", ".join(named)
    raise _OverrideProblem(f"{where} has no item {part}. Items are: {choices}.{did_you_mean(part, named)}")


def _resolve_mesh_path(data: dict[str, Any], folder: Path) -> None:
    """Make the path of a mesh file absolute: the deck is copied to the run folder, the mesh is not."""
    mesh = data.get("mesh")
    if isinstance(mesh, dict) and isinstance(mesh.get("path"), str) and mesh["path"]:
        mesh["path"] = os.path.abspath(folder / mesh["path"])


# --- validation ------------------------------------------------------------------------------------------


def _freeze(value: Any) -> Any:
    """Turn TOML arrays into tuples: the strict models accept nothing else for fixed sequences."""
    if isinstance(value, dict):
        return {name: _freeze(item) for name, item in value.items()}
    if isinstance(value, list):
        return tuple(_freeze(item) for item in value)
    return value


def _validate(data: dict[str, Any], beyond: set[str]) -> tuple[Scene | None, list[Problem]]:
    """Return the scene, or None and all problems: what is sound in a bad deck still gets its checks.

    Parameters
    ----------
    beyond : set of str
        Keys whose values were beyond the limits and are `Beyond` now: they have their sentences.
    """
    problems = []
    scene = None
    try:
        scene = Scene.model_validate(data)
        tables = {name: getattr(scene, name) for name in Scene.model_fields}
    except ValidationError as error:
        errors = [item for item in error.errors(include_url=False) if _walk(item["loc"], data).path not in beyond]
        if len(errors) > MOST_PROBLEMS:  # hints and further checks would take minutes, and nobody would read them
            rest = [Problem("", "")] * (len(errors) - MOST_PROBLEMS)
            return None, _sentences(errors[:MOST_PROBLEMS], data) + rest
        problems = _sentences(errors, data)
        wrong = {_walk(item["loc"], data).path for item in errors} | beyond
        tables, more = _partial_tables(wrong, data)
        problems += [problem for problem in more + find_problems(tables) if problem not in problems]
    if "loads" in tables and "supports" in tables and not tables["loads"] and not tables["supports"]:
        problems.append(
            Problem(
                "loads", "and supports are both empty: nothing would move. Add [[loads]] or [[supports]]."
            )
        )
    return scene, problems


def _partial_tables(wrong: set[str], data: dict[str, Any]) -> tuple[dict[str, Any], list[Problem]]:
    """Return the tables of a bad deck without their wrong keys, and what is wrong between the others.

    Parameters
    ----------
    wrong : set of str
        Dotted paths of all errors.
    """
    tables: dict[str, Any] = {}
    problems: list[Problem] = []

    def sound(model: type[Table], raw: dict[str, Any], path: str) -> Table:
        known = {key: value for key, value in raw.items() if key in model.model_fields}
        table = model.model_construct(**known)
        for key in model.model_fields:
            if any(place == f"{path}.{key}" or place.startswith(f"{path}.{key}.") for place in wrong):
                table.__dict__.pop(key, None)
        if any(place.startswith(f"{path}.") for place in wrong):  # else it had its checks
            with contextlib.suppress(AttributeError):
                for problem in table.problems():
                    problems.append(Problem(".".join(filter(None, (path, problem.key))), problem.text))
        return table

    for name, field in Scene.model_fields.items():
        models = _models(field.annotation)
        raw = data.get(name, MISSING)
        if raw is MISSING and not field.is_required():
            tables[name] = field.get_default(call_default_factory=True)
        elif get_origin(field.annotation) is dict:
            if isinstance(raw, dict):
                named = {part: item for part, item in raw.items() if isinstance(item, dict)}
                tables[name] = {part: sound(models[0], item, f"{name}.{part}") for part, item in named.items()}
        elif isinstance(raw, dict) and models and get_origin(field.annotation) is not tuple:
            fitting = [model for model in models if len(models) == 1 or _kind_of(model) == _kind_in(raw, models)]
            if fitting:
                tables[name] = sound(fitting[0], raw, name)
        elif isinstance(raw, tuple) and models and get_origin(field.annotation) is tuple:
            items = []
            for index, item in enumerate(raw):
                fitting = models
                if len(models) > 1:
                    kind = _kind_in(item, models) if isinstance(item, dict) else None
                    fitting = [model for model in models if _kind_of(model) == kind]
                usable = isinstance(item, dict) and fitting
                items.append(sound(fitting[0], item, f"{name}.{index}") if usable else None)
            tables[name] = tuple(items)
    return tables, problems


class _Place(NamedTuple):
    """Where an error is: dotted path, the field, the value, and the table that holds it."""

    path: str
    field: FieldInfo | None
    value: Any
    table: type[Table]
    annotation: Any


def _models(annotation: Any) -> list[type[Table]]:
    if isinstance(annotation, type) and not isinstance(annotation, types.GenericAlias):
        return [annotation] if issubclass(annotation, Table) else []
    return [model for part in get_args(annotation) for model in _models(part)]


def _kind_of(model: type[Table]) -> str:
    return str(get_args(model.model_fields["kind"].annotation)[0])


def _kind_in(value: dict[str, Any], models: Sequence[type[Table]]) -> Any:
    """Return the kind of a table of a union; left out, the first model's where that has a default."""
    default = models[0].model_fields["kind"].default
    return value.get("kind", default if isinstance(default, str) else None)


def _walk(loc: Sequence[int | str], data: dict[str, Any]) -> _Place:
    """Follow an error's location through data and models; tags of unions are not part of the path."""
    path: list[str] = []
    value: Any = data
    annotation: Any = Scene
    table: type[Table] = Scene
    field: FieldInfo | None = None
    for part in loc:
        models = _models(annotation)
        if isinstance(part, int):
            path.append(str(part))
            value = value[part] if isinstance(value, tuple) and part < len(value) else MISSING
            arguments = get_args(_unwrap(annotation))
            annotation = arguments[0] if arguments else Any
        elif len(models) > 1 and isinstance(value, dict) and _kind_in(value, models) == part:
            annotation = next(model for model in models if _kind_of(model) == part)
        elif get_origin(annotation) is dict:
            path.append(part)
            value = value.get(part, MISSING) if isinstance(value, dict) else MISSING
            annotation = get_args(annotation)[1]
        else:
            path.append(part)
            value = value.get(part, MISSING) if isinstance(value, dict) else MISSING
            table = models[0] if models else table
            field = table.model_fields.get(part)
            annotation = field.annotation if field else Any
    return _Place(".".join(path), field, value, table, annotation)


def _unwrap(annotation: Any) -> Any:
    """Return ``X`` for ``X | None`` and for ``Annotated[X, ...]``."""
    if get_origin(annotation) in (types.UnionType, Union):
        rest = [part for part in get_args(annotation) if part is not type(None)]
        return _unwrap(rest[0]) if len(rest) == 1 else annotation
    return annotation


def _sentences(errors: Iterable[Any], data: dict[str, Any]) -> list[Problem]:
    errors = list(errors)
    missing = {item["loc"] for item in errors if item["type"] == "missing"}
    explained = set()  # missing keys that a misspelt key beside them stands for
    misspelt = {}
    for item in errors:
        if item["type"] == "extra_forbidden":
            loc = item["loc"]
            place = _walk(loc, data)
            absent = [other[-1] for other in missing - explained if other[:-1] == loc[:-1]]
            hint = did_you_mean(loc[-1], place.table.model_fields)
            misspelt[loc] = hint or _other_home(str(loc[-1]), place.table)
            explained |= {(*loc[:-1], name) for name in absent if hint == f" Did you mean {name}?"}
    problems = []
    for item in errors:
        loc = item["loc"]
        if item["type"] == "pdfem":
            prefix = _walk(loc, data).path
            for problem in item["ctx"]["problems"]:
                problems.append(Problem(".".join(filter(None, (prefix, problem.key))), problem.text))
        elif item["type"] == "extra_forbidden":
            place = _walk(loc, data)
            word = "table" if _is_table(place.value) else "key"
            value = "" if _is_table(place.value) else f" = {show(place.value)}"
            problems.append(Problem("", f"unknown {word} {place.path}{value}.{misspelt[loc]}"))
        elif loc not in explained and not (item["type"] == "too_short" and _walk(loc, data).value):
            problem = _sentence(item, data)
            if problem not in problems:
                problems.append(problem)
    return problems


def _other_home(name: str, table: type[Table]) -> str:
    homes = [
        other
        for other, field in Scene.model_fields.items()
        if get_origin(field.annotation) is not dict
        for model in _models(field.annotation)[:1]
        if name in model.model_fields and model is not table
    ]
    if homes and name not in ("kind", "name"):
        return f" It is a key of {' and of '.join(homes)}: move it there."
    for field in Scene.model_fields.values():
        models = _models(field.annotation)
        kinds = [_kind_of(model) for model in models if table in models and name in model.model_fields]
        if kinds:
            return f' It is a key of kind = "{kinds[0]}": set that kind, or remove it.'
    keys = ", ".join(table.model_fields)
    return f" Remove it; the keys here are {keys}."


def _sentence(item: Any, data: dict[str, Any]) -> Problem:
    kind, loc = item["type"], item["loc"]
    place = _walk(loc, data)
    equals = f"= {show(place.value)}"
    expected = _expected(place.field, place.annotation)
    remedy = (place.field.json_schema_extra or {}).get("remedy", "") if place.field else ""
    if kind == "missing" and isinstance(loc[-1], int):
        whole = _walk(loc[:-1], data)
        return Problem(
            whole.path,
            f"= {show(whole.value)} has {len(whole.value)} numbers. Write three numbers [x, y, z].",
        )
    if kind == "missing":
        return Problem(place.path, f"is missing. {remedy or f'Give {expected}.'}")
    if kind in ("union_tag_not_found", "union_tag_invalid"):
        kinds = [_kind_of(model) for model in _models(place.annotation)]
        choices = " or ".join(f'kind = "{name}"' for name in kinds)
        if kind == "union_tag_not_found":
            return Problem(place.path, f"has no kind. Give {choices}.")
        given = place.value["kind"]
        return Problem(
            f"{place.path}.kind", f"= {show(given)} is unknown. Give {choices}.{did_you_mean(given, kinds)}"
        )
    if kind in ("model_type", "model_attributes_type", "tuple_type", "dict_type") and _models(place.annotation):
        return Problem(place.path, _table_or_list(place, equals))
    if kind == "literal_error":
        near = did_you_mean(place.value, [str(choice) for choice in get_args(_unwrap(place.annotation))])
        return Problem(place.path, f"{equals} is not among the choices. Use {expected}.{near}")
    if kind == "finite_number":
        return Problem(place.path, f"{equals} is not finite. Use {expected}.")
    if kind in ("too_short", "string_too_short"):
        return Problem(place.path, f"{equals} is empty. {remedy or f'Give {expected}.'}")
    if kind == "too_long" and isinstance(place.value, tuple):
        return Problem(place.path, f"{equals} has {len(place.value)} numbers. Write three numbers [x, y, z].")
    if kind in ("greater_than", "greater_than_equal", "less_than", "less_than_equal"):
        return Problem(place.path, f"{equals} is out of range. Use {expected}.")
    if kind == "float_type" and isinstance(place.value, int) and not isinstance(place.value, bool):
        return Problem(place.path, f"{equals} is too large. Use {expected}.")
    return Problem(place.path, f"{equals} is not {_words(place.annotation)}. Use {expected}.")


def _table_or_list(place: _Place, equals: str) -> str:
    if place.path.rpartition(".")[2].isdigit():
        name = place.path.partition(".")[0]
        return f"{equals} is not a table. Write each item as a table under [[{name}]]."
    home = place.path.partition(".")[0]
    if get_origin(Scene.model_fields[home].annotation) is dict:
        near = did_you_mean(home, [name for name in Scene.model_fields if name != home])
        return f"{equals} is not a table. Write the keys of each under a line [{home}.NAME].{near}"
    if get_origin(_unwrap(place.annotation)) is tuple:
        if isinstance(place.value, dict):
            return f"is one table and must be a list of tables. Write [[{place.path}]] with two brackets."
        return f"{equals} is not a list of tables. Write each item as a table under [[{place.path}]]."
    if isinstance(place.value, tuple):
        return f"is a list and must be one table. Write [{place.path}] with single brackets, once."
    return f"{equals} is not a table. Write its keys under a line [{place.path}]."


def _words(annotation: Any) -> str:
    """Return the type of a field in words."""
    annotation = _unwrap(annotation)
    origin = get_origin(annotation)
    if origin is Literal:
        choices = [show(choice) for choice in get_args(annotation)]
        return choices[0] if len(choices) == 1 else "one of " + ", ".join(choices)
    if annotation == Vector:
        return "three numbers [x, y, z]"
    if origin is tuple:
        if _models(annotation):
            return "a list of tables"
        return "a list of texts in quotes" if get_args(annotation)[0] is str else "a list of numbers"
    return WORDS.get(annotation, "a table" if _models(annotation) else "another value")


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


def dimension_of(scene: Scene, key: str) -> str:
    """Dimension of a key such as ``mesh.spacing`` or ``loads.0.total``; empty for one that has none."""
    node: Any = scene
    dimension = ""
    for part in key.split("."):
        if isinstance(node, tuple):
            if not part.isdigit():
                part = str([getattr(item, "name", None) for item in node].index(part))
            node = node[int(part)]
        elif isinstance(node, dict):
            node = node[part]
        else:
            field = type(node).model_fields[part]
            dimension = (field.json_schema_extra or {}).get("dimension", "")
            node = getattr(node, part)
    return dimension


# --- writing ---------------------------------------------------------------------------------------------


def write_deck(scene: Scene) -> str:
    """Return the complete deck of a scene as TOML text: overrides applied, defaults written out.

    Reading the text gives an equal scene. Keys that are None or empty are left out, and so are the tables
    [peridynamics] and [coupling] where they are defaults that the scene has no use for.
    """
    data = scene.model_dump(exclude_none=True)
    if not scene.has_peridynamics and scene.peridynamics == type(scene.peridynamics)():
        del data["peridynamics"]
    if not scene.is_coupled and scene.coupling == type(scene.coupling)():
        del data["coupling"]
    values = {name: value for name, value in data.items() if not _is_table(value)}
    blocks = [_lines(values)]
    for name, value in data.items():
        if get_origin(Scene.model_fields[name].annotation) is dict:
            blocks += [f"[{name}.{part}]\n{_lines(item)}" for part, item in value.items()]
        elif isinstance(value, dict):
            blocks.append(f"[{name}]\n{_lines(value)}")
        elif _is_table(value):
            blocks += [f"[[{name}]]\n{_lines(item)}" for item in value]
    return "\n".join(block for block in blocks if block)


def _is_table(value: Any) -> bool:
    return isinstance(value, dict) or (
        isinstance(value, tuple) and bool(value) and isinstance(value[0], dict)
    )


def _lines(table: dict[str, Any]) -> str:
    return "".join(f"{name} = {_toml(value)}\n" for name, value in table.items() if value not in ("", ()))


def _toml(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, tuple):
        return "[" + ", ".join(_toml(item) for item in value) + "]"
    return repr(value)
