"""Which files of a folder this program wrote: it removes those and no others, and works in no folder but a run's.

``run.files`` in a run folder has a line for each name, written before the file is. Run folders from before it have the
names that a run always writes.
"""

from __future__ import annotations

import contextlib
import csv
import hashlib
import json
import os
import re
import tomllib
from collections.abc import Iterable
from pathlib import Path

from pdfem_mpi.system.plain_files import open_plain, read_plain, strange_kind

RECORD = "run.files"
_FIRST_LINE = "pdfem_mpi run: files that the program wrote, and may replace or remove"
DECK = "deck.toml"
_FIRST_RESULTS = ("history.csv", "points.vtkhdf", "elements.vtkhdf", "run.log")
RESULTS = (*_FIRST_RESULTS, "body.vtkhdf")
SUMMARY = "summary.json"
#: Written while the lock is held, and continued from start to start.
STARTS = "starts.jsonl"
_FIGURES = ("reaction.png", "energies.png", "damage.png", "damage.gif", "axial_displacement.png")
#: Names that are this program's wherever they are.
_OURS = re.compile(
    r"RUNNING(\.\d+)?|run\.r\d+\.(hang|log)|bond_factors-[0-9a-f]{24}\.(npz|tmp\.\d+)|run\.files|starts\.jsonl"
)
_CHECKPOINT = re.compile(r"ckpt-\d{6,}\.h5(\.tmp\..+|\.damaged|\.superseded)?")
_MOST_BYTES = 1 << 24
_SHOWN = 3


def refuse_folder(folder: Path) -> str | None:
    """Return why a run must not work in a folder, in a sentence with the remedy; None if it may.

    It may in a folder that is not there, is empty, or is a run's; pipes and devices in the place of its files are no
    run's.
    """
    try:
        names = sorted(os.listdir(folder))
    except FileNotFoundError:
        return None
    except NotADirectoryError:
        return f"{folder} is not a folder. Choose another one with --out."
    foreign = [name for name in names if not _OURS.fullmatch(name)]
    if foreign and not is_run(folder):
        more = ", ..." if len(foreign) > _SHOWN else ""
        return (
            f"the folder {folder} is not empty and holds no run of pdfem_mpi ({', '.join(foreign[:_SHOWN])}{more}): "
            "its files are left alone. Give a new or an empty folder with --out."
        )
    for name in names:
        is_ours = name in (*RESULTS, SUMMARY, DECK) or _OURS.fullmatch(name)
        if is_ours and (kind := strange_kind(folder / name)):
            return f"{folder / name} is {kind}, not a file. Remove it, or give another folder with --out."
    return None


def is_run(folder: Path) -> bool:
    """Return whether a run of this program wrote into a folder, now or before it kept a record of its files."""
    if _text(folder / RECORD).startswith(_FIRST_LINE):
        return True
    if _object(folder / "RUNNING").keys() >= {"host", "pid"}:
        return True
    if _object(folder / SUMMARY).keys() >= {"schema_version", "status", "exit_code", "deck_sha256"}:
        return True
    if any(_starts_with(path, b"pdfem_mpi checkpoint\n") for path in (folder / "checkpoints").glob("ckpt-*.h5")):
        return True
    begun = _starts_with(folder / "history.csv", b"step,event,load_factor,")
    logged = re.match(r"\d{4}-\d\d-\d\d \d\d:\d\d:\d\d  ", _text(folder / "run.log"))
    return (folder / DECK).is_file() and bool(begun or logged)


def is_checkpoint(path: Path) -> bool:
    """Return whether a file has a checkpoint's name, and begins as this program's checkpoints do."""
    named = _CHECKPOINT.fullmatch(path.name) and not path.is_symlink()
    return bool(named) and _starts_with(path, b"pdfem_mpi checkpoint\n")


def is_study(folder: Path) -> bool:
    """Return whether a folder holds a study's table."""
    with contextlib.suppress(OSError, csv.Error, ValueError):
        first = next(csv.reader(_text(folder / "study.csv").splitlines()), [])
        return {"status", "exit_code", "reason", "folder", "deck_sha256"} <= set(first)
    return False


def refuse_study(folder: Path) -> str | None:
    """Return why a study must not work in a folder, as `refuse_folder` does for a run."""
    try:
        names = sorted(os.listdir(folder))
    except FileNotFoundError:
        return None
    except NotADirectoryError:
        return f"{folder} is not a folder. Choose another one with --out."
    if not names or is_study(folder) or any(is_run(member) for member in (folder / "members").glob("*")):
        return None
    more = ", ..." if len(names) > _SHOWN else ""
    return (
        f"the folder {folder} is not empty and holds no study ({', '.join(names[:_SHOWN])}{more}): its files are left "
        "alone. Give a new or an empty folder with --out."
    )


def refuse_deck(folder: Path, deck: Path, same: bool) -> str | None:
    """Return why a run must not work in the folder of the deck that it reads, if its deck is in the way.

    Parameters
    ----------
    deck : Path
        The deck that is read.
    same : bool
        It says what the run's own copy would, so that it can stay as it is.
    """
    try:
        inside = deck.resolve().relative_to(folder.resolve()).as_posix()
    except ValueError:
        return None
    in_the_way = inside in (*RESULTS, SUMMARY, RECORD) or _OURS.fullmatch(inside) or (inside == DECK and not same)
    if not in_the_way:
        return None
    return (
        f"{deck} is the deck that is read, and a run in {folder} would replace it. Give another folder with --out, or "
        "go on with `pdfem resume`."
    )


