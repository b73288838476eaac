"""A run works in no folder but its own, and removes no file but those that it wrote; pipes and devices are no files."""

import json
import os
import signal
import subprocess
import sys

import pytest

from pdfem_mpi.command.study import StudyError, check_folder
from pdfem_mpi.deck.outputs import LineProbe, Output
from pdfem_mpi.deck.programs import Steps
from pdfem_mpi.deck.table import DeckError, SceneError
from pdfem_mpi.deck.toml import read_deck, write_deck
from pdfem_mpi.results.ownership import RECORD, Written, is_run, refuse_deck, refuse_folder, refuse_study
from pdfem_mpi.runs.restart_point import AUTO
from pdfem_mpi.system.files import replacing
from pdfem_mpi.system.plain_files import NotPlain, read_plain, strange_kind
from support.bodies import make_scene
from support.helpers import ROOT, outside_launcher, run_pdfem
from support.reporters import Listener
from support.restarts import alone

FINISHED, USAGE = 0, 64
LINE = LineProbe(kind="line", name="middle", start=(0.0, 0.5, 0.5), stop=(3.0, 0.5, 0.5), n=5)


def scene(factors=(1.0,), **tables):
    """Three elements in a row, pulled, with a line to draw."""
    tables = {"stepping": Steps(load_factors=factors), "probes": (LINE,), "output": Output(fields=False)} | tables
    return make_scene((3, 1, 1), 3, solver="cg", **tables)


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """A finished run, not to be changed."""
    out = tmp_path_factory.mktemp("finished") / "run"
    assert alone(scene(), out) == FINISHED
    return out


@pytest.fixture
def out(finished, tmp_path):
    """A copy of the finished run."""
    subprocess.run(["cp", "-a", str(finished), str(tmp_path / "run")], check=True)
    return tmp_path / "run"


def tree(folder):
    """All files below a folder and their bytes."""
    return {str(path.relative_to(folder)): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


USERS = ("notes.txt", "figures/photo.png", "lines/measured.csv", "checkpoints/keep.h5", "history.csv", "deck.toml")


def put(folder, names, text="mine"):
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)


# --- folders that are no run's ----------------------------------------------------------------------------


@pytest.mark.parametrize("ways", [{}, {"overwrite": True}, {"resume": "never"}])
@pytest.mark.parametrize("names", [USERS, ("history.csv",), ("deck.toml",), ("figures/photo.png",), (".hidden",)])
def test_a_folder_with_other_files_is_refused_and_left_alone(tmp_path, names, ways):
    put(tmp_path, names)
    before, reporter = tree(tmp_path), Listener()
    assert alone(scene(), tmp_path, reporter=reporter, **ways) == USAGE
    assert reporter.said("is not empty and holds no run", "--out")
    assert tree(tmp_path) == before


def test_a_file_in_the_place_of_the_folder_is_refused(tmp_path):
    put(tmp_path, ("run",))
    assert "is not a folder" in refuse_folder(tmp_path / "run")
    assert alone(scene(), tmp_path / "run") == USAGE


@pytest.mark.parametrize("kind", ["missing", "empty", "stale lock", "fit"])
def test_new_and_empty_folders_serve(tmp_path, kind):
    """So do those with nothing but what a start leaves that died before its first word."""
    folder = tmp_path / "run"
    if kind != "missing":
        folder.mkdir()
    if kind == "stale lock":
        (folder / "RUNNING").write_text(json.dumps({"host": "gone", "pid": 1}))
        (folder / "jobs_without_progress").write_text("x")
    elif kind == "fit":
        (folder / f"bond_factors-{'0' * 24}.npz").touch()
    assert refuse_folder(folder) is None


def test_a_refused_start_leaves_no_word(tmp_path, out, monkeypatch):
    """The scene is refused when the folder has been taken already: an empty one is as it was, and so is a run's."""

    def refuse(*arguments):
        raise SceneError(["does not fit into memory."])

    monkeypatch.setattr("pdfem_mpi.runs.run.prepare", refuse)
    (tmp_path / "empty").mkdir()
    before = tree(out)
    for folder in (tmp_path / "empty", out):
        with pytest.raises(SceneError):
            alone(scene(), folder, overwrite=folder == out)
    assert list((tmp_path / "empty").iterdir()) == []
    assert tree(out) == before


# --- folders of runs --------------------------------------------------------------------------------------


def test_files_of_the_user_in_a_run_folder_survive(out):
    """A line of the user's is not the program's because its name ends alike."""
    mine = ("notes.txt", "figures/photo.png", "lines/measured.csv", "checkpoints/keep.h5")
    put(out, mine)
    assert {"lines/middle.csv", "figures/line_middle.png"} <= tree(out).keys()
    assert alone(scene(probes=()), out, overwrite=True) == FINISHED
    left = tree(out)
    assert all(left[name] == b"mine" for name in mine)
    assert not {"lines/middle.csv", "figures/line_middle.png"} & left.keys()
    assert (out / "checkpoints" / "ckpt-000001.h5").exists()


