"""What of a finished run folder can go: checkpoints and frames, and only files that the program surely wrote."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

from pdfem_mpi.results.ownership import Written, is_checkpoint, is_run
from pdfem_mpi.results.read_frames import deck_of
from pdfem_mpi.results.run_folder import read_summary
from pdfem_mpi.system.lock import owner_of

FRAMES = ("points.vtkhdf", "elements.vtkhdf", "body.vtkhdf")


class NotCleaned(Exception):
    """A folder that is left as it is; the sentence says why, and what to do."""


@dataclass(frozen=True)
class Removable:
    """Files that can go, and others in their places that stay.

    Attributes
    ----------
    files : list of (Path, int)
        With their bytes.
    kept : list of Path
        What has the name of a checkpoint or of frames, and is not what the program wrote.
    """

    files: list[tuple[Path, int]]
    kept: list[Path]


def find_removable(folder: Path, checkpoints: bool, frames: bool) -> Removable:
    """Checkpoints and frames of a finished run, which nothing is removed of yet.

    Raises
    ------
    NotCleaned
        The folder is no run's, the run is not finished, or a job writes into it.
    """
    if not folder.is_dir() or not is_run(folder):
        raise NotCleaned(f"{folder} holds no run of pdfem_mpi: nothing is removed. Give a folder that a run wrote.")
    owner = owner_of(folder)
    if owner and owner[1] is not False:
        raise NotCleaned(f"{folder}: {owner[0]} may be writing into it. Wait for its end, or remove {folder}/RUNNING.")
    status = (read_summary(folder) or {}).get("status")
    if status != "finished":
        told = f"it is {status}" if status else "it has no summary.json"
        raise NotCleaned(
            f"{folder}: the run is not finished ({told}), and goes on from its checkpoints. Finish it with `pdfem "
            f"resume {folder}`, or remove the folder by hand."
        )
    found: list[Path] = []
    kept: list[Path] = []
    if checkpoints:
        for path in sorted((folder / "checkpoints").glob("ckpt-*")):
            (found if is_checkpoint(path) else kept).append(path)
    if frames:
        written = Written(folder)
        for path in (folder / name for name in FRAMES):
            if path.exists():
                ours = written.has(path.name) and not path.is_symlink() and deck_of(path) is not None
                (found if ours else kept).append(path)
    return Removable([(path, path.stat().st_size) for path in found], kept)


def remove(removable: Removable) -> int:
    """Remove the files, and the folder of checkpoints if it is empty then; the bytes that are free."""
    free = 0
    for path, size in removable.files:
        path.unlink()
        free += size
    for folder in {path.parent for path, _ in removable.files if path.parent.name == "checkpoints"}:
        if not os.listdir(folder):
            folder.rmdir()
    return free
