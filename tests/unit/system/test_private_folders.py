"""Compiled code is loaded from folders that nobody else can write: owners, modes, folders above, two users."""

import os
import shutil
import stat
import subprocess
import sys
import tempfile
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from pdfem_mpi.peridynamics.fit import cache as factor_cache
from pdfem_mpi.system import launcher as launch
from pdfem_mpi.system import private_folders
from pdfem_mpi.system.launcher import mpirun_command
from pdfem_mpi.system.private_folders import make_fresh, make_private, why_others_decide
from support.helpers import ROOT, outside_launcher, run_python

ME, STRANGER = os.geteuid(), 54321
VICTIM, ATTACKER = 54322, 65534


def mode(path):
    return stat.S_IMODE(os.lstat(path).st_mode)


def test_a_missing_folder_is_made_for_this_user_alone(tmp_path):
    folder = tmp_path / "a" / "b"
    before = os.umask(0)
    try:
        assert make_private(folder) is None
    finally:
        os.umask(before)
    assert mode(folder) == mode(folder.parent) == 0o700


def test_a_folder_that_others_could_write_is_closed_and_emptied(tmp_path):
    """What others may have left in it is not run; what only its owner could write stays."""
    folder = tmp_path / "cache"
    (folder / "kernels").mkdir(parents=True)
    (folder / "kernels" / "planted.nbi").write_bytes(b"x")
    folder.chmod(0o755)
    assert make_private(folder) is None and (folder / "kernels" / "planted.nbi").exists()
    folder.chmod(0o777)
    assert make_private(folder) is None
    assert mode(folder) == 0o700 and os.listdir(folder) == []


@pytest.mark.parametrize(
    ("kind", "owner", "bits", "part"),
    [
        (stat.S_IFDIR, ME, 0o755, None),
        (stat.S_IFDIR, 0, 0o755, None),
        (stat.S_IFDIR, 0, 0o1777, None),
        (stat.S_IFDIR, STRANGER, 0o755, f"belongs to user {STRANGER}"),
        (stat.S_IFDIR, STRANGER, 0o1777, f"belongs to user {STRANGER}"),
        (stat.S_IFDIR, ME, 0o777, "can be written by others (mode 0777)"),
        (stat.S_IFDIR, ME, 0o775, "can be written by others (mode 0775)"),
        (stat.S_IFLNK, ME, 0o777, "is not a folder"),
        (stat.S_IFREG, ME, 0o600, "is not a folder"),
    ],
)
def test_who_decides_what_a_folder_holds(monkeypatch, kind, owner, bits, part):
    """Owner and mode as the system tells them; the group 54321 is nobody's own."""
    found = SimpleNamespace(st_mode=kind | bits, st_uid=owner, st_gid=STRANGER)
    monkeypatch.setattr(private_folders.os, "lstat", lambda path: found)
    assert why_others_decide(Path("/somewhere")) == part


def test_the_group_that_only_this_user_is_in_may_write(monkeypatch):
    """Many systems give each user a group of his own and a umask of 002."""
    found = SimpleNamespace(st_mode=stat.S_IFDIR | 0o775, st_uid=ME, st_gid=7)
    monkeypatch.setattr(private_folders.os, "lstat", lambda path: found)
    user = SimpleNamespace(pw_name="ada", pw_gid=7)
    monkeypatch.setattr(private_folders.pwd, "getpwuid", lambda number: user)
    members = []
    monkeypatch.setattr(private_folders.grp, "getgrgid", lambda number: SimpleNamespace(gr_name="ada", gr_mem=members))
    assert why_others_decide(Path("/home/ada")) is None
    members.append("eve")
    assert "can be written by others" in why_others_decide(Path("/home/ada"))


def test_folders_above_count(tmp_path):
    """Who may write above a folder can put another one in its place."""
    above = tmp_path / "open"
    above.mkdir()
    above.chmod(0o777)
    assert f"{above} can be written by others" in make_private(above / "cache")
    above.chmod(0o1777)
    assert make_private(above / "cache") is None


@pytest.mark.parametrize("what", ["link", "file", "relative"])
def test_what_is_no_folder_does_not_serve(tmp_path, what):
    folder = tmp_path / "cache"
    (tmp_path / "other").mkdir()
    if what == "link":
        folder.symlink_to(tmp_path / "other")
    elif what == "file":
        folder.touch()
    assert make_private(Path("cache") if what == "relative" else folder) is not None


def test_a_link_of_the_user_to_another_disk_is_followed(tmp_path, monkeypatch):
    (tmp_path / "disk").mkdir()
    (tmp_path / "cache").symlink_to(tmp_path / "disk")
    monkeypatch.setattr(launch.platformdirs, "user_cache_path", lambda *args, **options: tmp_path / "cache")
    folder, reason = launch.compile_cache()
    assert reason is None and folder.parent == tmp_path / "disk"


