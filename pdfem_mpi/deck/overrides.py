"""Single keys of a deck that are given apart from it: ``mesh.spacing=0.1``."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from pdfem_mpi.deck.table import DeckError, did_you_mean, show


class Override(NamedTuple):
    """One ``key=value`` of the command line: path, TOML value, and the text as typed."""

    path: tuple[str, ...]
    value: Any
    text: str


class OverrideProblem(Exception):
    """Sentence that follows the override's text."""


def parse_overrides(overrides: Sequence[str] | Mapping[str, Any], messages: list[str] | None = None) -> list[Override]:
    """Split overrides like ``mesh.spacing=0.1``; values are TOML, bare words are texts.

    Items of lists are addressed by index or by name: ``loads.0.total=[1.0, 0.0, 0.0]``,
    ``regions.left.model=peridynamics``.

    Parameters
    ----------
    overrides : sequence of str, or dict of values
    messages : list of str, optional
        Added to: one sentence for each override that cannot be understood.

    Raises
    ------
    DeckError
        If there are such overrides and ``messages`` is not given.
    """
    if isinstance(overrides, Mapping):
        return [
            Override(tuple(key.split(".")), value, f"{key}={show(value)}") for key, value in listed(overrides).items()
        ]
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
        except OverrideProblem as problem:
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
        raise OverrideProblem(f"{show(text)} is not a TOML value. Quote it for the shell: --set 'key=[1.0, 2.0]'.")
    return text


def apply(data: dict[str, Any], override: Override) -> str:
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
            raise OverrideProblem(f"{where} = {show(node)} is not a table. Remove .{part} from the key.")
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
    raise OverrideProblem(f"{where} has no item {part}. Items are: {choices}.{did_you_mean(part, named)}")


def listed(value: Any) -> Any:
    """A value of Python as a TOML file would give it: a copy with lists, and numbers in place of numpy's."""
    if isinstance(value, Mapping):
        return {str(name): listed(item) for name, item in value.items()}
    if hasattr(value, "tolist"):  # arrays and numbers of numpy, which decks do not load
        value = value.tolist()
    return [listed(item) for item in value] if isinstance(value, list | tuple) else value
