"""summary.json: the result of a run for programs to read; strict JSON, where an unknown value is null."""

import contextlib
import hashlib
import json
import math
from collections.abc import Iterable, Mapping
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
    text = _dumps(_plain(content)) + "\n"
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8", errors="backslashreplace")  # as JSON escapes it


def sealed(content: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """Add the sha256 of the files that are written once, and last that of the content itself.

    Parameters
    ----------
    folder : Path
        The run folder: of its ``lines`` and ``figures``.
    """
    files = {name: _sha256(folder / name) for name in _written_once(folder)}
    plain = _plain(content) | {"files": files}
    return plain | {"sha256": _digest(plain)}


def check_summary(folder: Path) -> tuple[str | None, list[str]]:
    """The status in a run folder's summary, and what is wrong with the summary or with the files that it names.

    Returns
    -------
    status : str or None
        None without a summary; "unknown" for one that is damaged, or is not of the deck in the folder.
    notes : list of str
    """
    path, again = folder / "summary.json", "it is written again"
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        status, digest = str(content["status"]), content.pop("sha256", None)
        files = dict(content.get("files", {}))
        whole = digest in (None, _digest(content))
    except FileNotFoundError:
        return None, []
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        return "unknown", [f"summary.json cannot be read ({type(error).__name__}): {again}"]
    if not whole:
        return "unknown", [f"summary.json is damaged: {again}"]
    with contextlib.suppress(OSError):
        if content.get("deck_sha256") not in (None, _sha256(folder / "deck.toml")):
            return "unknown", [f"summary.json is of another deck than deck.toml, or of another run: {again}"]
    notes = [f"{name} is missing or damaged: {again}" for name in files if files[name] != _sha256(folder / name)]
    return ("unknown" if notes and status == "finished" else status), notes


def _written_once(folder: Path) -> Iterable[str]:
    for kind in ("lines", "figures"):
        for path in sorted((folder / kind).glob("*")):
            if path.is_file():
                yield f"{kind}/{path.name}"


def _sha256(path: Path) -> str | None:
    """Digest of a file; None if there is none that can be read."""
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError:
        return None


def _digest(plain: Any) -> str:
    return hashlib.sha256(_dumps(plain).encode(errors="backslashreplace")).hexdigest()


def _dumps(plain: Any) -> str:
    return json.dumps(plain, indent=2, ensure_ascii=False, allow_nan=False)


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
