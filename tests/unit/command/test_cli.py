"""The command line as a user meets it: exit codes, one message each, no traceback, no hang."""

import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import pytest

from pdfem_mpi.command.console import ConsoleReporter, remaining
from pdfem_mpi.system.launcher import LaunchError, mpirun_command
from support.helpers import ROOT, outside_launcher, run_pdfem, run_python

DECK = ROOT / "jobs" / "bar_tension.toml"

# A run that stands in for the real one: what it does is chosen by the variable STUB.
STUB = r"""
import os, sys, time, types
from pdfem_mpi.deck.table import SceneError

def run(scene, comm, out, deck_text, overwrite, reporter, ways):
    what = os.environ["STUB"]
    comm.Barrier()
    if what == "scene error":
        raise SceneError(["the loads are not balanced. Balance them."])
    if what == "crash" and comm.rank == comm.size - 1:
        raise ValueError("unforeseen")
    if what == "wait":
        print("waiting", flush=True)
        deadline = time.monotonic() + 30
        while not ways.requests.stop and time.monotonic() < deadline:
            time.sleep(0.05)
    comm.Barrier()
    spacing = f"spacing = {scene.mesh.spacing}" in deck_text
    # one write: the lines of ranks may mingle
    sys.stdout.write(f"rank {comm.rank} of {comm.size} out {out} overwrite {overwrite} spacing {spacing}\n")
    sys.stdout.flush()
    return 75

def check_scene(scene, comm, ranks=None, picture=None):
    return {"cells": str(scene.mesh.n_cells)}

def stand_in(name, **members):
    sys.modules[f"pdfem_mpi.runs.{name}"] = stub = types.ModuleType(f"pdfem_mpi.runs.{name}")
    vars(stub).update(members)

stand_in("run", run=run)
stand_in("checking", check_scene=check_scene)
stand_in("prepare", warm_up=lambda *arguments: None)
stand_in("start", RunOptions=types.SimpleNamespace, Refused=type("Refused", (Exception,), {}))
from pdfem_mpi.command.cli import main
main()
"""

try:
    MPIRUN, MPI_ADDITIONS = mpirun_command(2)
except LaunchError:
    MPIRUN, MPI_ADDITIONS = None, {}


@pytest.fixture
def stub(tmp_path):
    """A script called ``pdfem``, as installed, with a stub in place of the run."""
    script = tmp_path / "pdfem"
    script.write_text(STUB)
    return script


def messages(result):
    """The lines of stderr, after checking that none is from Python or a library."""
    for word in ("Traceback", "pydantic", "Error:", "╭"):
        assert word not in result.stderr, result.stderr
    return result.stderr.splitlines()


def run_on_two(*arguments, **additions):
    assert MPIRUN is not None, "no mpirun: install an MPI runtime"
    return subprocess.run(
        [*MPIRUN, sys.executable, *map(str, arguments)],
        cwd=ROOT,
        env=outside_launcher(**MPI_ADDITIONS, **additions),
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )


# --- bad input: 64, one sentence for each problem ---------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "part"),
    [
        (["run"], "Missing argument 'DECK'. See `pdfem run --help`."),
        (["run", "x.toml", "--nonsense"], "No such option"),
        (["nonsense"], "No such command 'nonsense'"),
        (["run", DECK, "-n", "0"], "'-n'"),
        (["run", DECK, "-n", "two"], "'-n'"),
        (["run", "jobs/bar_tensoin.toml"], "there is no such file. Did you mean jobs/bar_tension.toml?"),
        (["run", "jobs/bar_tensoin.toml", "-n", "4999"], "there is no such file"),
        (["check", "jobs"], "this is a folder"),
        (["check", "LICENSE"], "this is not a TOML file"),
        (["check", DECK, "--picture", "deck.pdf"], "--picture deck.pdf: it is a PNG file. Give a name with .png"),
        (["run", DECK, "--set", "mesh.spacing=0.07"], "mesh.spacing = 0.07 does not divide"),
        (["run", DECK, "-n", "4999", "--set", "mesh.spacing=0.07"], "mesh.spacing = 0.07 does not divide"),
        (["run", DECK, "-n", "4999", "--set", "mesh.spacing=0.4"], "ranks cannot share 25 cells. Use at most 25"),
        (["check", DECK, "--set", "mesh.spacing"], "must read key.path=value"),
    ],
)
def test_bad_input_exits_64_with_one_sentence(arguments, part):
    result = run_pdfem(*arguments)
    lines = messages(result)
    assert result.returncode == 64
    assert len(lines) == 1 and part in lines[0], lines
    assert not result.stdout  # no launcher either


