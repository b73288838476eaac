"""Reading a file of frames back, to see whether it still holds what was written; see frame_digest.py."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import h5py
import numpy as np

from pdfem_mpi.results.frame_digest import FrameDigest
from pdfem_mpi.results.own_storage import elsewhere

KINDS = ("PointData", "CellData", "FieldData")
#: Of a run folder: the peridynamic points.
POINTS_FILE = "points.vtkhdf"


def rows_of(root: h5py.Group, kind: str) -> int:
    """Rows of a field of one frame: a value at each point, at each cell, or one for the frame."""
    count = {"PointData": "NumberOfPoints", "CellData": "NumberOfCells"}.get(kind)
    return int(root[count][0]) if count else 1


def frame_numbers(path: str | Path) -> dict[str, np.ndarray]:
    """Numbers of each frame by name, such as ``load_factor``, float64, shape (n_frames,).

    Files of earlier versions have none, and load factors for times.
    """
    with h5py.File(path, "r", locking=False) as file:
        root = file["VTKHDF"]
        present, numbers = int(root["Steps"].attrs["NSteps"]), root.get("FieldData", {})
        found = {name: table[:present] for name, table in numbers.items()}
        return found or {"load_factor": root["Steps/Values"][:present]}


def has_damage(path: Path) -> bool:
    """Whether a file is there, and has frames with the damage of points."""
    if not path.exists():
        return False
    with h5py.File(path, "r", locking=False) as file:
        steps = file["VTKHDF/Steps"]
        return bool(steps.attrs["NSteps"]) and "damage" in steps["PointDataOffsets"]


def frame_rows(path: str | Path) -> np.ndarray:
    """Row of history.csv that each frame is of, from 0, int64, shape (n_frames,)."""
    with h5py.File(path, "r", locking=False) as file:
        root = file["VTKHDF"]
        times = root["Steps/Values"][: int(root["Steps"].attrs["NSteps"])]
        return times.astype(np.int64) - 1 if root.get("FieldData") else np.arange(len(times))


def read_digest(path: str | Path, frames: int, entries: tuple[str, ...]) -> FrameDigest:
    """Digest of a file and its first frames, read as a viewer reads it.

    Parameters
    ----------
    frames : int
        How many frames.
    entries : tuple of str
        Arrays of ``Steps`` beside its times and offsets of fields.

    Raises
    ------
    ValueError
        It has fewer frames, or data in other files.
    OSError, KeyError, RuntimeError
        It cannot be read.
    """
    with h5py.File(path, "r", locking=False) as file:
        if reason := elsewhere(file):
            raise ValueError(f"it {reason}")
        root = file["VTKHDF"]
        steps = root["Steps"]
        present = int(steps.attrs["NSteps"])
        if not 0 <= frames <= present:
            raise ValueError(f"it has {present} frames, and {frames} when they were written")
        moving = {
            f"{kind}/{name}": table[:] for kind in KINDS for name, table in steps.get(f"{kind}Offsets", {}).items()
        }
        digest = FrameDigest()
        _add_static(digest, file, moving)
        rows = {kind: rows_of(root, kind) for kind in KINDS}
        times, tables = steps["Values"][:], {name: steps[name][:] for name in entries}
        for frame in range(frames):
            fields = {}
            for name, offsets in moving.items():
                count = rows[name.partition("/")[0]]
                if offsets[frame] != frame * count:
                    raise ValueError(f"its {name} of frame {frame} begins at row {offsets[frame]}")
                fields[name] = root[name][frame * count : (frame + 1) * count]
            digest.add_frame(times[frame], {name: table[frame] for name, table in tables.items()}, fields)
        return digest


def _add_static(digest: FrameDigest, file: h5py.File, moving: Mapping[str, object]) -> None:
    """Add everything that no frame changes: attributes, geometry, static fields."""
    root = file["VTKHDF"]
    for owner, attributes in (("/", file.attrs), ("/VTKHDF", root.attrs)):
        for name in sorted(attributes):
            digest.add(f"{owner} {name}", np.frombuffer(repr(attributes[name]).encode(), np.uint8))
    for name in sorted(root):
        if isinstance(root[name], h5py.Dataset):
            digest.add(name, root[name][()])
    for kind in KINDS:
        for name in sorted(root.get(kind, ())):
            if f"{kind}/{name}" not in moving:
                digest.add(f"{kind}/{name}", root[kind][name][()])


def deck_of(path: str | Path) -> str | None:
    """Digest of the deck that a file was begun for; None if it does not say."""
    try:
        with h5py.File(path, "r", locking=False) as file:
            return str(file.attrs["deck_sha256"])
    except (OSError, KeyError, RuntimeError, ValueError):
        return None
