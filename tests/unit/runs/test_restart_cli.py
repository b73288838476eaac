"""Stopping and going on as a user does it: launchers, real signals, kills, time limits, `pdfem resume` and `info`."""

import json
import os
import signal
import subprocess
import sys
import time

import numpy as np
import psutil
import pytest

from pdfem_mpi.deck.outputs import Output
from pdfem_mpi.deck.programs import Steps
from pdfem_mpi.deck.toml import write_deck
from pdfem_mpi.results.checkpoint import check
from pdfem_mpi.results.checkpoint_files import list_checkpoints
from pdfem_mpi.results.run_folder import read_summary
from pdfem_mpi.system import faults
from support.bodies import make_scene
from support.helpers import ROOT, outside_launcher, run_pdfem
from support.restarts import alone, differing, often, outcome, relaxed

FINISHED, USAGE, NO_CHECKPOINT, ABORTED, NOT_WRITTEN, NOT_CONVERGED, STOPPED = 0, 64, 65, 70, 73, 74, 75
LONG = 100_000  # iterations that nobody waits for


@pytest.fixture(scope="module")
def straight(tmp_path_factory):
    out = tmp_path_factory.mktemp("straight") / "run"
    assert alone(often(), out) == FINISHED
    return outcome(out)


@pytest.fixture
def out(tmp_path):
    return tmp_path / "run"


@pytest.fixture
def deck(tmp_path):
    """The deck of the straight run."""
    path = tmp_path / "deck.toml"
    path.write_text(write_deck(relaxed()))
    return path


@pytest.fixture
def long(tmp_path):
    """The same scene with a tolerance that takes for ever: it goes on until it is stopped."""
    path = tmp_path / "long.toml"
    path.write_text(write_deck(relaxed(max_evaluations=LONG)).replace("tolerance = 0.001", "tolerance = 1e-300"))
    return path


class Started:
    """``pdfem`` with some arguments, until its load program runs or it ends."""

    def __init__(self, *arguments, until="set up in", alone=False, **additions):
        self.process = subprocess.Popen(
            [sys.executable, "-m", "pdfem_mpi", *map(str, arguments)],
            cwd=ROOT,
            env=outside_launcher(**additions),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            start_new_session=alone,
            # tests that run in the background of a shell ignore it
            preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
        )
        self.output = ""
        for line in self.process.stdout if until else ():
            self.output += line
            if until in line:
                break

    def ranks(self):
        """Processes of the ranks, below the launcher."""
        below = psutil.Process(self.process.pid).children(recursive=True)
        ranks = [process for process in below if "pdfem_mpi" in " ".join(process.cmdline())]
        return ranks or [psutil.Process(self.process.pid)]

    def end(self, timeout=300):
        """Wait; return the exit code."""
        rest, _ = self.process.communicate(timeout=timeout)
        self.output += rest
        return self.process.returncode


# --- signals ----------------------------------------------------------------------------------------------


def test_usr1_to_the_launcher_stops_all_ranks_and_another_number_goes_on(out, long):
    """The pid that a batch script knows is the launcher's. The second start uses up its evaluations."""
    run = Started("run", long, "-n", 2, "--out", out)
    run.process.send_signal(signal.SIGUSR1)
    assert run.end() == STOPPED, run.output
    assert "stopped: asked to stop. Go on with: pdfem resume" in run.output
    summary = json.loads((out / "summary.json").read_text())
    assert (summary["status"], summary["exit_code"], summary["restarts"]) == ("stopped", 75, [])
    assert not (out / "RUNNING").exists()
    before = list_checkpoints(out / "checkpoints")[0]
    spent = check(before[1])["state"]["spent"]
    sets = ["--set", f"solver.max_evaluations={spent + 250}", "--set", "checkpoint.iterations=100"]
    result = run_pdfem("resume", out, *sets)
    assert result.returncode == NOT_CONVERGED, result.stdout + result.stderr
    newest = list_checkpoints(out / "checkpoints")[0]
    assert check(newest[1])["state"]["iteration"] > check(before[1])["state"]["iteration"]
    (restart,) = json.loads((out / "summary.json").read_text())["restarts"]
    assert restart["ranks"] == 1 and restart["checkpoint"] == before[1].name


@pytest.mark.slow
@pytest.mark.parametrize("name", ["SIGTERM", "SIGUSR1"])
@pytest.mark.parametrize("to", ["launcher", "rank"])
def test_signals_to_launcher_and_rank(out, deck, straight, name, to):
    """Either signal, wherever it goes, is a stop with a checkpoint."""
    run = Started("run", deck, "-n", 2, "--out", out, "--set", "solver.tolerance=1e-12")
    (run.process if to == "launcher" else run.ranks()[-1]).send_signal(getattr(signal, name))
    assert run.end() == STOPPED, run.output


