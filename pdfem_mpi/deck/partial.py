"""What is sound in a bad deck still gets its checks: tables without their wrong keys."""

from __future__ import annotations

import contextlib
import types
from collections.abc import Sequence
from typing import Any, NamedTuple, Union, get_args, get_origin

from pydantic.fields import FieldInfo

from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.deck.table import Absent, FieldMissing, Problem, Table

MISSING = object()


def partial_tables(wrong: set[str], data: dict[str, Any]) -> tuple[dict[str, Any], list[Problem]]:
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
            with contextlib.suppress(FieldMissing):
                for problem in table.problems():
                    problems.append(Problem(".".join(filter(None, (path, problem.key))), problem.text))
        return table

    for name, field in Scene.model_fields.items():
        models = models_of(field.annotation)
        raw = data.get(name, MISSING)
        if raw is MISSING and not field.is_required():
            tables[name] = field.get_default(call_default_factory=True)
        elif get_origin(field.annotation) is dict:
            if isinstance(raw, dict):
                named = {part: item for part, item in raw.items() if isinstance(item, dict)}
                tables[name] = {part: sound(models[0], item, f"{name}.{part}") for part, item in named.items()}
        elif isinstance(raw, dict) and models and get_origin(field.annotation) is not tuple:
            fitting = [model for model in models if len(models) == 1 or kind_of(model) == _kind_in(raw, models)]
            if fitting:
                tables[name] = sound(fitting[0], raw, name)
        elif isinstance(raw, tuple) and models and get_origin(field.annotation) is tuple:
            items = []
            for index, item in enumerate(raw):
                fitting = models
                if len(models) > 1:
                    kind = _kind_in(item, models) if isinstance(item, dict) else None
                    fitting = [model for model in models if kind_of(model) == kind]
                usable = isinstance(item, dict) and fitting
                items.append(sound(fitting[0], item, f"{name}.{index}") if usable else Absent())
            tables[name] = tuple(items)
    return tables, problems


class Place(NamedTuple):
    """Where an error is: dotted path, the field, the value, and the table that holds it."""

    path: str
    field: FieldInfo | None
    value: Any
    table: type[Table]
    annotation: Any


def models_of(annotation: Any) -> list[type[Table]]:
    if isinstance(annotation, type) and not isinstance(annotation, types.GenericAlias):
        return [annotation] if issubclass(annotation, Table) else []
    return [model for part in get_args(annotation) for model in models_of(part)]


def kind_of(model: type[Table]) -> str:
    return str(get_args(model.model_fields["kind"].annotation)[0])


def _kind_in(value: dict[str, Any], models: Sequence[type[Table]]) -> Any:
    """Return the kind of a table of a union; left out, the first model's where that has a default."""
    default = models[0].model_fields["kind"].default
    return value.get("kind", default if isinstance(default, str) else None)


def walk(loc: Sequence[int | str], data: dict[str, Any]) -> Place:
    """Follow an error's location through data and models; tags of unions are not part of the path."""
    path: list[str] = []
    value: Any = data
    annotation: Any = Scene
    table: type[Table] = Scene
    field: FieldInfo | None = None
    for part in loc:
        models = models_of(annotation)
        if isinstance(part, int):
            path.append(str(part))
            value = value[part] if isinstance(value, tuple) and part < len(value) else MISSING
            arguments = get_args(unwrap(annotation))
            annotation = arguments[0] if arguments else Any
        elif len(models) > 1 and isinstance(value, dict) and _kind_in(value, models) == part:
            annotation = next(model for model in models if kind_of(model) == part)
        elif get_origin(annotation) is dict:
            path.append(part)
            value = value.get(part, MISSING) if isinstance(value, dict) else MISSING
            annotation = get_args(annotation)[1]
        elif not models and get_origin(unwrap(annotation)) in (types.UnionType, Union):
            continue  # one of several plain types
        else:
            path.append(part)
            value = value.get(part, MISSING) if isinstance(value, dict) else MISSING
            table = models[0] if models else table
            field = table.model_fields.get(part)
            annotation = field.annotation if field else Any
    return Place(".".join(path), field, value, table, annotation)


def unwrap(annotation: Any) -> Any:
    """Return ``X`` for ``X | None`` and for ``Annotated[X, ...]``."""
    if get_origin(annotation) in (types.UnionType, Union):
        rest = [part for part in get_args(annotation) if part is not type(None)]
        return unwrap(rest[0]) if len(rest) == 1 else annotation
    return annotation


def is_table(value: Any) -> bool:
    return isinstance(value, dict) or (isinstance(value, tuple) and bool(value) and isinstance(value[0], dict))
