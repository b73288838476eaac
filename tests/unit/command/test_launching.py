"""A run on several ranks becomes their launcher at once; whatever is not plain is read by the command line."""

import pytest

from pdfem_mpi.command.launching import ranks_asked
from pdfem_mpi.system import launcher as launch
from support.helpers import run_pdfem, run_python

DECK = "jobs/bar_tension.toml"


@pytest.mark.parametrize(
    ("arguments", "ranks"),
    [
        ("run a.toml -n 2", 2),
        ("resume runs/a --ranks 3 --force", 3),
        ("run a.toml -n 4", 4),
        ("run a.toml -n 5", 0),  # more than cores: there may be fewer cells
        ("run a.toml", 0),
        ("run a.toml -n", 0),
        ("run a.toml -n two", 0),
        ("run a.toml -n -2", 0),
        ("run a.toml -n 2 -n 3", 0),
        ("run a.toml --ranks=2", 0),
        ("run -n 2 --help", 0),
        ("check a.toml -n 2", 0),
        ("", 0),
    ],
)
def test_ranks_in_the_usual_words(arguments, ranks, monkeypatch):
    monkeypatch.setattr(launch, "allowed_cores", lambda: 4)
    assert ranks_asked(arguments.split()) == ranks


BECOMING = """
import os, sys
from pdfem_mpi.command.launching import launch, main
launch.allowed_cores = lambda: 2
heavy = {"numpy", "typer", "pydantic"}
os.execv = lambda path, command: sys.exit(" ".join([*(heavy & set(sys.modules)), *command[1:]]))
main()
"""


def test_a_launcher_loads_neither_the_command_line_nor_the_deck():
    result = run_python("-c", BECOMING, "run", "nowhere.toml", "-n", "2")
    assert "-n 2" in result.stdout
    assert result.stderr.startswith("-n 2 ") and result.stderr.endswith("run nowhere.toml -n 2\n")


@pytest.mark.parametrize(
    ("arguments", "part"),
    [
        (["run", "jobs/bar_tensoin.toml"], "there is no such file"),
        (["run", DECK, "--set", "mesh.spacing=0.07"], "mesh.spacing = 0.07 does not divide"),
        (["run", DECK, "--nonsense"], "No such option"),
        (["resume", "nowhere"], "holds no run"),
    ],
)
def test_what_is_wrong_is_told_once_by_the_ranks(arguments, part):
    result = run_pdfem(*arguments, "-n", "2")
    assert result.returncode in (64, 65)
    assert sum(part in line for line in result.stderr.splitlines()) == 1, result.stderr
