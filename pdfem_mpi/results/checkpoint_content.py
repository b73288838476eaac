"""What a checkpoint must hold beside a sound seal: a whole header, tables of the right names and shapes, and no others.

The seal says that a file is as it was written, not by whom. A file that another program made, or that someone put
together, is refused here by the name of what is wrong, before a number of it is used.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import h5py
import numpy as np

from pdfem_mpi.results.own_storage import elsewhere

HEADER, BROKEN, TURNED, PLACES = "header", "broken", "turned", ("points", "nodes")
NUMBER = (int, float)
#: Keys of the header that a run goes on from, and the types of their values.
KEYS: dict[str, tuple[type, ...]] = {
    "written": (str,), "versions": (dict,), "cpu": (str,), "code_sha256": (str,), "ranks": (int,),
    "fingerprint": (str,), "keys": (dict,), "state": (dict,), "broken_bonds": (int,), "failure": (dict, type(None)),
    "evaluations": (int,), "seconds": NUMBER, "restarts": (list,), "results": (dict,),
}  # fmt: skip
STATE_KEYS: dict[str, tuple[type, ...]] = {
    "step": (int,), "load_factor": NUMBER, "iteration": (int,), "spent": (int,), "seconds": NUMBER, "bounds": (dict,),
    "program": (dict,),
}  # fmt: skip
RESULT_KEYS = ({"rows", "bytes"}, {"frames"})


def find_fault(file: h5py.File, header: Any) -> str | None:
    """Why an open file with this header is no checkpoint that a run can go on from; None if nothing is wrong."""
    if reason := elsewhere(file):
        return f"it {reason}"
    return _header_fault(header) or _table_fault(file, header)


def _header_fault(header: Any) -> str | None:
    if not isinstance(header, dict):
        return "its header is not a table of keys"
    state = header.get("state")
    for table, keys, where in ((header, KEYS, ""), (state, STATE_KEYS, "state.")):
        if not isinstance(table, dict):
            return "its header has no state"
        for key, types in keys.items():
            if key not in table:
                return f"its header has no {where}{key}"
            if not isinstance(table[key], types) or (isinstance(table[key], bool) and bool not in types):
                return f"its header has {where}{key} of type {type(table[key]).__name__}"
    if state["step"] < 0 or state["iteration"] < 0 or header["broken_bonds"] < 0:
        return "its header counts below zero"
    if not isinstance(header["versions"].get("pdfem_mpi"), str):
        return "its header does not say which version wrote it"
    if not _are_bounds(state["bounds"]):
        return "its header has state.bounds of another form"
    if not all(isinstance(value, (int, float)) for value in state["program"].values()):
        return "its header has a state.program of another form"
    return _failure_fault(header["failure"]) or _results_fault(header["results"])


def _are_bounds(bounds: Any) -> bool:
    return (
        isinstance(bounds, dict)
        and all(isinstance(bounds.get(key), (int, float)) for key in ("bond", "element"))
        and isinstance(bounds.get("parts"), dict)
        and all(_are_bounds(part) for part in bounds["parts"].values())
    )


def _failure_fault(books: Any) -> str | None:
    if books is None or all(isinstance(books.get(key), list) for key in ("dissipated", "last_extent")):
        return None
    return "its header has a failure of another form"


def _results_fault(results: Mapping[str, Any]) -> str | None:
    for name, cursor in results.items():
        whole = isinstance(cursor, dict) and any(keys <= cursor.keys() for keys in RESULT_KEYS)
        counts = whole and all(isinstance(cursor.get(key, 0), int) for key in ("rows", "bytes", "frames"))
        if not counts or "/" in name or name.startswith("."):
            return f"its header has results.{name} of another form"
    return None


def _table_fault(file: h5py.File, header: Mapping[str, Any]) -> str | None:
    """Names, types and shapes: three numbers a row of the fields, as many rows in each, pairs of broken bonds."""
    if others := set(file) - {HEADER, BROKEN, TURNED, *PLACES}:
        return f"it has {sorted(others)[0]}, which no checkpoint has"
    fields = header["state"].get("fields")
    for place in PLACES:
        if place not in file:
            continue
        tables = file[place]
        names = set(tables) if fields is None else set(fields)
        if not isinstance(tables, h5py.Group) or set(tables) != names:
            return f"its {place} are not the fields that its header names"
        for name in sorted(names):
            table = tables[name]
            if table.ndim != 2 or table.shape[1] != 3 or table.dtype != np.float64:
                return f"its table {place}/{name} has shape {table.shape} of {table.dtype}"
        if len({len(tables[name]) for name in names}) > 1:
            return f"its tables {place} have different lengths"
    turned = file.get(TURNED)
    if turned is not None and (turned.ndim != 2 or turned.shape[1] != 1 or turned.dtype != np.uint64):
        return f"its table turned has shape {turned.shape} of {turned.dtype}"
    broken = file.get(BROKEN)
    if broken is None:
        return "it has no table broken"
    shapes = {(header["broken_bonds"], columns) for columns in (2, 3)}
    if broken.shape not in shapes or broken.dtype not in (np.uint32, np.uint64):
        return f"its table broken has shape {broken.shape} of {broken.dtype} for {header['broken_bonds']} bonds"
    return None
