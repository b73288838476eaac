"""What is known of the members of a study from their folders: who has finished, and with which deck."""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pdfem_mpi.command.study.members import Member, StudyError
from pdfem_mpi.deck.table import leaves, show
from pdfem_mpi.results.ownership import refuse_study
from pdfem_mpi.results.run_folder import read_summary
from pdfem_mpi.system.exit_codes import EXIT_FINISHED, MEMBER_STATUS


@dataclass
class Outcome:
    """What is known of a member: a status, an exit code once it ran, and the summary of a run that finished."""

    status: str = "waiting"
    exit_code: int | None = None
    reason: str = ""
    summary: dict[str, Any] = field(default_factory=dict)


def outcome_in(folder: Path, member: Member) -> Outcome:
    """How the run of a member ended, by its folder; waiting, where that holds no run of the same deck."""
    summary = read_summary(folder)
    if not summary or summary.get("deck_sha256") != member.sha256:
        return Outcome()
    code = summary.get("exit_code")
    if code == EXIT_FINISHED:
        return Outcome("finished", code, "", summary)
    return Outcome(MEMBER_STATUS.get(code, "failed"), code, str(summary.get("reason") or ""), summary)


def changed_members(members: Sequence[Member], folder: Path) -> list[str]:
    """One sentence for each member whose folder holds a run of another deck."""
    sentences = []
    for member in members:
        place = folder / "members" / member.name
        summary = read_summary(place)
        if summary and summary.get("deck_sha256") != member.sha256:
            sentences.append(
                f"{place}: was run with another deck{_differences(place / 'deck.toml', member.text)}. Use --overwrite "
                "to run it anew, or another folder with --out."
            )
    return sentences


def check_folder(folder: Path) -> None:
    """Refuse a folder with the files of others.

    Raises
    ------
    StudyError
    """
    if reason := refuse_study(folder):
        raise StudyError([reason])


def _differences(path: Path, text: str) -> str:
    """The first few keys in which a deck differs from another."""
    try:
        then = dict(leaves(tomllib.loads(path.read_text(encoding="utf-8"))))
    except (OSError, ValueError):
        return ""
    now = dict(leaves(tomllib.loads(text)))
    keys = [key for key in {**then, **now} if then.get(key) != now.get(key)]
    shown = [f"{key} = {show(then.get(key, 'not there'))}, now {show(now.get(key, 'not there'))}" for key in keys[:3]]
    more = f", and {len(keys) - 3} more keys" if len(keys) > 3 else ""
    return f" ({'; '.join(shown)}{more})" if shown else ""