def ctrl_c(run, to):
    """The signal as a terminal, a person or a launcher sends it."""
    if to == "group":
        os.killpg(run.process.pid, signal.SIGINT)
    for rank in {"rank": run.ranks()[-1:], "ranks": run.ranks()}.get(to, []):
        rank.send_signal(signal.SIGINT)
    if to == "launcher":
        run.process.send_signal(signal.SIGINT)


CTRL_C_SECONDS = 5.0  # what a person waits


@pytest.mark.parametrize(
    ("ranks", "to"),
    [
        (2, "group"),
        *(
            pytest.param(ranks, to, marks=pytest.mark.slow)
            for ranks, to in [(1, "group"), (4, "group"), (2, "launcher"), (2, "rank"), (2, "ranks"), (4, "rank")]
        ),
    ],
)
def test_ctrl_c_stops_all_ranks_with_a_checkpoint(out, long, ranks, to):
    """A terminal sends it to the launcher and all of its group; MPICH's launcher passes it on to the ranks."""
    run = Started("run", long, "-n", ranks, "--out", out, alone=True)
    time.sleep(0.2)
    began = time.monotonic()
    ctrl_c(run, to)
    assert run.end() == STOPPED, run.output
    assert time.monotonic() - began < CTRL_C_SECONDS
    assert "stopped: asked to stop. Go on with: pdfem resume" in run.output
    assert check(list_checkpoints(out / "checkpoints")[0][1])
    assert not (out / "RUNNING").exists()


@pytest.mark.slow
@pytest.mark.parametrize("ranks", [1, 2])
@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM", "SIGUSR1"])
def test_a_signal_at_any_time_of_set_up_ends_all_ranks(out, deck, straight, ranks, name):
    """From the start of Python on; the same command starts again."""
    for number in range(10):
        run = Started("run", deck, "-n", ranks, "--out", out, alone=True, until=None)
        time.sleep(0.15 * number)
        run.process.send_signal(getattr(signal, name))
        began = time.monotonic()
        code = run.end()
        assert time.monotonic() - began < CTRL_C_SECONDS + 3.0  # 3 s are given to end by itself
        assert code in (FINISHED, STOPPED) or abs(code) in (1, 11, getattr(signal, name), 128 + getattr(signal, name))
        over = (read_summary(out) or {}).get("status") == "finished"
        if over:
            break  # before the signal came, or before the process was gone: another start there is refused
    if not over:
        assert run_pdfem("run", deck, "--out", out).returncode == FINISHED
    assert not differing(outcome(out), straight)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["SIGUSR1", "SIGTERM", "SIGINT"])
def test_a_second_signal_ends_all_ranks_at_once(out, long, name):
    """Also while this rank waits for one that does not come: Python code of the main thread does not run then."""
    run = Started("run", long, "-n", 2, "--out", out)
    waiting, stuck = run.ranks()
    stuck.suspend()
    for _ in range(2):
        waiting.send_signal(getattr(signal, name))
        time.sleep(1.5)
    assert run.end() == ABORTED, run.output
    assert "a second time: ending at once" in run.output
    assert not stuck.is_running() or stuck.status() == psutil.STATUS_ZOMBIE


@pytest.mark.slow
def test_usr2_prints_stacks_and_the_run_goes_on(out, deck):
    run = Started("run", deck, "--out", out)
    run.process.send_signal(signal.SIGUSR2)
    assert run.end() == FINISHED
    assert "most recent call first" in run.output


@pytest.mark.slow
def test_a_signal_while_the_kernels_compile(out, deck, straight, tmp_path):
    """It is acted on at the first safe point: a checkpoint of the beginning."""
    run = Started("run", deck, "--out", out, until="compiling ", NUMBA_CACHE_DIR=str(tmp_path / "cache"))
    time.sleep(1.0)
    run.process.send_signal(signal.SIGUSR1)
    assert run.end(timeout=300) == STOPPED, run.output
    result = run_pdfem("resume", out)
    assert result.returncode == FINISHED
    assert not differing(outcome(out), straight)