class Written:
    """The files that this program wrote into a run folder.

    Parameters
    ----------
    folder : Path
        It must exist.

    Attributes
    ----------
    is_new : bool
        There was no record before `begin`.
    """

    def __init__(self, folder: Path):
        self.folder = folder
        lines = _text(folder / RECORD).splitlines(keepends=True)
        self._torn = bool(lines) and not lines[-1].endswith("\n")
        self.is_new = not lines or not lines[0].startswith(_FIRST_LINE)
        # a line without its end was being written when the process died, before its file was
        parts = [line.split() for line in lines[1:] if line.endswith("\n") and line.strip()]
        self._names = {part[0] for part in parts if _is_inside(part[0])}
        self._decks = {part[1] for part in parts if part[0] == DECK and len(part) > 1}
        if self.is_new:
            self._names, self._decks = _names_before_records(folder)

    def begin(self) -> None:
        """Make the record, if there is none."""
        if self.is_new:
            decks = [f"{DECK} {digest}" for digest in sorted(self._decks)]
            lines = [_FIRST_LINE, *sorted(self._names), *decks]
            (self.folder / RECORD).write_text("\n".join(lines) + "\n", encoding="utf-8")

    def forget(self) -> None:
        """Take back a record that `begin` has made, if nothing was written."""
        if self.is_new:
            with contextlib.suppress(OSError):
                (self.folder / RECORD).unlink()

    def has(self, name: str) -> bool:
        """Return whether the program wrote a file of this name."""
        return name in self._names

    def new(self, name: str) -> Path:
        """Return the path of a file that is about to be written; what is there and is not the program's steps aside."""
        path = self.folder / name
        if name not in self._names:
            if os.path.lexists(path):
                os.rename(path, free_name(path))
            self._note(name)
            self._names.add(name)
        return path

    def remove(self, *chosen: str) -> None:
        """Remove files that the program wrote, and the folder around them when it is empty then.

        Parameters
        ----------
        chosen : str
            Names, or folders ending with a slash: all of the program's files in it.
        """
        for name in sorted(self._names):
            if any(name == one or (one.endswith("/") and name.startswith(one)) for one in chosen):
                with contextlib.suppress(FileNotFoundError, IsADirectoryError, NotADirectoryError):
                    (self.folder / name).unlink()
        for one in chosen:
            if one.endswith("/"):
                with contextlib.suppress(OSError):
                    (self.folder / one).rmdir()

    def remove_checkpoints(self, checkpoints: Path) -> None:
        """Remove the files of a folder of checkpoints that have a checkpoint's name, and the folder if it is empty."""
        with contextlib.suppress(FileNotFoundError, NotADirectoryError):
            for name in os.listdir(checkpoints):
                if _CHECKPOINT.fullmatch(name):
                    with contextlib.suppress(FileNotFoundError, IsADirectoryError):
                        (checkpoints / name).unlink()
        with contextlib.suppress(OSError):
            checkpoints.rmdir()

    def wrote_deck(self, text: bytes) -> bool:
        """Return whether this is a deck as the program wrote it, not one that a person has changed."""
        return hashlib.sha256(text).hexdigest() in self._decks

    def note_deck(self, text: bytes) -> None:
        """Note that the program is about to write this deck."""
        if not self.wrote_deck(text):
            digest = hashlib.sha256(text).hexdigest()
            self._note(f"{DECK} {digest}")
            self._decks.add(digest)

    def _note(self, line: str) -> None:
        with open(self.folder / RECORD, "a", encoding="utf-8") as file:
            file.write(f"\n{line}\n" if self._torn else f"{line}\n")
        self._torn = False


def free_name(path: Path) -> Path:
    """Return a name beside a file for what it held before."""
    names = (path.with_name(f"{path.name}.before{'' if n == 1 else f'.{n}'}") for n in range(1, 10_000))
    return next(name for name in names if not os.path.lexists(name))


def _names_before_records(folder: Path) -> tuple[set[str], set[str]]:
    """What a run folder without a record has of the program: names, and digests of its deck."""
    if not is_run(folder):
        return set(), set()
    names = {*_FIRST_RESULTS, SUMMARY, *(f"figures/{name}" for name in _FIGURES)}
    for name in _lines_of(folder / DECK):
        names |= {f"lines/{name}.csv", f"figures/line_{name}.png"}
    digest = _object(folder / SUMMARY).get("deck_sha256")
    return {name for name in names if _is_inside(name)}, {digest} if isinstance(digest, str) else set()


def _lines_of(deck: Path) -> Iterable[str]:
    """Names of the lines that a deck asks for."""
    try:
        probes = tomllib.loads(_text(deck)).get("probes", [])
    except (ValueError, RecursionError):
        return
    for probe in probes if isinstance(probes, list) else ():
        if isinstance(probe, dict) and probe.get("kind") == "line" and isinstance(probe.get("name"), str):
            yield probe["name"]


def _is_inside(name: str) -> bool:
    """Return whether a name is one that the program can have written: of the folder, or of figures and lines."""
    return re.fullmatch(r"((figures|lines)/)?[A-Za-z0-9_-][A-Za-z0-9_.-]*", name) is not None


def _text(path: Path) -> str:
    with contextlib.suppress(OSError, ValueError):
        return read_plain(path, _MOST_BYTES).decode("utf-8", "replace")
    return ""


def _object(path: Path) -> dict:
    with contextlib.suppress(ValueError, RecursionError):
        found = json.loads(_text(path))
        return found if isinstance(found, dict) else {}
    return {}


def _starts_with(path: Path, begin: bytes) -> bool:
    with contextlib.suppress(OSError), open_plain(path) as file:
        return file.read(len(begin)) == begin
    return False