def test_a_file_of_the_user_under_a_name_that_is_needed_steps_aside(out):
    assert alone(scene(probes=()), out, overwrite=True) == FINISHED
    written = Written(out)
    written._names.discard("lines/middle.csv")
    record = (out / RECORD).read_text().replace("lines/middle.csv\n", "")
    (out / RECORD).write_text(record)
    put(out, ("lines/middle.csv",))
    assert alone(scene(), out, overwrite=True) == FINISHED
    assert (out / "lines" / "middle.csv.before").read_text() == "mine"
    assert (out / "lines" / "middle.csv").read_text().startswith("distance,")


@pytest.mark.parametrize("left", ["all", "checkpoints", "history.csv", "run.log"])
def test_run_folders_without_a_record_are_known(out, left):
    """As they were written before there was one: finished, or killed at some time."""
    for name in (RECORD, "starts.jsonl"):
        (out / name).unlink()
    assert is_run(out)
    put(out, ("figures/photo.png",))
    if left != "all":
        (out / "summary.json").unlink()
        for name in {"history.csv", "run.log"} - {left}:
            (out / name).unlink()
        if left != "checkpoints":
            subprocess.run(["rm", "-r", str(out / "checkpoints")], check=True)
    assert is_run(out)
    assert alone(scene(probes=()), out, overwrite=True) == FINISHED
    assert (out / "figures" / "photo.png").exists()
    assert not (out / "figures" / "line_middle.png").exists() and not (out / "lines").exists()


def test_a_record_that_was_torn_or_tampered_with_removes_nothing_else(out, tmp_path):
    put(tmp_path, ("outside.txt",))
    put(out, ("lines/mine.csv",))
    with (out / RECORD).open("a") as file:
        file.write("../outside.txt\n/etc/none\nlines/../../outside.txt\nlines/mine.csv")
    assert alone(scene(), out, overwrite=True) == FINISHED
    assert (tmp_path / "outside.txt").exists() and (out / "lines" / "mine.csv").exists()
    assert "lines/middle.csv" in Written(out)._names


# --- the deck that is read --------------------------------------------------------------------------------


def test_the_deck_that_is_read_is_never_replaced(tmp_path):
    """The user's own folder, by any way to write its name."""
    deck = tmp_path / "deck.toml"
    deck.write_text("# mine\n" + write_deck(scene()))
    (tmp_path / "link").symlink_to(tmp_path)
    before = deck.read_bytes()
    for place in (tmp_path, tmp_path / "link", tmp_path / "link" / ".." / tmp_path.name):
        assert "holds no run" in refuse_folder(place)
    result = run_pdfem("run", "deck.toml", "--out", ".", "--overwrite", cwd=tmp_path)
    assert result.returncode == USAGE and "holds no run" in result.stderr, result.stderr
    assert deck.read_bytes() == before and sorted(os.listdir(tmp_path)) == ["deck.toml", "link"]


@pytest.mark.parametrize("name", ["deck.toml", "history.csv", "run.log", "summary.json"])
def test_a_deck_in_the_way_of_the_run_is_refused(out, tmp_path, name):
    link = tmp_path / "link.toml"
    link.symlink_to(out / name)
    assert "is the deck that is read" in refuse_deck(out, out / name, same=False)
    assert "is the deck that is read" in refuse_deck(out, link, same=False)
    assert refuse_deck(out, tmp_path / "other.toml", same=False) is None
    assert refuse_deck(out, out / "lines" / "other.toml", same=False) is None
    assert (refuse_deck(out, out / name, same=True) is None) == (name == "deck.toml")
    reporter = Listener()
    assert alone(scene((0.5, 1.0)), out, overwrite=True, deck=link, reporter=reporter) == USAGE
    assert reporter.said("would replace it")


def test_a_deck_of_the_run_folder_that_a_person_wrote_keeps_its_comments(out):
    """The same values: it stays. Other values: what was there steps aside, and it is said."""
    text = "# mine\n" + (out / "deck.toml").read_text()
    (out / "deck.toml").write_text(text)
    assert alone(scene(), out, overwrite=True, deck=out / "deck.toml") == FINISHED
    assert (out / "deck.toml").read_text() == text
    assert alone(scene((0.5, 1.0)), out, overwrite=True) == FINISHED
    assert (out / "deck.toml.before").read_text() == text
    assert (out / "deck.toml").read_text() == write_deck(scene((0.5, 1.0)))
    assert alone(scene((0.25, 1.0)), out, overwrite=True) == FINISHED
    assert not (out / "deck.toml.before.2").exists()  # the program's own


def test_the_checkpoint_to_go_on_from_is_not_removed(out):
    first = out / "checkpoints" / "ckpt-000001.h5"
    reporter = Listener()
    assert alone(scene(), out, overwrite=True, resume=str(first), reporter=reporter) == USAGE
    assert first.exists() and reporter.said("Leave one of them away")


# --- studies and figures ----------------------------------------------------------------------------------


