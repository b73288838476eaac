"""RUNNING: one job in a folder; what dead jobs leave does not keep the next one out."""

import json
import os
import subprocess
import sys

import pytest

from pdfem_mpi.system import lock
from pdfem_mpi.system.lock import NAME, Lock, Locked, owner_of, started


def leave(folder, **changes):
    """A file as another job wrote it."""
    mine = {"host": lock.socket.gethostname(), "pid": os.getpid(), "started": started(os.getpid()), "job": "7"}
    (folder / NAME).write_text(json.dumps(mine | changes))


@pytest.fixture
def dead():
    """The number of a process that has ended."""
    process = subprocess.Popen([sys.executable, "-c", "pass"])
    process.wait()
    return process.pid


def test_a_folder_is_held_until_its_release(tmp_path):
    held = Lock(tmp_path, "42")
    assert json.loads((tmp_path / NAME).read_text())["job"] == "42"
    with pytest.raises(Locked, match=rf"process {os.getpid()} on .* \(job 42\) writes into this folder"):
        Lock(tmp_path)
    held.release()
    assert os.listdir(tmp_path) == []
    Lock(tmp_path).release()


def test_a_process_that_is_gone_holds_nothing(tmp_path, dead):
    leave(tmp_path, pid=dead)
    held = Lock(tmp_path)
    assert f"left by process {dead}" in held.note
    assert os.listdir(tmp_path) == [NAME]


def test_a_reused_process_number_is_another_process(tmp_path):
    """This process lives, but began at another time than the one that wrote the file."""
    leave(tmp_path, started="some boot 12345")
    assert "left by" in Lock(tmp_path).note


@pytest.mark.parametrize("changes", [{"host": "elsewhere"}, {"pid": "?"}])
def test_a_job_that_cannot_be_asked_keeps_the_folder_unless_it_is_stolen(tmp_path, changes):
    leave(tmp_path, **changes)
    with pytest.raises(Locked, match="add --steal-lock"):
        Lock(tmp_path)
    assert Lock(tmp_path, steal=True).note


@pytest.mark.parametrize("text", ["", "{", "[1]", "\udcff"])
def test_a_file_of_no_known_job_can_be_stolen(tmp_path, text):
    (tmp_path / NAME).write_bytes(text.encode("utf-8", "surrogateescape"))
    with pytest.raises(Locked, match="a job that left no name"):
        Lock(tmp_path)
    Lock(tmp_path, steal=True)


def test_release_leaves_another_jobs_file(tmp_path):
    held = Lock(tmp_path)
    leave(tmp_path, host="elsewhere")
    held.release()
    assert (tmp_path / NAME).exists()


def test_of_two_jobs_that_find_a_stale_file_one_gets_the_folder(tmp_path, dead, monkeypatch):
    """Between this job's look and its move, another one takes over: its file is put back."""
    leave(tmp_path, pid=dead)
    rename = os.rename

    def slow(source, target):
        monkeypatch.setattr(os, "rename", rename)
        (tmp_path / NAME).unlink()
        leave(tmp_path, host="elsewhere")
        rename(source, target)

    monkeypatch.setattr(os, "rename", slow)
    with pytest.raises(Locked, match="elsewhere"):
        Lock(tmp_path)
    assert json.loads((tmp_path / NAME).read_text())["host"] == "elsewhere"
    assert os.listdir(tmp_path) == [NAME]


def test_a_file_system_without_links(tmp_path, monkeypatch):
    def refuse(*arguments):
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(os, "link", refuse)
    held = Lock(tmp_path)
    with pytest.raises(Locked):
        Lock(tmp_path)
    held.release()
    assert os.listdir(tmp_path) == []


def test_owner_in_words(tmp_path, dead):
    assert owner_of(tmp_path) is None
    leave(tmp_path)
    assert owner_of(tmp_path)[1] is True
    leave(tmp_path, pid=dead)
    assert owner_of(tmp_path)[1] is False
    leave(tmp_path, host="elsewhere")
    assert owner_of(tmp_path) == (f"process {os.getpid()} on elsewhere (job 7)", None)
