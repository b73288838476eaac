"""Decks: TOML text -> ``Scene`` and back, with overrides; every problem becomes one plain sentence.

Sentences read ``FILE: key.path = value is ... Remedy.`` All problems of a deck are collected before anyone
raises, and nothing of the validation library's own wording reaches the user.
"""

from __future__ import annotations

import json
import os
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, get_origin

from pydantic import ValidationError

from pdfem_mpi.deck.adaptive import with_auto
from pdfem_mpi.deck.limits import find_limits
from pdfem_mpi.deck.overrides import OverrideProblem, apply, listed, parse_overrides
from pdfem_mpi.deck.partial import is_table, partial_tables, walk
from pdfem_mpi.deck.programs import with_solver
from pdfem_mpi.deck.scene import Scene, find_problems
from pdfem_mpi.deck.sentences import sentences
from pdfem_mpi.deck.table import DeckError, Problem, did_you_mean
from pdfem_mpi.system.plain_files import NotPlain, read_plain

#: Sentences about a deck that are shown, and characters of one: nobody reads more, and a program should not write it.
MOST_PROBLEMS, LONGEST_SENTENCE = 50, 2000
MOST_BYTES = 1 << 24  # a file without an end is not read


def read_deck(deck: str | Path | Mapping[str, Any], overrides: Sequence[str] | Mapping[str, Any] = ()) -> Scene:
    """Read a deck, apply overrides, and validate it as a whole.

    Parameters
    ----------
    deck : str, Path or dict
        A file, or its tables as TOML would give them: ``{"mesh": {"spacing": 0.1, ...}, "regions": [...], ...}``.
        Arrays and numbers of numpy serve as lists and numbers.
    overrides : sequence of str, or dict
        Like ``mesh.spacing=0.1``, see `parse_overrides`; or values by their keys, ``{"mesh.spacing": 0.1}``.

    Raises
    ------
    DeckError
        With every problem found.
    """
    if isinstance(deck, Mapping):
        return parse_tables(listed(deck), "deck", overrides)
    return parse_deck(read_text(deck), str(deck), overrides)


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


def parse_deck(text: str, name: str, overrides: Sequence[str] | Mapping[str, Any] = ()) -> Scene:
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
    return parse_tables(data, name, overrides)


def parse_tables(data: dict[str, Any], name: str, overrides: Sequence[str] | Mapping[str, Any] = ()) -> Scene:
    """Return the validated scene of a deck's tables, which are changed; ``name`` opens every sentence.

    Raises
    ------
    DeckError
        With every problem found.
    """
    messages: list[str] = []
    overridden = set()
    for override in parse_overrides(overrides, messages):
        try:
            overridden.add(apply(data, override))
        except OverrideProblem as problem:
            messages.append(f"--set {override.text}: {problem}")
    _resolve_paths(data, Path(name).parent)
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


def _resolve_paths(data: dict[str, Any], folder: Path) -> None:
    """Make the paths of files absolute: the deck is copied to the run folder, these are not."""
    for table, key in (("mesh", "path"), ("temperature", "file"), ("adaptive", "pilot")):
        entry = data.get(table)
        if isinstance(entry, dict) and isinstance(entry.get(key), str) and entry[key]:
            entry[key] = os.path.abspath(folder / entry[key])


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
    data = with_solver(with_auto(data))
    try:
        scene = Scene.model_validate(data)
        tables = {name: getattr(scene, name) for name in Scene.model_fields}
    except ValidationError as error:
        errors = [item for item in error.errors(include_url=False) if walk(item["loc"], data).path not in beyond]
        if len(errors) > MOST_PROBLEMS:  # hints and further checks would take minutes, and nobody would read them
            rest = [Problem("", "")] * (len(errors) - MOST_PROBLEMS)
            return None, sentences(errors[:MOST_PROBLEMS], data) + rest
        problems = sentences(errors, data)
        wrong = {walk(item["loc"], data).path for item in errors} | beyond
        tables, more = partial_tables(wrong, data)
        problems += [problem for problem in more + find_problems(tables) if problem not in problems]
    acting = [tables.get(name, True) for name in ("loads", "supports", "temperature")]
    if not any(acting):
        problems.append(
            Problem("loads", "and supports are both empty: nothing would move. Add [[loads]] or [[supports]].")
        )
    return scene, problems


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
    values = {name: value for name, value in data.items() if not is_table(value)}
    blocks = [_lines(values)]
    for name, value in data.items():
        if get_origin(Scene.model_fields[name].annotation) is dict:
            blocks += [f"[{name}.{part}]\n{_lines(item)}" for part, item in value.items()]
        else:
            blocks += _blocks(name, value)
    return "\n".join(block for block in blocks if block)


def _blocks(name: str, value: Any) -> list[str]:
    """A table or a list of tables, each with the lists of tables in it behind it; nothing for other values."""
    if not is_table(value):
        return []
    blocks = []
    for item in (value,) if isinstance(value, dict) else value:
        blocks.append((f"[{name}]\n" if isinstance(value, dict) else f"[[{name}]]\n") + _lines(item))
        blocks += [block for part, inner in item.items() for block in _blocks(f"{name}.{part}", inner)]
    return blocks


def _lines(table: dict[str, Any]) -> str:
    plain = {name: value for name, value in table.items() if not is_table(value) and value not in ("", ())}
    return "".join(f"{name} = {_toml(value)}\n" for name, value in plain.items())


def _toml(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, tuple):
        return "[" + ", ".join(_toml(item) for item in value) + "]"
    return repr(value)