def test_all_problems_of_a_deck_are_printed():
    result = run_pdfem("check", DECK, "--set", "mesh.spacing=-1", "--set", "material.poissons_ratio=0.495")
    assert result.returncode == 64
    assert len(messages(result)) == 2


def test_no_arguments_print_help():
    result = run_pdfem()
    assert result.returncode == 64
    assert "Usage" in result.stdout and messages(result) == []


def test_help_exits_0():
    assert run_pdfem("run", "--help").returncode == 0


def test_scene_error_of_a_later_stage_has_the_decks_name(stub):
    result = run_python(stub, "run", DECK, STUB="scene error")
    assert result.returncode == 64
    assert messages(result) == [f"{DECK}: the loads are not balanced. Balance them."]


def test_mpi_library_that_cannot_be_loaded_is_a_sentence():
    result = run_pdfem("run", DECK, MPI4PY_LIBMPI="/nowhere/libmpi.so")
    assert result.returncode == 64
    assert "no MPI library could be loaded" in messages(result)[0]


def test_n_without_mpirun_is_a_sentence(stub, tmp_path):
    """A Python without mpirun beside it and none in PATH."""
    bare = tmp_path / "bin"
    bare.mkdir()
    (bare / "python").symlink_to(sys.executable)
    code = f"import sys; sys.executable = {str(bare / 'python')!r}; sys.argv = ['pdfem', *sys.argv[1:]]\n" + STUB
    result = run_python("-c", code, "run", DECK, "-n", "2", PATH=str(bare))
    assert result.returncode == 64
    assert "there is no mpirun" in messages(result)[0]


def test_launcher_of_another_library_is_refused():
    """PMI_SIZE says two ranks and MPI sees one: N copies of a one-rank world."""
    result = run_pdfem("run", DECK, PMI_SIZE="2")
    assert result.returncode == 64
    lines = messages(result)
    assert len(lines) == 1 and "PMI_SIZE = 2" in lines[0]


# --- runs -------------------------------------------------------------------------------------------------


def test_without_n_one_rank_runs_in_this_process(stub, tmp_path):
    result = run_python(stub, "run", DECK, "--set", "mesh.spacing=0.1", cwd=tmp_path, STUB="finish")
    assert result.stdout == "rank 0 of 1 out runs/bar_tension overwrite False spacing True\n"
    assert (result.returncode, messages(result)) == (75, [])


def test_n_starts_mpirun_and_passes_the_exit_code(stub):
    result = run_python(stub, "run", DECK, "-n", "2", "--out", "some/where", "--overwrite", STUB="finish")
    lines = result.stdout.splitlines()
    assert lines[0].startswith("pdfem: ") and "-n 2" in lines[0]
    expected = "of 2 out some/where overwrite True spacing True"
    assert sorted(lines[1:]) == [f"rank 0 {expected}", f"rank 1 {expected}"]
    assert result.returncode == 75


