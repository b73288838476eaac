"""The stages of ``tools/check`` after the environment: lint, serial, no JIT, and MPI on 2, 4 and more ranks.

Every stage is a process group with a hard time limit, and writes a junit report (one per rank). A report that
is missing, or a stage in which no test passed, is a failure: MPI tests are skipped, and green, without MPI.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import shutil
import signal
import subprocess
import sys
import time
import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass, field
from pathlib import Path

import psutil

from pdfem_mpi.system import launcher as launch

ROOT = Path(__file__).resolve().parent.parent
REPORTS = ROOT / ".check"
PYTEST, RUFF = [sys.executable, "-m", "pytest", "-q"], [sys.executable, "-m", "ruff"]
NOTHING_COLLECTED = "exit code 5"
TWO_AT_ONCE = ["-n", "2", "--dist", "worksteal"]
MPI_TESTS, COUNTS = ("tests/mpi", "tests/hard"), ("tests/mpi/test_counts.py",)
MANY_RANKS = (*COUNTS, "tests/mpi/test_many_ranks.py", "tests/mpi/test_scaling.py")
TAIL_LINES = 150
GRACE_SECONDS = 5
SLOW_SECONDS = 7200
RANK = "${PMI_RANK:-${OMPI_COMM_WORLD_RANK:-${PMIX_RANK:-${SLURM_PROCID:-none}}}}"


@dataclass
class Stage:
    """One command, its limit, and what it must leave behind."""

    name: str
    commands: list[list[str]]
    seconds: float
    reports: list[Path] = field(default_factory=list)
    environment: dict[str, str] = field(default_factory=dict)


@dataclass
class Result:
    """Tests that passed and failed, and why the stage failed (empty if it did not)."""

    passed: int = 0
    failed: int = 0
    reason: str = ""
    output: str = ""


def pytest(report: str, *arguments: str) -> list[str]:
    """Return a pytest command that writes a report."""
    return [*PYTEST, f"--junitxml={REPORTS / report}", *arguments]


def on_ranks(ranks: int, report: Path, *program: str) -> tuple[list[str], dict[str, str]]:
    """Return a command that runs pytest on some ranks, and what it adds to the environment.

    Each rank writes its report, ``REPORT.RANK.xml``.
    """
    command, additions = launch.mpirun_command(ranks)
    shell = ["/bin/sh", "-c", f'exec "$@" "--junitxml=$0.{RANK}.xml"', str(report)]
    return [*command, *shell, *program], additions


def mpi_stage(ranks: int, seconds: float, selection: str, *tests: str) -> Stage:
    """Return the stage of MPI tests on some ranks."""
    name = f"mpi-{ranks}"
    reports = [REPORTS / f"{name}.{rank}.xml" for rank in range(ranks)]
    command, additions = on_ranks(ranks, REPORTS / name, *PYTEST, "--only-mpi", "-m", selection, *tests)
    return Stage(name, [command], seconds, reports, additions)


def stages(include_slow: bool) -> list[Stage]:
    """Return all stages in their order."""

    def limit(seconds: float) -> float:
        return SLOW_SECONDS if include_slow else seconds

    slow = "" if include_slow else " and not slow"
    command, additions = launch.mpirun_command(2)
    settings = [f"{name}={value}" for name, value in additions.items()]
    return [
        Stage(
            "lint",
            [[*RUFF, "check", "."], [*RUFF, "format", "--check", "."], pytest("lint.xml", "tests/conventions")],
            120,
            [REPORTS / "lint.xml"],
        ),
        Stage(
            "serial",
            [
                # a share each, before two processes would both compile all
                ["env", *settings, *command, sys.executable, "-m", "pdfem_mpi", "warmup"],
                pytest("serial.xml", "-m", f"not mpi{slow} and not study", "--ignore=tests/conventions", *TWO_AT_ONCE),
            ],
            limit(720),
            [REPORTS / "serial.xml"],
        ),
        Stage(
            "no-jit",
            [pytest("no-jit.xml", "-m", "nojit and not mpi and not slow")],
            120,
            [REPORTS / "no-jit.xml"],
            {"NUMBA_DISABLE_JIT": "1"},
        ),
        mpi_stage(2, limit(360), f"mpi{slow} and not study", *MPI_TESTS),
        mpi_stage(4, limit(480), f"mpi{slow} and not study", *MPI_TESTS),
        # more ranks than a small body has cells to share: seconds each go into starting them
        mpi_stage(8, 120, "mpi", *MANY_RANKS),
        mpi_stage(32, 300, "mpi", *(MANY_RANKS if include_slow else COUNTS)),
    ]


def run(stage: Stage) -> Result:
    """Run the commands of a stage, and judge by exit codes and reports."""
    for report in stage.reports:
        report.unlink(missing_ok=True)
    result = Result()
    deadline = time.monotonic() + stage.seconds
    log = REPORTS / f"{stage.name}.log"
    blamed = slice(None)
    with log.open("wb") as output:
        for command in stage.commands:
            begin = output.seek(0, os.SEEK_END)
            code = run_group(command, deadline, output, stage.environment)
            if code != 0 and not result.reason:
                result.reason = f"not done after {stage.seconds:.0f} s" if code is None else f"exit code {code}"
                blamed = slice(begin, output.seek(0, os.SEEK_END))
            if code is None:
                break
    # of the command that failed: a later one may have said much since
    printed = log.read_bytes()[blamed].decode(errors="replace")
    result.output = "\n".join(printed.splitlines()[-TAIL_LINES:])
    count(stage, result)
    return result


def run_group(command: list[str], deadline: float, output, environment: dict[str, str]) -> int | None:
    """Run a command as its own process group; return its code, or None after killing all of it."""
    process = subprocess.Popen(
        command,
        cwd=ROOT,
        env=os.environ | environment,
        stdin=subprocess.DEVNULL,
        stdout=output,
        stderr=subprocess.STDOUT,
        start_new_session=True,
    )
    try:
        return process.wait(timeout=max(deadline - time.monotonic(), 0.1))
    except (subprocess.TimeoutExpired, KeyboardInterrupt) as error:
        kill_group(process)
        if isinstance(error, KeyboardInterrupt):
            raise
        return None


def kill_group(process: subprocess.Popen) -> None:
    """End a process group and all descendants: an MPI launcher's ranks may have left the group."""
    try:
        family = psutil.Process(process.pid).children(recursive=True)
    except psutil.NoSuchProcess:
        family = []
    for number in (signal.SIGTERM, signal.SIGKILL):
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, number)
        for member in family:
            with contextlib.suppress(psutil.NoSuchProcess):
                member.send_signal(number)
        try:
            process.wait(timeout=GRACE_SECONDS)
        except subprocess.TimeoutExpired:
            continue
        psutil.wait_procs(family, timeout=GRACE_SECONDS)