def test_the_substitute_has_a_name_that_nobody_can_guess(tmp_path, monkeypatch):
    """Also where the temporary folder itself is not safe: another one serves then."""
    monkeypatch.setattr(private_folders.tempfile, "gettempdir", lambda: str(tmp_path))
    first, second = make_fresh(), make_fresh()
    assert first != second and first.parent == tmp_path and mode(first) == mode(second) == 0o700
    tmp_path.chmod(0o777)
    elsewhere = make_fresh()
    assert elsewhere is None or elsewhere.parent != tmp_path
    if elsewhere:
        elsewhere.rmdir()


def test_a_fit_of_another_user_is_not_read(tmp_path, monkeypatch):
    factor_cache.store((tmp_path,), "key", {"a": 1}, np.zeros((1, 2, 8, 10)))
    assert factor_cache.load((tmp_path,), "key") is not None
    path = next(tmp_path.glob("*.npz"))
    path.chmod(0o666)
    assert factor_cache.load((tmp_path,), "key") is None
    path.chmod(0o600)
    monkeypatch.setattr(private_folders.os, "geteuid", lambda: STRANGER)
    if ME:  # root's files are everybody's
        assert factor_cache.load((tmp_path,), "key") is None


def as_user(number, action):
    """Do something in a child process of another user, and return the text it gives."""
    out, into = os.pipe()
    child = os.fork()
    if child == 0:
        try:
            os.setgroups([])
            os.setgid(number)
            os.setuid(number)
            os.umask(0)
            os.write(into, str(action()).encode())
        except BaseException as error:
            os.write(into, repr(error).encode())
        finally:
            os._exit(0)
    os.close(into)
    os.waitpid(child, 0)
    with os.fdopen(out) as file:
        return file.read()


@pytest.mark.skipif(ME != 0, reason="only root can act as two other users")
@pytest.mark.parametrize("where", ["temporary", "usual"])
def test_a_second_user_plants_a_cache_in_vain(monkeypatch, where):
    """He makes the folders that the first user's start would look for, open to all, with a file in them."""
    base = Path(tempfile.mkdtemp(prefix="two-users-"))
    try:
        base.chmod(0o1777)
        name = f"{launch.__version__}-{launch.cpu_slug()}"
        planted = base / f"pdfem_mpi-{VICTIM}" / name if where == "temporary" else base / "cache" / "pdfem_mpi" / name
        as_user(ATTACKER, lambda: (planted.mkdir(parents=True), (planted / "x.nbi").touch()))
        assert (planted / "x.nbi").exists()
        monkeypatch.setenv("XDG_CACHE_HOME", "/proc/none" if where == "temporary" else str(base / "cache"))
        monkeypatch.setattr(tempfile, "tempdir", str(base))
        launch.platformdirs.user_cache_path("pdfem_mpi")  # its modules are not this user's to read

        def look():
            folder, reason = launch.compile_cache()
            found = folder.stat()
            return f"{folder}|{found.st_uid}|{stat.S_IMODE(found.st_mode):o}|{os.listdir(folder)}|{reason}"

        folder, owner, bits, content, reason = as_user(VICTIM, look).split("|")
        assert (int(owner), bits, content) == (VICTIM, "700", "[]")
        assert Path(folder).parent == base and (planted / "x.nbi").exists()
        assert where == "temporary" or "belongs to nobody" in reason or f"belongs to user {ATTACKER}" in reason
    finally:
        shutil.rmtree(base)


AGREE = """
import os
from pdfem_mpi.command.world import start_world
comm = start_world(None)
os.write(1, f"<{os.environ['NUMBA_CACHE_DIR']}>".encode())
comm.Barrier()
"""


def test_the_ranks_of_a_node_agree_on_the_substitute(tmp_path):
    """Each would make one of its own; it is told once."""
    command, additions = mpirun_command(2)
    result = subprocess.run(
        [*command, sys.executable, "-c", AGREE],
        cwd=ROOT,
        env=outside_launcher(**additions, XDG_CACHE_HOME="/proc/none", TMPDIR=str(tmp_path), NUMBA_CACHE_DIR=""),
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    first, second = (part for part in result.stdout.strip("<>").split("><"))
    assert first == second and Path(first).parent == tmp_path
    assert result.stderr.count("This start compiles into") == 1
    assert list(tmp_path.iterdir()) == []


def test_an_own_folder_named_by_the_user_is_taken_as_it_is(tmp_path):
    code = "from pdfem_mpi.system.launcher import prepare_environment as p; print(p())"
    result = run_python("-c", code, NUMBA_CACHE_DIR="/x")
    assert result.stdout == "None\n"