def test_pid_of_pdfem_becomes_the_launcher(stub):
    """A signal to the pid that a batch script knows must reach the launcher, which forwards USR1."""
    process = subprocess.Popen(
        [sys.executable, stub, "run", DECK, "-n", "2"],
        env=outside_launcher(STUB="wait"),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        while "waiting" not in process.stdout.readline():
            assert process.poll() is None
        time.sleep(0.2)
        assert "python" not in Path(os.readlink(f"/proc/{process.pid}/exe")).name
        process.send_signal(signal.SIGUSR1)
        assert process.wait(timeout=20) == 75
    finally:
        process.kill()
        process.communicate()


def test_launcher_of_the_user_is_respected(stub):
    result = run_on_two(stub, "run", DECK, STUB="finish")
    assert sorted(line[:11] for line in result.stdout.splitlines()) == ["rank 0 of 2", "rank 1 of 2"]
    assert result.returncode == 75


def test_n_must_equal_the_launchers_ranks(stub):
    assert run_on_two(stub, "run", DECK, "-n", "2", STUB="finish").returncode == 75
    result = run_on_two(stub, "run", DECK, "-n", "3", STUB="finish")
    assert result.returncode == 64
    assert sum("-n 3 is not the 2 ranks" in line for line in messages(result)) == 1


def test_bad_deck_is_reported_once_under_a_launcher():
    for part, arguments in {
        "there is no such file": ["run", "nowhere.toml"],
        "mesh.spacing = -1": ["run", DECK, "--set", "mesh.spacing=-1"],
        "No such command": ["nonsense"],
    }.items():
        result = run_on_two("-m", "pdfem_mpi", *arguments)
        assert result.returncode == 64, arguments
        assert sum(part in line for line in messages(result)) == 1, result.stderr


def test_scene_error_is_printed_once_under_a_launcher(stub):
    result = run_on_two(stub, "run", DECK, STUB="scene error")
    assert result.returncode == 64
    assert sum("not balanced" in line for line in messages(result)) == 1


def test_unforeseen_error_of_one_rank_ends_all_with_its_traceback(stub):
    """The other rank waits in a barrier; without the abort it would wait for ever."""
    result = run_on_two(stub, "run", DECK, STUB="crash")
    assert result.returncode == 70
    assert "[rank 1]" in result.stderr and "ValueError: unforeseen" in result.stderr


def test_unforeseen_error_on_one_rank_alone_is_70_too(stub):
    result = run_python(stub, "run", DECK, STUB="crash")
    assert result.returncode == 70
    assert "ValueError: unforeseen" in result.stderr


# --- other commands ---------------------------------------------------------------------------------------


def test_check_prints_what_would_be_allocated(stub):
    result = run_python(stub, "check", DECK, "--set", "mesh.spacing=0.1", STUB="")
    assert result.returncode == 0
    assert "(100, 4, 4)" in result.stdout


def test_warmup_names_the_cache(stub, tmp_path):
    result = run_python(stub, "warmup", STUB="", NUMBA_CACHE_DIR=str(tmp_path / "cache"))
    assert result.returncode == 0
    assert str(tmp_path / "cache") in result.stdout


def test_doctor_finds_this_environment_sound():
    result = run_pdfem("doctor", COLUMNS="200")
    assert result.returncode == 0, result.stderr
    assert re.search(r"matches: 2 ranks started", result.stdout)


# --- the reporter -----------------------------------------------------------------------------------------


def iteration(number, residual):
    return SimpleNamespace(iteration=number, residual=residual, damping=0.0123)


def test_progress_on_a_pipe_is_rare_and_ends_each_step(capsys):
    reporter = ConsoleReporter()
    for step in (1, 2):
        for number in range(1000):
            reporter.progress(step, 2, iteration(number, 1.0 / (1 + number)), 1e-3)
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[:4] for line in lines] == [
        ["step", "1/2", "iteration", "999"],
        ["step", "2/2", "iteration", "999"],
    ]
    assert "residual 1.00e-03" in lines[0] and "damping 0.0123" in lines[0] and "left" not in lines[0]


def test_progress_on_a_terminal_rewrites_its_line(capsys):
    reporter = ConsoleReporter()
    reporter.terminal = True
    reporter.progress(1, 1, iteration(1, 1.0), 1e-6)
    reporter.line("next")
    first, blank, following = capsys.readouterr().out.split("\r")[1:]
    assert first.startswith("step 1/1  iteration 1") and first.endswith("left")
    assert blank == " " * len(first)
    assert following == "next\n"


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ((60.0, 1.0, 1e-3, 1e-6), "01:00"),  # three decades a minute, three to go
        ((3600.0, 1.0, 1e-1, 1e-3), "2:00:00"),
        ((5.0, 1.0, 1.0, 1e-6), "--:--"),
        ((5.0, 1.0, 1e-7, 1e-6), "00:00"),
    ],
)
def test_time_left(arguments, text):
    assert remaining(*arguments) == text


def test_every_command_answers_help():
    for command in ("run", "check", "doctor", "warmup"):
        assert json.dumps(run_pdfem(command, "--help").returncode) == "0", command
