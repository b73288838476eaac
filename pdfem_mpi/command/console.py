"""What a person sees: the lines and the progress of a run, tables, and problems. From rank 0 only."""

from __future__ import annotations

import math
import shutil
import sys
import time
from collections.abc import Iterable
from typing import Any

import typer
import typer.main

from pdfem_mpi.command.outlook import Outlook, clock, fitted
from pdfem_mpi.command.paint import RED, painted
from pdfem_mpi.system.exit_codes import (
    EXIT_USAGE,
)


class ConsoleReporter:
    """What a run says on rank 0: lines, one progress line, and the table at the end.

    On a terminal the progress line is rewritten in place. Under ``mpirun`` standard output is a pipe: then it
    is a plain line, now and then, and one at the end of each load step.
    """

    TERMINAL_SECONDS = 0.2
    PIPE_SECONDS = 10.0
    FIRST_SECONDS = 2.0

    def __init__(self, scene: Any = None) -> None:
        self.outlook = Outlook(scene)
        self.terminal = sys.stdout.isatty()
        self.width = 0  # of the line that can be rewritten
        self.step = 0
        self.began = self.due = 0.0
        self.first = self.best = math.inf

    def line(self, text: str) -> None:
        """Print a line."""
        self._clear()
        print(painted(text, sys.stdout), flush=True)

    def row(self, columns: dict[str, Any]) -> None:
        """Print a row of the history, where bonds can break."""
        if "broken_bonds" not in columns:
            return
        parts = [
            f"{columns['step']:>4} {columns['event']:<8}  load {columns['load_factor']:.6g}  reaction "
            f"{columns['reaction']:.6g}",
            f"broken {columns['broken_bonds']:,} (+{columns['new_broken_bonds']:,})",
            *self.outlook.parts(columns),
            f"{columns['evaluations']} evaluations",
            f"{columns['wall_seconds']:.1f} s",
        ]
        self.line(fitted(parts, self._room()))

    def progress(self, step: int, n_steps: int | None, progress: Any, tolerance: float) -> None:
        """Print the state of an iteration, if it is time to."""
        now = time.perf_counter()
        if n_steps is None:
            self._beat(now, f"row {step}  iteration {progress.iteration}  residual {progress.residual:.2e}")
            return
        residual = progress.residual
        if step != self.step:
            self.step, self.began = step, now
            self.due = now + (0.0 if self.terminal else self.FIRST_SECONDS)
            self.first = self.best = residual
        self.best = min(self.best, residual)
        done = residual <= tolerance
        if now < self.due and not done:
            return
        self.due = now + (self.TERMINAL_SECONDS if self.terminal else self.PIPE_SECONDS)
        seconds = now - self.began
        left = "" if done else f"  ~{remaining(seconds, self.first, self.best, tolerance)} left"
        text = (
            f"step {step}/{n_steps}  iteration {progress.iteration}  residual {residual:.2e}  "
            f"damping {progress.damping:.3g}  {seconds:.1f} s{left}"
        )
        if self.terminal and not done:
            self._rewrite(text)
        else:
            self.line(text)

    def _beat(self, now: float, text: str) -> None:
        """Print a sign of life, if it is time to."""
        if now < self.due:
            return
        self.due = now + (self.TERMINAL_SECONDS if self.terminal else self.PIPE_SECONDS)
        if self.terminal:
            self._rewrite(text)
        else:
            self.line(text)

    def _rewrite(self, text: str) -> None:
        """Print a line that the next one is written over; one that is wider than the terminal could not be."""
        text = fitted(text.split("  "), self._room())
        print("\r" + text.ljust(self.width), end="", flush=True)
        self.width = len(text)

    def _room(self) -> int | None:
        """Characters of a line of the terminal; None where it is none."""
        return shutil.get_terminal_size().columns - 1 if self.terminal else None

    def table(self, title: str, rows: list[tuple[str, str]]) -> None:
        """Print the table at the end."""
        self._clear()
        print_table(title, rows)

    def _clear(self) -> None:
        if self.width:
            print("\r" + " " * self.width + "\r", end="")
            self.width = 0


def remaining(seconds: float, first: float, best: float, tolerance: float) -> str:
    """Return the time left as mm:ss or h:mm:ss, from the mean rate at which the residual has fallen."""
    if not 0.0 < best < first < math.inf:
        return "--:--"
    return clock(seconds * math.log(max(best / tolerance, 1.0)) / math.log(first / best))


def print_at_once(text: str) -> None:
    """Print a line that is seen now, whatever standard output is."""
    print(text, flush=True)


def show_progress(text: str, done: bool) -> None:
    """Rewrite a line of a terminal; say nothing where standard output is a file or a pipe."""
    if sys.stdout.isatty():
        print("\r" + text, end="\n" if done else "", flush=True)


def print_problems(messages: Iterable[str], rank: int) -> None:
    if rank == 0:
        sys.stdout.flush()
        for message in messages:
            print(painted(message, sys.stderr, RED), file=sys.stderr)
        sys.stderr.flush()


def fail(messages: Iterable[str], rank: int) -> typer.Exit:
    print_problems(messages, rank)
    return typer.Exit(EXIT_USAGE)


def print_table(title: str, rows: Iterable[tuple[str, Any]]) -> None:
    """Print a table; titles, names and units of a deck are texts, whatever marks of a terminal they look like."""
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    table = Table(title=Text(title), title_justify="left", show_header=False)
    table.add_column(no_wrap=True)
    table.add_column(overflow="fold")
    for name, value in rows:
        table.add_row(Text(str(name)), Text(f"{value:,}" if isinstance(value, int) else str(value)))
    Console(markup=False, emoji=False, highlight=False).print(table)
