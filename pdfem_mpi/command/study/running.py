"""The members of a study run one after another, each as `pdfem run` in its own processes; signals are passed on."""

from __future__ import annotations

import signal
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from pdfem_mpi.command.study.members import Member
from pdfem_mpi.command.study.outcomes import Outcome, outcome_in
from pdfem_mpi.results.run_folder import read_summary
from pdfem_mpi.system.exit_codes import EXIT_FINISHED, EXIT_INTERNAL_ERROR, EXIT_STOPPED, MEMBER_STATUS

Start = Callable[[Member, Path, bool], tuple[int, str]]


@dataclass
class Interruption:
    """A signal to the study: remembered, and passed on to the member that runs."""

    process: subprocess.Popen | None = None
    signal: int | None = None

    @contextmanager
    def listening(self) -> Iterator[None]:
        """Take SIGINT, SIGTERM and SIGUSR1 while members run."""

        def take(number, frame):
            self.signal = number
            if self.process is not None and self.process.poll() is None:
                # a member asked to stop writes what it can; an impatient person sends SIGTERM after SIGUSR1
                self.process.send_signal(signal.SIGUSR1 if number == signal.SIGUSR1 else signal.SIGTERM)

        before = {number: signal.signal(number, take) for number in (signal.SIGINT, signal.SIGTERM, signal.SIGUSR1)}
        try:
            yield
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)


def starter(deck: Path, overrides: Sequence[str], ranks: int | None, interruption: Interruption) -> Start:
    """Return what starts a member as ``pdfem run`` in its own processes, its output in a file of its own."""

    def start(member: Member, folder: Path, overwrite: bool) -> tuple[int, str]:
        command = [sys.executable, "-m", "pdfem_mpi", "run", str(deck), "--out", str(folder)]
        command += [word for text in (*overrides, *member.overrides) for word in ("--set", text)]
        command += ["-n", str(ranks)] if ranks else []
        command += ["--overwrite"] if overwrite else []
        log = folder.parent.parent / "logs" / f"{folder.name}.log"
        log.parent.mkdir(parents=True, exist_ok=True)
        log.unlink(missing_ok=True)  # a link or a pipe of that name must not be written through
        with log.open("wb") as output:
            # of its own session: a terminal's Ctrl-C reaches it through the study, once
            process = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.PIPE,
                start_new_session=True,
            )
            interruption.process = process
            errors = process.communicate()[1].decode("utf-8", "replace")
            interruption.process = None
            output.write(errors.encode())
        lines = [line for line in errors.splitlines() if line.strip()]
        return process.returncode, lines[-1].strip() if lines else ""

    return start


def follow(
    members: Sequence[Member],
    folder: Path,
    start: Start,
    report: Callable[[str], None],
    interruption: Interruption,
    update: Callable[[list[Outcome]], None],
) -> list[Outcome]:
    """Run the members that have not finished, one after another; a failed member is reported and the rest goes on.

    Parameters
    ----------
    start : callable
        ``(member, folder, overwrite) -> (exit code, last line of its errors)``.
    update : callable
        Called with all outcomes whenever one has changed, and once before the first.

    Returns
    -------
    list of Outcome
        In the order of the members.
    """
    places = [folder / "members" / member.name for member in members]
    outcomes = [outcome_in(place, member) for place, member in zip(places, members, strict=True)]
    update(outcomes)
    for number, (member, place) in enumerate(zip(members, places, strict=True)):
        position = f"{number + 1}/{len(members)} {member.label}"
        if outcomes[number].status == "finished":
            report(f"{position}: finished before")
            continue
        if interruption.signal is not None:
            break
        # a member that was stopped goes on from its checkpoint; any other result of an earlier run is replaced
        overwrite = bool(read_summary(place)) and outcomes[number].exit_code != EXIT_STOPPED
        code, line = start(member, place, overwrite)
        outcomes[number] = _judge(member, place, code, line)
        if interruption.signal is not None and outcomes[number].status == "failed":
            outcomes[number] = Outcome("stopped", EXIT_STOPPED, "by a signal to the study")
        report(f"{position}: {_described(outcomes[number])}")
        update(outcomes)
    return outcomes


def _judge(member: Member, place: Path, code: int, line: str) -> Outcome:
    """The outcome of a member that has just run."""
    found = outcome_in(place, member)
    if code == EXIT_FINISHED:
        if found.status == "finished":
            return found
        reason = "its deck was changed while the study ran" if read_summary(place) else "it left no summary.json"
        return Outcome("failed", EXIT_INTERNAL_ERROR, reason)
    if code in MEMBER_STATUS:
        return Outcome(MEMBER_STATUS[code], code, found.reason or line)
    how = f"ended by signal {-code}" if code < 0 else f"exit code {code}"
    return Outcome("failed", code, ": ".join(filter(None, (how, line))))


def _described(outcome: Outcome) -> str:
    if outcome.status != "finished":
        return f"{outcome.status} ({outcome.reason})" if outcome.reason else outcome.status
    evaluations = outcome.summary.get("solve", {}).get("evaluations")
    seconds = outcome.summary.get("seconds", {}).get("total")
    words = [f"{evaluations:,} evaluations" if evaluations else "", f"{seconds:.1f} s" if seconds else ""]
    return ", ".join(["finished", *filter(None, words)])


def exit_code(outcomes: Sequence[Outcome], interruption: Interruption) -> int:
    """0 if all members have finished, 75 if the study was stopped, else the code of the first that failed."""
    if all(outcome.status == "finished" for outcome in outcomes):
        return EXIT_FINISHED
    if interruption.signal is not None:
        return EXIT_STOPPED
    code = next(outcome.exit_code for outcome in outcomes if outcome.status != "finished")
    return code if code in MEMBER_STATUS else EXIT_INTERNAL_ERROR
