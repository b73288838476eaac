"""Every command of docs/tutorial.md and of the how-to pages as it is written, and what the pages say that it prints."""

import importlib.util
import os
import re
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import pytest

import pdfem_mpi as pdfem
from support.helpers import ROOT, outside_launcher

TUTORIAL = ROOT / "docs" / "tutorial.md"
#: Pages whose commands go on where those of the tutorial end; Slurm's need a cluster.
HOW_TO = sorted(path for path in (ROOT / "docs" / "howto").glob("*.md") if path.name not in ("slurm.md", "gmsh.md"))
INSTALL = "tools/environment"
#: Peaks that the page tells, N; it prints three digits.
PEAKS = {"runs/bracket": 52.8, "runs/bracket_fine": 52.8}
PRINTED = 0.05


@dataclass(frozen=True)
class Block:
    """Commands in their order, the exit code of the last, and what it prints.

    ``notes`` is the comment before the block.
    """

    language: str
    commands: str
    notes: str
    printed: str | None

    @property
    def code(self):
        found = re.search(r"exit code (\d+)", self.notes)
        return int(found[1]) if found else 0


def blocks(page):
    """The blocks of commands and of Python of a page."""
    fenced = r"```(?P<language>sh|python)\n(?P<commands>.*?)```\n"
    pattern = rf"(?:<!-- (?P<notes>.*?) -->\n)?{fenced}(?:\n```text\n(?P<printed>.*?)```)?"
    found = re.finditer(pattern, page.read_text("utf-8"), re.DOTALL)
    return [Block(one["language"], one["commands"], one["notes"] or "", one["printed"]) for one in found]


def shell(commands, folder):
    """Run commands in a shell that ends with the first that fails, with the program's Python first on the path."""
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    arguments = ["bash", "-euo", "pipefail", "-c", commands]
    environment = outside_launcher(PATH=path, COLUMNS="200")
    return subprocess.run(arguments, cwd=folder, env=environment, capture_output=True, text=True, check=False)


def try_page(page, folder):
    """Run the blocks of a page; those of Python one after the other in one process, as a reader would."""
    code = "\n".join(block.commands for block in blocks(page) if block.language == "python")
    for block in blocks(page):
        if INSTALL in block.commands or ("needs gmsh" in block.notes and not importlib.util.find_spec("gmsh")):
            continue
        if block.language == "sh":
            done = shell(block.commands, folder)
            assert done.returncode == block.code, (block.commands, done.stdout, done.stderr)
            if block.printed and block.code:
                assert " ".join(block.printed.split()) in " ".join((done.stdout + done.stderr).split())
    if code:
        (folder / "page.py").write_text(code, encoding="utf-8")
        done = shell("python page.py", folder)
        assert done.returncode == 0, (code, done.stdout, done.stderr)


@pytest.fixture(scope="module")
def workplace(tmp_path_factory):
    """A folder with the decks, in which the commands of the tutorial were typed."""
    folder = tmp_path_factory.mktemp("workplace")
    shutil.copytree(ROOT / "jobs", folder / "jobs")
    try_page(TUTORIAL, folder)
    return folder


def test_the_pages_have_their_parts():
    """Blocks are found by their fences: a page without any would pass all of the tests below."""
    tutorial = blocks(TUTORIAL)
    assert len(tutorial) >= 12 and [block.code for block in tutorial].count(64) == 3
    assert tutorial[0].commands.startswith(INSTALL)
    assert len(HOW_TO) >= 7 and all(blocks(page) for page in HOW_TO)


@pytest.mark.slow
def test_tutorial_as_written(workplace):
    for folder, peak in PEAKS.items():
        found = pdfem.open_run(workplace / folder).summary["failure"]["peak"]["load"]
        assert abs(found - peak) <= PRINTED, folder
    figures = {path.name for path in (workplace / "runs" / "bracket" / "figures").iterdir()}
    assert {"reaction.png", "body.png", "energies.png", "damage.png", "body-z-5.0.gif"} <= figures
    assert (workplace / "runs" / "energy" / "study.png").exists()


@pytest.mark.slow
@pytest.mark.parametrize("page", HOW_TO, ids=lambda page: page.stem)
def test_how_to_pages_as_written(page, workplace):
    try_page(page, workplace)


@pytest.mark.slow
def test_installation_as_written(tmp_path):
    """In a copy of the repository; needs a package index."""
    tracked = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, check=False)
    if tracked.returncode:
        pytest.skip("no git repository to copy")
    for name in filter(None, tracked.stdout.split("\0")):
        if (ROOT / name).is_file():
            (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, tmp_path / name)
    done = shell(blocks(TUTORIAL)[0].commands, tmp_path)
    if "pip could not install" in done.stderr:
        pytest.skip("no package index can be reached")
    assert done.returncode == 0, (done.stdout, done.stderr)
