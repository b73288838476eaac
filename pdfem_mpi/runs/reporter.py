"""Reporters: who receives the lines, tables and progress of a run; those that need no screen."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

from pdfem_mpi.solvers.convergence import Progress

#: Columns of a row of the history that a log line shows.
SHOWN = ("step", "event", "load_factor", "reaction", "evaluations", "relative_residual", "broken_bonds")


class Reporter(Protocol):
    """Receives the lines, tables and progress of a run; only that of rank 0 is used."""

    def line(self, text: str) -> None:
        """Print a line."""

    def progress(self, step: int, n_steps: int | None, progress: Progress, tolerance: float) -> None:
        """Observe one iteration."""

    def row(self, columns: dict[str, Any]) -> None:
        """Observe a row of the history."""

    def table(self, title: str, rows: list[tuple[str, str]]) -> None:
        """Print the table at the end."""


class NullReporter:
    """Says nothing."""

    def line(self, text: str) -> None:
        """Say nothing."""

    def progress(self, step: int, n_steps: int | None, progress: Progress, tolerance: float) -> None:
        """Say nothing."""

    def row(self, columns: dict[str, Any]) -> None:
        """Say nothing."""

    def table(self, title: str, rows: list[tuple[str, str]]) -> None:
        """Say nothing."""


class LineReporter(NullReporter):
    """Gives lines, rows and tables as texts to a function, such as ``print``."""

    def __init__(self, say: Callable[[str], None]):
        self.say = say

    def line(self, text: str) -> None:
        """Pass a line on."""
        self.say(text)

    def row(self, columns: dict[str, Any]) -> None:
        """Pass a row on, in one line."""
        self.say(row_in_words(columns))

    def table(self, title: str, rows: list[tuple[str, str]]) -> None:
        """Pass a table on, a line for each row."""
        for name, value in rows:
            self.say(f"{name}: {value}")


class LoggedReporter:
    """A reporter whose lines are in run.log too."""

    def __init__(self, reporter: Reporter, log: Any):
        self.reporter, self.log = reporter, LineReporter(log.line)
        self.progress = reporter.progress

    def line(self, text: str) -> None:
        """Print and log a line."""
        self.log.line(text)
        self.reporter.line(text)

    def row(self, columns: dict[str, Any]) -> None:
        """Print and log a row."""
        self.log.row(columns)
        self.reporter.row(columns)

    def table(self, title: str, rows: list[tuple[str, str]]) -> None:
        """Print and log a table."""
        self.log.table(title, rows)
        self.reporter.table(title, rows)


def row_in_words(columns: dict[str, Any]) -> str:
    """The numbers of a row by which a run is followed."""
    return "  ".join(f"{name} {columns[name]}" for name in SHOWN if name in columns)
