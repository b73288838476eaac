"""The check command itself: what counts as passed, and that a time-out leaves no process behind."""

import importlib.util
import sys
import time

import psutil
import pytest

from support.helpers import ROOT

spec = importlib.util.spec_from_file_location("stages", ROOT / "tools" / "stages.py")
stages = importlib.util.module_from_spec(spec)
sys.modules["stages"] = stages  # dataclasses look their module up
spec.loader.exec_module(stages)

PASSED, FAILED, SKIPPED = "", "<failure/>", "<skipped/>"


def judged(tmp_path, *ranks, reason=""):
    """The verdict on a stage whose ranks left these outcomes; None is a report that is missing."""
    reports = []
    for rank, outcomes in enumerate(ranks):
        reports.append(tmp_path / f"{rank}.xml")
        if outcomes is not None:
            cases = "".join(f'<testcase classname="t" name="{n}">{each}</testcase>' for n, each in enumerate(outcomes))
            reports[-1].write_text(f"<testsuites><testsuite>{cases}</testsuite></testsuites>")
    result = stages.Result(reason=reason)
    stages.count(stages.Stage("stage", [], 1.0, reports), result)
    return result.passed, result.failed, result.reason


@pytest.mark.parametrize(
    ("ranks", "verdict"),
    [
        ([[PASSED, SKIPPED]], (1, 0, "")),
        ([[PASSED, PASSED], [PASSED, PASSED]], (2, 0, "")),
        ([[PASSED, FAILED], [PASSED, PASSED]], (1, 1, "1 tests failed")),
        ([[PASSED], None], (0, 1, "reports 1 of 2")),
        ([[SKIPPED], [SKIPPED]], (0, 1, "no test passed")),
        ([[]], (0, 1, "no test passed")),
        ([[PASSED], [SKIPPED]], (0, 1, "0 did not pass on every rank")),
        ([[PASSED, PASSED], [PASSED]], (1, 1, "1 did not pass on every rank")),
    ],
)
def test_verdict(tmp_path, ranks, verdict):
    assert judged(tmp_path, *ranks) == verdict


def test_torn_report_counts_as_missing(tmp_path):
    (tmp_path / "0.xml").write_text("<testsuites><testcase")
    result = stages.Result()
    stages.count(stages.Stage("stage", [], 1.0, [tmp_path / "0.xml"]), result)
    assert (result.failed, result.reason) == (1, "reports 0 of 1")


def test_exit_code_fails_a_stage_whose_tests_passed(tmp_path):
    assert judged(tmp_path, [PASSED], reason="exit code 1") == (1, 1, "exit code 1")


def test_time_out_ends_the_whole_family(tmp_path, monkeypatch):
    """The grandchild has a session of its own and ignores SIGTERM, as a rank under a launcher may."""
    grandchild = "import signal, time; signal.signal(signal.SIGTERM, signal.SIG_IGN); time.sleep(60)"
    child = (
        "import subprocess, sys, time\n"
        f"p = subprocess.Popen([sys.executable, '-c', {grandchild!r}], start_new_session=True)\n"
        f"open({str(tmp_path / 'pid')!r}, 'w').write(str(p.pid))\n"
        "time.sleep(60)"
    )
    monkeypatch.setattr(stages, "GRACE_SECONDS", 0.5)
    with (tmp_path / "log").open("wb") as log:
        start = time.monotonic()
        assert stages.run_group([sys.executable, "-c", child], start + 1.5, log, {}) is None
    assert time.monotonic() - start < 15
    pid = int((tmp_path / "pid").read_text())
    assert not psutil.pid_exists(pid) or psutil.Process(pid).status() == psutil.STATUS_ZOMBIE


def test_every_stage_has_a_limit_and_reports():
    for stage in stages.stages(include_slow=False):
        assert 0 < stage.seconds <= 720 and stage.reports, stage.name


def test_all_tests_are_one_command():
    """With slow tests every stage keeps a limit and its reports, and what a study runs for its page is left to it."""
    chosen = {stage.name: stage for stage in stages.stages(include_slow=True)}
    assert list(chosen) == ["lint", "serial", "no-jit", "mpi-2", "mpi-4", "mpi-8", "mpi-32"]
    assert all(0 < stage.seconds <= stages.SLOW_SECONDS and stage.reports for stage in chosen.values())
    for name in ("serial", "mpi-2", "mpi-4"):
        command = chosen[name].commands[-1]
        selection = command[command.index("-m", command.index("pytest")) + 1]
        assert "not study" in selection and "not slow" not in selection, selection
    for name, ranks in (("mpi-2", 2), ("mpi-4", 4), ("mpi-8", 8), ("mpi-32", 32)):
        assert len(chosen[name].reports) == ranks


def test_what_the_failed_command_printed_is_shown(tmp_path, monkeypatch):
    """Not what another one printed after it."""
    monkeypatch.setattr(stages, "REPORTS", tmp_path)
    commands = [[sys.executable, "-c", f"print({n}); raise SystemExit({n == 1:d})"] for n in range(3)]
    result = stages.run(stages.Stage("several", commands, 60.0))
    assert (result.output, result.reason) == ("1", "exit code 1")
