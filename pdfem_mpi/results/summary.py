"""summary.json: the result of a run for programs to read; strict JSON, where an unknown value is null."""

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from pdfem_mpi.system.files import replacing


def write_summary(path: str | Path, content: Mapping[str, Any]) -> None:
    """Write ``content`` as JSON under a temporary name, then rename it to ``path``.

    Parameters
    ----------
    path : str or Path
        The file to write; an older one is replaced only when the new one is complete.
    content : mapping
        Nested mappings, lists, tuples, numpy arrays and scalars, strings, numbers, None. Keys keep their
        order; NaN and infinities become null.

    Raises
    ------
    TypeError
        A value that JSON cannot hold. Nothing is written then.
    """
    text = json.dumps(_plain(content), indent=2, ensure_ascii=False, allow_nan=False) + "\n"
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def _plain(value: Any) -> Any:
    """Return ``value`` in the types that JSON knows, non-finite numbers as None."""
    if isinstance(value, (np.ndarray, np.generic)):
        value = value.tolist()
    if isinstance(value, Mapping):
        return {str(_plain(key)): _plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return str(value) if isinstance(value, Path) else value