def test_a_study_refuses_folders_of_others(tmp_path, out):
    put(tmp_path / "a", ("study.csv", "logs/mine.log"))
    with pytest.raises(StudyError, match="holds no study"):
        check_folder(tmp_path / "a")
    (tmp_path / "a" / "study.csv").write_text("mesh.spacing,status,exit_code,reason,folder,deck_sha256\n")
    for folder in (tmp_path / "a", tmp_path / "none"):
        assert refuse_study(folder) is None
    (tmp_path / "b" / "members").mkdir(parents=True)
    assert refuse_study(tmp_path / "b") is not None
    out.rename(tmp_path / "b" / "members" / "x=1")
    assert refuse_study(tmp_path / "b") is None


def test_plot_draws_into_no_folder_but_a_runs(tmp_path, out):
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "deck.toml").write_text((out / "deck.toml").read_text())
    put(tmp_path / "mine", ("figures/reaction.png",))
    result = run_pdfem("plot", tmp_path / "mine")
    assert result.returncode == USAGE and "holds no run" in result.stderr
    assert (tmp_path / "mine" / "figures" / "reaction.png").read_text() == "mine"


# --- files without an end ---------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["run.log", "RUNNING", "history.csv", "summary.json", "deck.toml", RECORD])
@pytest.mark.parametrize("kind", ["pipe", "device"])
def test_pipes_and_devices_in_a_run_folder_are_refused(out, name, kind):
    (out / name).unlink(missing_ok=True)
    if kind == "pipe":
        os.mkfifo(out / name)
    else:
        (out / name).symlink_to("/dev/zero")
    reporter = Listener()
    assert alone(scene(), out, overwrite=True, resume=AUTO, reporter=reporter) == USAGE
    assert reporter.said(name, "not a file. Remove it")


def test_pipes_devices_and_endless_files_are_no_decks_and_no_meshes(tmp_path):
    os.mkfifo(tmp_path / "pipe.toml")
    os.mkfifo(tmp_path / "pipe.msh")
    (tmp_path / "zero.toml").symlink_to("/dev/zero")
    with (tmp_path / "huge.toml").open("wb") as file:
        file.truncate(1 << 40)
    for name, part in (("pipe", "a pipe"), ("zero", "a device"), ("huge", "more than")):
        with pytest.raises(DeckError, match=part):
            read_deck(tmp_path / f"{name}.toml")
    from pdfem_mpi.mesh.reader import _trouble

    assert "a pipe" in _trouble(tmp_path / "pipe.msh", "gmsh")
    assert strange_kind(tmp_path) is None and strange_kind(tmp_path / "none") is None
    with pytest.raises(IsADirectoryError):
        read_plain(tmp_path, 10)
    (tmp_path / "ten").write_bytes(b"x" * 10)
    assert read_plain(tmp_path / "ten", 10) == b"x" * 10
    with pytest.raises(NotPlain, match="more than 9 bytes"):
        read_plain(tmp_path / "ten", 9)


def test_nothing_is_written_through_a_link_or_a_pipe_under_a_temporary_name(tmp_path):
    put(tmp_path, ("precious",))
    (tmp_path / "a.tmp").symlink_to(tmp_path / "precious")
    os.mkfifo(tmp_path / "b.tmp")
    for name in "ab":
        with replacing(tmp_path / name) as temporary:
            temporary.write_text("new")
    assert (tmp_path / "precious").read_text() == "mine"
    assert (tmp_path / "a").read_text() == (tmp_path / "b").read_text() == "new"


def test_a_run_that_waits_for_its_deck_ends_at_a_signal(tmp_path):
    """Rank 0 reads for ever here; there is nothing to keep, and the code is that of a run that was stopped."""
    code = """
import time
from pdfem_mpi.command import cli, world
from pdfem_mpi.system import signals
signals.SET_UP_SECONDS = 0.3
world.read_text = lambda deck: (print("reading", flush=True), time.sleep(60))
cli.main()
"""
    process = subprocess.Popen(
        [sys.executable, "-c", code, "run", "deck.toml", "--out", str(tmp_path / "run")],
        cwd=ROOT, env=outside_launcher(), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    assert process.stdout.readline() == "reading\n"
    process.send_signal(signal.SIGTERM)
    _, errors = process.communicate(timeout=20)
    assert process.returncode == 75 and "SIGTERM before the first step" in errors


def test_a_run_that_is_refused_late_keeps_what_says_that_it_is_one(tmp_path, monkeypatch):
    """The folder has been written into then: the same command may start there again."""

    def refuse(*arguments):
        raise SceneError(["the loads are not balanced."])

    monkeypatch.setattr("pdfem_mpi.runs.assembly.make_solver", refuse)
    with pytest.raises(SceneError):
        alone(scene(), tmp_path / "run")
    monkeypatch.undo()
    assert is_run(tmp_path / "run") and (tmp_path / "run" / "deck.toml").exists()
    assert alone(scene(), tmp_path / "run") == FINISHED
