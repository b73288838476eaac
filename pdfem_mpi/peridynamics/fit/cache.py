"""Fits of bond factors on disk, named by their fingerprint, so that a series or a restart never fits twice.

A file holds the multipliers of all points and the report, and the sha256 of both; what does not read back is no fit,
nor is a file of another user.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import zlib
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np

from pdfem_mpi.system.private_folders import is_own_file

#: Most bytes of fits kept in a folder; the oldest go first.
MOST_BYTES = 4 * 2**30


def load(folders: tuple[Path, ...], key: str) -> tuple[dict[str, Any], list[np.ndarray]] | None:
    """The report and the multipliers, shapes (n_cells, 8, m), of a fit; None where no folder has it whole."""
    for folder in folders:
        try:
            with open(os.open(_path(folder, key), os.O_RDONLY | os.O_NONBLOCK), "rb") as opened:
                if not is_own_file(opened.fileno()):
                    continue  # another user's numbers would be taken for a fit
                with np.load(opened, allow_pickle=False) as file:
                    report, stored, digest = str(file["report"]), file["multipliers"], str(file["sha256"])
        except (OSError, ValueError, KeyError, BadZipFile, EOFError, zlib.error):
            continue
        if digest == _digest(report, stored):
            return json.loads(report), list(stored)
    return None


def store(folders: tuple[Path, ...], key: str, report: dict[str, Any], stored: np.ndarray) -> None:
    """Leave a fit, multipliers of shape (n, n_cells, 8, m), in every folder that can be written.

    A folder that cannot is no error.
    """
    text = json.dumps(report)
    for folder in folders:
        path = _path(folder, key)
        temporary = path.with_suffix(f".tmp.{os.getpid()}")
        try:
            folder.mkdir(parents=True, exist_ok=True)
            temporary.unlink(missing_ok=True)
            with temporary.open("xb") as file:
                np.savez(file, report=text, multipliers=stored, sha256=_digest(text, stored))
            temporary.replace(path)
            _drop_oldest(folder, path)
        except OSError:
            with contextlib.suppress(OSError):
                temporary.unlink()


def _path(folder: Path, key: str) -> Path:
    return folder / f"bond_factors-{key[:24]}.npz"


def _digest(report: str, stored: np.ndarray) -> str:
    digest = hashlib.sha256(report.encode() + str(stored.shape).encode())
    digest.update(stored)  # not a copy of it: it is as large as some of the bonds
    return digest.hexdigest()


def _drop_oldest(folder: Path, keep: Path) -> None:
    files = sorted(folder.glob("bond_factors-*.npz"), key=lambda path: path.stat().st_mtime)
    total = sum(path.stat().st_size for path in files)
    for path in files:
        if total > MOST_BYTES and path != keep:
            total -= path.stat().st_size
            path.unlink()
