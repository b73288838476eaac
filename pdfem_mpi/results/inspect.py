"""What a run folder or a checkpoint is, in words: `pdfem info`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from pdfem_mpi.results.checkpoint import Invalid, check
from pdfem_mpi.results.checkpoint_files import list_checkpoints
from pdfem_mpi.results.cursor import find_damage
from pdfem_mpi.results.summary_file import check_summary
from pdfem_mpi.system.lock import owner_of
from pdfem_mpi.system.plain_files import read_plain

MOST_BYTES = 1 << 24
Rows = list[tuple[str, str]]


def describe(path: Path) -> tuple[str, Rows, str | None]:
    """Return a title, rows of a table, and what is wrong, None if nothing is.

    A folder is sound if it holds a run that is finished, or that can be gone on with.
    """
    return _describe_folder(path) if path.is_dir() else _describe_file(path)


def _describe_file(path: Path) -> tuple[str, Rows, str | None]:
    try:
        header = check(path)
    except Invalid as error:
        return f"{path}", [], f"{path}: {error}."
    state = header["state"]
    rows = [
        ("written", f"{header['written']} by pdfem_mpi {header['versions']['pdfem_mpi']} on {header['ranks']} ranks"),
        ("step", f"{state['step']}, iteration {state['iteration']}"),
        ("load factor", f"{state['load_factor']:.6g}"),
        ("broken bonds", f"{header['broken_bonds']:,}"),
        ("force evaluations", f"{header['evaluations']:,}"),
        ("seconds of the run", f"{header['seconds']:.1f}"),
        ("restarts", f"{len(header['restarts'])}"),
        ("scene", header["fingerprint"][:16]),
        ("size", _size(path)),
        ("sound", "yes"),
    ]
    return f"{path}: a checkpoint", rows, None


def _describe_folder(folder: Path) -> tuple[str, Rows, str | None]:
    rows: Rows = []
    try:
        summary = json.loads(read_plain(folder / "summary.json", MOST_BYTES))
        rows.append(("status", f"{summary['status']}, exit code {summary['exit_code']}"))
    except FileNotFoundError:
        summary = {}
        rows.append(("status", "running, or ended at once"))
    except (OSError, ValueError, KeyError, TypeError):
        summary = {}
        rows.append(("status", "summary.json cannot be read"))
    rows += _of_failure(summary.get("failure"))
    if owner := owner_of(folder):
        state = {True: "alive", False: "gone", None: "on another host, or unknown"}[owner[1]]
        rows.append(("RUNNING", f"{owner[0]}: {state}"))
    found = list_checkpoints(folder / "checkpoints")
    sound = 0
    for _, path in found:
        try:
            header = check(path)
        except Invalid as error:
            rows.append((path.name, f"not sound: {error}"))
            continue
        if not sound:
            damage = find_damage(folder, header["results"]) + check_summary(folder)[1]
            rows.append(("results", "; ".join(damage) or "as they were written"))
        sound += 1
        state = header["state"]
        rows.append(
            (
                path.name,
                f"sound: step {state['step']}, iteration {state['iteration']}, load {state['load_factor']:.6g}, "
                f"{header['broken_bonds']:,} broken bonds, {_size(path)}, {header['written']}",
            )
        )
    if not found and not summary and not (folder / "deck.toml").exists():
        return f"{folder}", [], f"{folder} holds no run: it has no deck.toml, summary.json or checkpoint."
    if found and not sound:
        return f"{folder}: a run", rows, f"no checkpoint in {folder} is sound. Start again with --overwrite."
    if not found:
        rows.append(("checkpoints", "none"))
    return f"{folder}: a run", rows, None


def _of_failure(failure: Any) -> Rows:
    """First break, peak, and bonds of a run that could fail; nothing of what an older version did not write."""
    rows: Rows = []
    if not isinstance(failure, dict):
        return rows
    for name, key in (("first break", "first_break"), ("peak", "peak")):
        found = failure.get(key)
        if isinstance(found, dict):
            rows.append((name, f"{found.get('load'):.6g} at {found.get('displacement'):.6g}, row {found.get('row')}"))
    if "broken_bonds" in failure:
        rows.append(("bonds broken, softened", f"{failure['broken_bonds']:,}, {failure.get('softened_bonds', 0):,}"))
    return rows


def _size(path: Path) -> str:
    return f"{path.stat().st_size / 1e6:.1f} MB"
