"""Real processes of a run, ended by any signal at any time: the same bits when it was gone on with, or a plain refusal.

Each kill has a number that chooses, by a seeded generator, how many ranks run, who gets which signal, and when: from
the start of Python, before MPI, to the end of the load program.
"""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np
import psutil
import pytest

from pdfem_mpi.deck.outputs import Checkpoint, Output
from pdfem_mpi.deck.programs import Steps
from pdfem_mpi.deck.toml import write_deck
from pdfem_mpi.results.run_folder import read_summary
from pdfem_mpi.system.signals import Requests
from support.helpers import ROOT, outside_launcher
from support.restarts import FACTORS, alone, differing, outcome, relaxed

FINISHED, REFUSED, STOPPED = 0, 64, 75
SIGNALS = (signal.SIGKILL, signal.SIGTERM, signal.SIGINT, signal.SIGUSR1)
TARGETS = ("rank", "launcher", "all")
KILLS, KILLS_BY_DEFAULT = 60, 10
#: Of the ten, those of processes that a launcher starts: SIGKILL and Ctrl-C to it.
LAUNCHED = (4, 6)
#: When the ten are hit, at the latest: within the load program of a run that takes about as long.
SECONDS_BY_DEFAULT, FORK_SECONDS = 2.0, 0.4
#: What any signal may end a run with: stopped, or ended by the signal itself (9, 15, ... from a launcher).
END_SECONDS = 30.0


class Kill(NamedTuple):
    """One of the kills: ranks of the run and of the one that goes on, who is hit by what, and when."""

    ranks: int
    ranks_after: int
    target: str
    number: signal.Signals
    share: float


def kill_of(seed):
    """All signals and targets in turn, ranks and times at random; early and late ones as often as others."""
    rng = np.random.default_rng(seed)
    ranks, after = (int(n) for n in rng.integers(1, 4, 2))
    return Kill(ranks, after, TARGETS[seed // 4 % 3], SIGNALS[seed % 4], float(rng.uniform(0.0, 1.0)))


def scene(**tables):
    """A bar of some hundred iterations that keeps a checkpoint every 10 of them, with frames and a history."""
    return relaxed(
        checkpoint=Checkpoint(iterations=10),
        stepping=Steps(load_factors=(*FACTORS, 1.5, 2.0)),
        output=Output(figures=False),
        **tables,
    )


@pytest.fixture(scope="module")
def straight(tmp_path_factory):
    out = tmp_path_factory.mktemp("straight") / "run"
    assert alone(scene(), out) == FINISHED
    return outcome(out)


@pytest.fixture(scope="module")
def deck(tmp_path_factory):
    path = tmp_path_factory.mktemp("deck") / "bar.toml"
    path.write_text(write_deck(scene()))
    return path


def start(deck, out, ranks):
    """``pdfem run`` as the leader of a session of its own, where a Ctrl-C is meant for it."""
    return subprocess.Popen(
        [sys.executable, "-m", "pdfem_mpi", "run", str(deck), "--out", str(out), "-n", str(ranks)],
        cwd=ROOT,
        # a rank that dies within the start of Python is missed by the others after this time
        env=outside_launcher(PDFEM_WATCHDOG_SECONDS="15"),
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # a test run in the background ignores it
    )


def ranks_of(process):
    """Processes of the ranks: below the launcher, or the one process."""
    below = [child for child in psutil.Process(process.pid).children(recursive=True) if "pdfem_mpi" in cmdline(child)]
    return below or [psutil.Process(process.pid)]


def cmdline(process):
    try:
        return " ".join(process.cmdline())
    except psutil.Error:
        return ""


def hit(process, kill):
    """Send the signal; a terminal's Ctrl-C, and a batch system's signals to all, go to the launcher's group too."""
    family = [psutil.Process(process.pid), *psutil.Process(process.pid).children(recursive=True)]
    ranks = ranks_of(process)
    if kill.target == "all":
        os.killpg(process.pid, kill.number)
    for one in {"rank": ranks[-1:], "launcher": family[:1], "all": ranks}[kill.target]:
        try:
            one.send_signal(kill.number)
        except psutil.Error:
            continue
    return family


def kill_once(deck, out, kill, seconds):
    """Start, hit and wait; return the exit code and what was printed."""
    process = start(deck, out, kill.ranks)
    time.sleep(kill.share * seconds)
    family = hit(process, kill) if process.poll() is None else []
    began = time.monotonic()
    try:
        text, _ = process.communicate(timeout=END_SECONDS)
    finally:
        for left in psutil.wait_procs(family, timeout=5)[1]:  # none may go on writing
            left.kill()
    return process.returncode, text, time.monotonic() - began


def run_to_its_end(deck, out, ranks):
    """Give the same command again until it finishes; return the codes.

    A run that was killed after its last word, before its process was gone, is finished: a start there is refused.
    """
    codes = []
    while FINISHED not in codes and len(codes) < 3:
        process = start(deck, out, ranks)
        text, _ = process.communicate(timeout=120)
        codes.append(process.returncode)
        if process.returncode == REFUSED and "already holds a run" in text:
            assert read_summary(out)["status"] == "finished", text
            return codes
    assert codes[-1] == FINISHED, text
    return codes


@pytest.fixture(scope="module")
def seconds(deck, tmp_path_factory):
    """What a run takes from its start to its end here and now."""
    began = time.monotonic()
    run_to_its_end(deck, tmp_path_factory.mktemp("timed") / "run", 2)
    return time.monotonic() - began


def kill_fork(out, kill):
    """The same for one rank without a start of Python: a fork of this process that hears signals as ``pdfem`` does."""
    child = os.fork()
    if child == 0:
        code = 1
        try:
            requests = Requests()
            requests.install()
            code = alone(scene(), out, requests=requests)
        finally:
            os._exit(code)
    time.sleep(FORK_SECONDS * kill.share)
    os.kill(child, kill.number)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def test_ten_kills_of_one_run_change_nothing(tmp_path, deck, straight):
    """Killed again and again, on one rank and on two; a run that was over before its signal is followed by another."""
    out, codes = tmp_path / "run", []
    for seed in range(KILLS_BY_DEFAULT):
        kill = kill_of(seed)
        if seed in LAUNCHED:
            code, text, took = kill_once(deck, out, kill._replace(ranks=2), SECONDS_BY_DEFAULT)
            assert took < END_SECONDS, text
        else:
            code = kill_fork(out, kill)
        codes.append(code)
        if code == FINISHED:
            assert not differing(outcome(out), straight), codes
            out = tmp_path / f"run{seed}"
    assert len(set(codes)) > 1 and 64 not in codes and 70 not in codes, codes
    assert alone(scene(), out) == FINISHED
    assert not differing(outcome(out), straight), codes


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(KILLS))
def test_a_kill_at_any_time_changes_nothing(tmp_path, deck, straight, seconds, seed, record_property):
    kill = kill_of(seed)
    code, text, took = kill_once(deck, tmp_path / "run", kill, seconds)
    record_property("code", code)
    record_property("seconds", round(took, 2))
    if code == FINISHED and kill.number != signal.SIGKILL:
        assert "finished" in text, text  # it was over when the signal came
    codes = run_to_its_end(deck, tmp_path / "run", kill.ranks_after) if code != FINISHED else [code]
    different = differing(outcome(tmp_path / "run"), straight)
    log = os.environ.get("PDFEM_KILLS_LOG")
    if log:
        with Path(log).open("a") as file:
            file.write(f"{seed} {kill} code {code} after {took:.2f} s then {codes} different {different}\n")
    assert not different, (kill, code, text)