@pytest.mark.slow
def test_max_hours_stops_with_a_checkpoint(out, long):
    result = run_pdfem("run", long, "--out", out, "--max-hours", 0.003)
    assert result.returncode == STOPPED, result.stdout + result.stderr
    assert "the time allowed by --max-hours is used up" in result.stdout
    assert check(list_checkpoints(out / "checkpoints")[0][1])


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2))
def test_ten_signals_at_random_times_on_changing_ranks(tmp_path, seed):
    """A bar of thousands of iterations: stopped ten times where it happens to be, and never the worse for it."""
    deck, rng = tmp_path / "bar.toml", np.random.default_rng(seed)
    steps = Steps(load_factors=tuple(np.linspace(0.1, 1.0, 10).tolist()))
    scene = make_scene((40, 4, 4), 20, stepping=steps, tolerance=1e-9, output=Output(figures=False))
    deck.write_text(write_deck(scene))
    assert run_pdfem("run", deck, "-n", 2, "--out", tmp_path / "straight").returncode == FINISHED
    stops = 0
    while True:
        ranks = int(rng.integers(1, 5))
        run = Started("run", deck, "-n", ranks, "--out", tmp_path / "run")
        time.sleep(rng.uniform(0.0, 0.8))
        if stops < 10 and run.process.poll() is None:
            run.process.send_signal(signal.SIGUSR1)
        code = run.end()
        if code == FINISHED:
            break
        assert code == STOPPED, run.output
        stops += 1
    assert stops >= 5
    assert not differing(outcome(tmp_path / "run"), outcome(tmp_path / "straight"))


# --- kills and crashes ------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("who", ["rank 0", "rank 1", "all ranks", "launcher"])
def test_kill_9_loses_nothing(out, straight, tmp_path, who):
    deck = tmp_path / "deck.toml"
    deck.write_text(write_deck(often()))
    run = Started("run", deck, "-n", 2, "--out", out, "--set", "solver.tolerance=1e-9", until="checkpoint ckpt-000003")
    ranks = run.ranks()
    chosen = {"rank 0": ranks[:1], "rank 1": ranks[1:], "all ranks": ranks}.get(who, [psutil.Process(run.process.pid)])
    for process in chosen:
        process.kill()
    assert run.end() != FINISHED
    psutil.wait_procs(ranks, timeout=20)
    assert len(list_checkpoints(out / "checkpoints")) >= 3
    assert run_pdfem("resume", out, "-n", 3, "--set", "solver.tolerance=1e-3").returncode == FINISHED


@pytest.mark.slow
@pytest.mark.parametrize("phase", faults.PHASES)
def test_a_rank_that_crashes_in_any_phase_ends_all_and_loses_nothing(out, straight, tmp_path, phase):
    deck = tmp_path / "deck.toml"
    deck.write_text(write_deck(often()))
    run = Started("run", deck, "-n", 2, "--out", out, PDFEM_CRASH_AT=f"{phase}:3")
    assert run.end() not in (FINISHED, STOPPED)
    assert run_pdfem("run", deck, "-n", 3, "--out", out).returncode == FINISHED
    assert not differing(outcome(out), straight)


@pytest.mark.slow
def test_a_rank_that_hangs_ends_all_with_70(out, long):
    """Rank 1 is stopped like a process that waits for a dead disk; rank 0 hears nothing any more."""
    run = Started("run", long, "-n", 2, "--out", out, PDFEM_WATCHDOG_SECONDS="10")
    stopped = run.ranks()[1]
    stopped.suspend()
    try:
        assert run.end(timeout=60) == ABORTED, run.output
    finally:
        if stopped.is_running():
            stopped.kill()
    assert "no progress for" in run.output
    assert list(out.glob("run.r*.hang"))


# --- commands ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("make", "arguments", "code", "part"),
    [
        ("empty", ["resume"], NO_CHECKPOINT, "there is no deck.toml in it"),
        pytest.param("nothing", ["resume"], NO_CHECKPOINT, "there is no such folder", marks=pytest.mark.slow),
        pytest.param("empty", ["info"], NO_CHECKPOINT, "holds no run", marks=pytest.mark.slow),
        pytest.param("nothing", ["info"], NO_CHECKPOINT, "there is no such file", marks=pytest.mark.slow),
        pytest.param("text", ["info"], NO_CHECKPOINT, "no checkpoint of pdfem_mpi", marks=pytest.mark.slow),
    ],
)
def test_what_is_no_run_is_one_sentence_and_65(out, make, arguments, code, part):
    if make == "empty":
        out.mkdir()
    elif make == "text":
        out.write_text("hello" * 200)
    result = run_pdfem(*arguments, out)
    assert result.returncode == code
    assert len(result.stderr.splitlines()) == 1 and part in result.stderr


def test_info_of_a_run_and_of_its_checkpoints(out):
    assert alone(often(), out) == FINISHED
    newest = list_checkpoints(out / "checkpoints")[0][1]
    single = run_pdfem("info", newest, COLUMNS="200")
    assert single.returncode == 0 and "load factor" in single.stdout and "broken bonds" in single.stdout
    newest.write_bytes(newest.read_bytes()[:-1])
    single = run_pdfem("info", newest, COLUMNS="200")
    assert single.returncode == NO_CHECKPOINT and "damaged or cut off" in single.stderr
    whole = run_pdfem("info", out, COLUMNS="200")
    assert whole.returncode == 0 and "not sound" in whole.stdout
