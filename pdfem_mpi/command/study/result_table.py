"""The table of a study: a row for each member, with all numbers of its summary."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from pdfem_mpi.command.study.members import Member
from pdfem_mpi.command.study.outcomes import Outcome
from pdfem_mpi.results.run_folder import WALL_TIMES, numbers_of


def table(members: Sequence[Member], outcomes: Sequence[Outcome]) -> tuple[list[str], list[list[Any]]]:
    """Header and rows of ``study.csv``: the varied keys, how the member ended, and all numbers of its summary."""
    results = [numbers_of(outcome.summary) if outcome.status == "finished" else {} for outcome in outcomes]
    names = list(dict.fromkeys(name for row in results for name in row))
    names.sort(key=lambda name: name.startswith(WALL_TIMES))  # stable: the order of the summaries is kept
    keys = [key for key, _ in members[0].values]
    header = [*keys, "status", "exit_code", "reason", "folder", "deck_sha256", *names]
    rows = []
    for member, outcome, found in zip(members, outcomes, results, strict=True):
        values = [unquoted(value) for _, value in member.values]
        code = "" if outcome.exit_code is None else outcome.exit_code
        fixed = [outcome.status, code, outcome.reason, f"members/{member.name}", member.sha256]
        rows.append([*values, *fixed, *(found.get(name, "") for name in names)])
    return header, rows


def unquoted(text: str) -> str:
    return text[1:-1] if len(text) > 1 and text[0] == text[-1] and text[0] in "\"'" else text