def count(stage: Stage, result: Result) -> None:
    """Count tests; one that ran on several ranks passed if it passed on all of them."""
    outcomes: dict[tuple[str, str], list[str]] = {}
    missing = 0
    for report in stage.reports:
        try:
            cases = ElementTree.parse(report).getroot().iter("testcase")
        except (OSError, ElementTree.ParseError):
            missing += 1
            continue
        for case in cases:
            kinds = {child.tag for child in case}
            outcome = "failed" if kinds & {"failure", "error"} else "skipped" if "skipped" in kinds else "passed"
            outcomes.setdefault((case.get("classname", ""), case.get("name", "")), []).append(outcome)
    n_ranks = len(stage.reports)
    result.failed = sum("failed" in each for each in outcomes.values())
    result.passed = sum(each.count("passed") >= n_ranks for each in outcomes.values())
    partial = [
        name
        for (_, name), each in outcomes.items()
        if "failed" not in each and "passed" in each and each.count("passed") < n_ranks
    ]
    if missing:
        result.reason = f"reports {n_ranks - missing} of {n_ranks}" + (f", {result.reason}" * bool(result.reason))
    elif result.failed:
        result.reason = f"{result.failed} tests failed"
    elif partial:
        result.reason = f"{partial[0]} did not pass on every rank"
    elif result.passed == 0 and result.reason in ("", NOTHING_COLLECTED):
        result.reason = "no test passed"
    if result.reason:
        result.failed = max(result.failed, 1)


def main() -> int:
    """Run the stages and print one line for each, the verdict, and the counts."""
    parser = argparse.ArgumentParser(prog="tools/check")
    parser.add_argument("--all", action="store_true", help="include tests marked slow")
    parser.add_argument("--stage", action="append", help="only this stage (repeatable)")
    parser.add_argument("--environment-seconds", type=float, default=0.0, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    start = time.monotonic() - arguments.environment_seconds
    os.chdir(ROOT)
    shutil.rmtree(REPORTS, ignore_errors=True)
    REPORTS.mkdir()
    launch.prepare_environment()
    print(f"environment: ready, {arguments.environment_seconds:.0f} s", flush=True)
    chosen = stages(arguments.all)
    names = [stage.name for stage in chosen]
    unknown = set(arguments.stage or ()) - set(names)
    if unknown:
        parser.error(f"unknown stage {', '.join(sorted(unknown))}; the stages are {', '.join(names)}")
    passed = failed = ran = 0
    failures = []
    for stage in chosen:
        if arguments.stage and stage.name not in arguments.stage:
            continue
        begin = time.monotonic()
        result = run(stage)
        ran += 1
        passed += result.passed
        failed += result.failed
        verdict = f"FAILED, {result.reason}" if result.reason else "passed"
        print(f"{stage.name}: {verdict}, {result.passed} tests, {time.monotonic() - begin:.0f} s", flush=True)
        if result.reason:
            print(result.output, flush=True)
            failures.append(f"FAILED {stage.name}: {result.reason}")
    seconds = time.monotonic() - start
    print("\n".join(failures) or f"ALL PASSED {passed} tests, {ran + 1} stages, {seconds:.0f} s")
    print(f"{passed} passed, {failed} failed", flush=True)
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())
