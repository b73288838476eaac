"""Which checkpoint a run starts from, and with which options."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pdfem_mpi.results.cursor import find_damage
from pdfem_mpi.results.summary_file import check_summary
from pdfem_mpi.runs.environment import environment
from pdfem_mpi.runs.identity import differences, free_changes
from pdfem_mpi.system.exit_codes import EXIT_NO_CHECKPOINT, EXIT_USAGE
from pdfem_mpi.system.signals import Requests

FOLDER = "checkpoints"
MOST_BYTES = 1 << 24  # of a summary
AUTO, NEVER, CONTINUE = "auto", "never", "continue"


class Refused(Exception):
    """A run that is not started: one sentence and an exit code. Raised on all ranks alike."""

    def __init__(self, code: int, sentence: str):
        self.code = code
        super().__init__(sentence)


@dataclass(frozen=True)
class RunOptions:
    """How a run is started, and what may stop it.

    Attributes
    ----------
    resume : str
        "auto": start or go on; "never": start; "continue": go on, also from the end of a run; or a checkpoint's name.
    steal_lock, force : bool
        Take a folder that another job may hold; go on although the scene is another.
    end : float or None
        Time of ``monotonic`` by which the run must be over.
    watched : bool
        Whether the watchdog runs.
    requests : Requests
        What signals ask.
    deck : Path or None
        The deck that is read, which the run must not replace; None where it may, as when a run goes on in its folder.
    """

    resume: str = AUTO
    steal_lock: bool = False
    force: bool = False
    end: float | None = None
    watched: bool = False
    requests: Requests = field(default_factory=Requests)
    deck: Path | None = None


@dataclass
class RestartPoint:
    """Where a run starts.

    Attributes
    ----------
    path : Path or None
        The checkpoint; None: at the beginning.
    header : dict
        The checkpoint's.
    passed : list of (Path, str)
        Newer checkpoints, and what they are called from now on: "damaged" or "superseded".
    notes : list of str
        What the user should know.
    finished : bool
        The run has nothing left to do unless the deck was changed.
    changed : bool
        The deck is not that of the checkpoint.
    other_fields : bool
        Frames have other fields than before.
    seconds_before : float
        Of all earlier starts.
    restarts : list of dict
        One entry for each start but the first, this one's included.
    """

    path: Path | None = None
    header: dict[str, Any] = field(default_factory=dict)
    passed: list[tuple[Path, str]] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    finished: bool = False
    changed: bool = False
    other_fields: bool = False
    seconds_before: float = 0.0
    restarts: list[dict[str, Any]] = field(default_factory=list)

    @property
    def results(self) -> dict[str, dict[str, int]]:
        """How much of each result file belongs to the checkpoint."""
        return self.header.get("results", {})


def choose_start(out: Path, resume: str, overwrite: bool) -> RestartPoint:
    """Decide on rank 0 where a run starts; nothing is changed.

    Raises
    ------
    Refused
        The folder holds a run that must not be touched, or no checkpoint can be used.
    """
    from pdfem_mpi.results.checkpoint_files import list_checkpoints

    named = resume not in (AUTO, NEVER, CONTINUE)
    if overwrite and named:
        raise Refused(
            EXIT_USAGE,
            f"--overwrite starts at the beginning and removes what {out} holds, --resume {resume} goes on from there. "
            "Leave one of them away.",
        )
    if overwrite:
        return RestartPoint()
    if named:
        return _start_from(out, Path(resume))
    found = list_checkpoints(out / FOLDER)
    status, notes = check_summary(out)
    if (resume == NEVER and (status or found)) or (resume == AUTO and (status == "finished" or (status and not found))):
        raise Refused(
            EXIT_USAGE,
            f"the folder {out} already holds a run. Use --overwrite, or another folder with --out."
            + (" `pdfem resume` goes on with a longer program." if status == "finished" and found else ""),
        )
    if not found and status == "finished":
        raise Refused(
            EXIT_NO_CHECKPOINT,
            f"the run in {out} is finished, and no checkpoint is left to go on from. Run its deck again in another "
            "folder (--out), or here with --overwrite.",
        )
    if not found:
        begun = (out / "deck.toml").exists()
        return RestartPoint(notes=[*notes, "there is no checkpoint yet: starting at the beginning"] if begun else [])
    passed: list[tuple[Path, str]] = []
    for _, path in found:
        header, reason = _checked(path)
        if reason is None:
            # the last checkpoint of a finished run says that it is over: without that one, the end is computed again
            over = status == "finished" and not passed and bool(header["state"]["program"].get("over"))
            damage = find_damage(out, header["results"]) if over else []
            return RestartPoint(path, header, passed, notes + damage, over and not damage)
        notes.append(f"{path.name} is passed over: {reason}")
        passed.append((path, "damaged"))
    reasons = "; ".join(note.replace(" is passed over", "") for note in notes)
    raise Refused(
        EXIT_NO_CHECKPOINT,
        f"no checkpoint in {out / FOLDER} can be used: {reasons}. Start again with --overwrite.",
    )


def _start_from(out: Path, path: Path) -> RestartPoint:
    """A checkpoint that was asked for by name; results go on only if it belongs to this folder."""
    from pdfem_mpi.results.checkpoint import Invalid, check
    from pdfem_mpi.results.checkpoint_files import list_checkpoints

    try:
        header = check(path)
    except Invalid as error:
        raise Refused(EXIT_NO_CHECKPOINT, f"{path}: {error}. Give another checkpoint.") from None
    if path.parent.resolve() == (out / FOLDER).resolve():
        newer = [p for _, p in list_checkpoints(out / FOLDER) if p.name > path.name]
        return RestartPoint(path, header, [(p, "superseded") for p in newer])
    if check_summary(out)[0] or list_checkpoints(out / FOLDER):
        raise Refused(EXIT_USAGE, f"the folder {out} already holds a run. Use another folder with --out.")
    notes = ["results begin at this checkpoint: it is of another folder"]
    return RestartPoint(path, {**header, "results": {}}, notes=notes)


def _checked(path: Path) -> tuple[dict[str, Any], str | None]:
    """Header of a checkpoint, or why it cannot be used."""
    from pdfem_mpi.results.checkpoint import Invalid, check

    try:
        return check(path), None
    except Invalid as error:
        if error.newer:
            raise Refused(EXIT_NO_CHECKPOINT, f"{path}: {error}. Use that version of pdfem_mpi.") from None
        return {}, str(error)


def compare(start: RestartPoint, keys: dict[str, Any], force: bool) -> list[str]:
    """Compare a checkpoint's scene with the deck's; return the changes, for the log.

    Raises
    ------
    Refused
        With every key that differs.
    """
    header = start.header
    refused, changes = differences(header["keys"], keys, header["state"]["step"])
    start.changed = bool(refused or changes)
    start.other_fields = any(header["keys"].get(key) != keys[key] for key in ("output.fields", "output.damage"))
    if refused and not force:
        raise Refused(
            EXIT_NO_CHECKPOINT,
            f"{start.path}: written for another scene: {'; '.join(refused)}. Restore these keys, or choose a new "
            "folder with --out.",
        )
    changes += free_changes(header["keys"], keys)
    now = environment()
    for what in ("versions", "cpu", "code_sha256"):
        if header[what] != now[what]:
            name = {"versions": "packages", "cpu": "CPU", "code_sha256": "version of pdfem_mpi's source"}[what]
            changes.append(f"it was written with another {name}: equal bits are promised for the same only")
    return [f"forced: {key}" for key in refused] + changes
