"""What two things of a run differ in, array by array."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from pdfem_mpi.body.boundaries import Boundaries

#: What belongs to the ranks that ask, and not to the body.
LEFT_OUT = ("comm", "everywhere")


def differences(one: Any, other: Any, path: str = "") -> Iterator[str]:
    """Names of what has other types, shapes or bits."""
    if isinstance(one, np.ndarray):
        if one.dtype != other.dtype or not np.array_equal(one, other):
            yield f"{path}: {one.dtype}{one.shape} and {other.dtype}{other.shape}"
    elif dataclasses.is_dataclass(one):
        for name in (field.name for field in dataclasses.fields(one) if field.name not in LEFT_OUT):
            yield from differences(getattr(one, name), getattr(other, name), f"{path}.{name}")
    elif isinstance(one, Boundaries):
        yield from differences(vars(one), vars(other), path)
    elif isinstance(one, Mapping):
        if list(one) != list(other):
            yield f"{path}: {list(one)} and {list(other)}"
        else:
            for key in one:
                yield from differences(one[key], other[key], f"{path}[{key}]")
    elif isinstance(one, tuple | list):
        if len(one) != len(other):
            yield f"{path}: {len(one)} and {len(other)}"
        for number, pair in enumerate(zip(one, other, strict=False)):
            yield from differences(*pair, f"{path}[{number}]")
    elif one != other:
        yield f"{path}: {one} and {other}"
