"""Checkpoint files: what was written is what is read, and what is not a sound checkpoint is known as such."""

import errno
import os
import subprocess
from contextlib import contextmanager
from pathlib import Path

import h5py
import numpy as np
import pytest

from pdfem_mpi.results import checkpoint
from pdfem_mpi.results.checkpoint import SEAL, Invalid, Writer, check, open_checkpoint
from pdfem_mpi.results.checkpoint_files import checkpoint_path, list_checkpoints, remove_stale, rotate

TABLES = {"points/u": (700, 3, np.dtype("<f8")), "broken": (5, 2, np.dtype("<u4")), "nodes/u": (0, 3, np.dtype("<f8"))}
STATE = {"step": 3, "load_factor": 0.1 + 0.2, "iteration": 2, "spent": 7, "seconds": 1.5, "program": {"relaxing": 1}}
HEADER = {
    "written": "now", "versions": {"pdfem_mpi": "0"}, "cpu": "", "code_sha256": "", "ranks": 1, "fingerprint": "",
    "keys": {},
    "state": {**STATE, "bounds": {"bond": 0.1, "element": 0.0, "parts": {}}}, "broken_bonds": 5, "failure": None,
    "evaluations": 9, "seconds": 2, "restarts": [], "results": {}, "text": "größer",
}  # fmt: skip
FLIPS = 60  # of the default suite; 300 with --all


def content(seed=1):
    rng = np.random.default_rng(seed)
    return {
        "points/u": rng.normal(size=(700, 3)),
        "broken": rng.integers(0, 2**32, (5, 2)),
        "nodes/u": np.empty((0, 3)),
    }


def write(folder, number=1, seed=1, tables=TABLES):
    """Write a checkpoint in two slabs; return its name."""
    folder.mkdir(exist_ok=True)
    writer = Writer(checkpoint_path(folder, number), tables, "job")
    for name, rows in content(seed).items():
        writer.write_rows(name, 0, rows[:300])
        writer.write_rows(name, 300, rows[300:])
    writer.finish(HEADER)
    return writer.path


def names(folder):
    return sorted(path.name for path in folder.iterdir())


@pytest.fixture
def file(tmp_path):
    return write(tmp_path / "checkpoints")


# --- round trip -------------------------------------------------------------------------------------------


def test_header_and_tables_read_back_as_the_same_bits(file):
    assert check(file) == HEADER
    with open_checkpoint(file) as reader:
        for name, rows in content().items():
            assert reader.rows(name) == len(rows)
            np.testing.assert_array_equal(reader.read_rows(name, 0, len(rows)), rows)
        np.testing.assert_array_equal(reader.read_rows("points/u", 7, 11), content()["points/u"][7:11])
        assert reader.rows("nothing") == 0


def test_every_dataset_has_a_checksum_and_hdf5_opens_the_file_by_itself(file):
    with h5py.File(file, "r") as opened:
        assert opened["points/u"].fletcher32 and opened["broken"].fletcher32 and opened["header"].fletcher32
        assert opened["broken"].dtype == np.uint32


def test_nothing_but_the_file_is_left(file):
    assert names(file.parent) == ["ckpt-000001.h5"]


def test_equal_content_gives_equal_bytes(tmp_path):
    """No time stamp of HDF5's gets in: copies can be compared."""
    assert write(tmp_path / "a").read_bytes() == write(tmp_path / "b").read_bytes()


@pytest.mark.parametrize("name", ["with spaces", "größe-σ", "long/" * 40 + "end"])
def test_folders_with_any_name(tmp_path, name):
    folder = tmp_path / name
    folder.mkdir(parents=True)
    assert check(write(folder)) == HEADER


# --- what is not sound ------------------------------------------------------------------------------------


def flip(path, rng):
    data = bytearray(path.read_bytes())
    where = int(rng.integers(len(data)))
    data[where] ^= 1 << int(rng.integers(8))
    path.write_bytes(data)
    return where


@pytest.mark.parametrize("count", [FLIPS, pytest.param(300, marks=pytest.mark.slow)])
def test_every_flipped_bit_is_found(file, count):
    """In data, metadata, unused space and the seal itself; also the last byte and each of the seal's first."""
    sound, rng = file.read_bytes(), np.random.default_rng(count)
    missed = []
    for _ in range(count):
        file.write_bytes(sound)
        where = flip(file, rng)
        try:
            check(file)
            missed.append(where)
        except Invalid as error:
            assert not error.newer, where
    assert not missed
    for where in (*range(0, SEAL, 16), len(sound) - 1):
        file.write_bytes(sound[:where] + bytes([sound[where] ^ 1]) + sound[where + 1 :])
        with pytest.raises(Invalid):
            check(file)


@pytest.mark.parametrize("size", [0, 1, 20, 512, "half", "all but a byte"])
def test_cut_off_files_are_found(file, size):
    sound = file.read_bytes()
    file.write_bytes(sound[: {"half": len(sound) // 2, "all but a byte": len(sound) - 1}.get(size, size)])
    with pytest.raises(Invalid, match="empty" if size == 0 else "cut off"):
        check(file)


def test_longer_files_are_found(file):
    file.write_bytes(file.read_bytes() + b"\0")
    with pytest.raises(Invalid, match="damaged"):
        check(file)


def test_a_file_of_another_program_is_told(tmp_path):
    path = tmp_path / "ckpt-000001.h5"
    with h5py.File(path, "w") as opened:
        opened["x"] = 1
    with pytest.raises(Invalid, match="no checkpoint of pdfem_mpi"):
        check(path)


def test_a_newer_format_is_told_and_not_taken_for_damage(tmp_path, monkeypatch):
    monkeypatch.setattr(checkpoint._seal_of, "__defaults__", (checkpoint.FORMAT + 1,))
    path = write(tmp_path / "a")
    monkeypatch.undo()
    with pytest.raises(Invalid, match=f"format {checkpoint.FORMAT + 1}, of a newer pdfem_mpi") as error:
        check(path)
    assert error.value.newer


def test_missing_unreadable_and_folder_in_its_place(file, monkeypatch):
    with pytest.raises(Invalid, match="there is no such file"):
        check(file.with_name("other.h5"))
    with pytest.raises(Invalid, match="it is not a file"):
        check(file.parent)
    monkeypatch.setattr("builtins.open", refusing(errno.EACCES, "ckpt-"))
    with pytest.raises(Invalid, match="Permission denied"):
        check(file)


# --- writing that fails -----------------------------------------------------------------------------------


def refusing(number, part, call=open):
    def refuse(path, *arguments, **options):
        if part in str(path):
            raise OSError(number, os.strerror(number), str(path))
        return call(path, *arguments, **options)

    return refuse


class Full:
    """A raw file on a disk that takes so many bytes."""

    def __init__(self, file, room, number):
        self.file, self.room, self.number = file, room, number

    def __getattr__(self, name):
        return getattr(self.file, name)

    def write(self, data):
        self.room -= len(data)
        if self.room < 0:
            raise OSError(self.number, os.strerror(self.number))
        return self.file.write(data)


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EIO])
@pytest.mark.parametrize("room", [0, 100, 9000, 17500])
def test_full_disk_leaves_the_older_file_and_no_torn_one(file, monkeypatch, room, number):
    """Whatever write is the first that fails; and HDF5 lets go of the file."""

    @contextmanager
    def patched():
        from pdfem_mpi.results import guarded

        start = guarded._Sink.__init__

        def init(self, *arguments):
            start(self, *arguments)
            self.file = Full(self.file, room, number)

        with monkeypatch.context() as patch:
            patch.setattr(guarded._Sink, "__init__", init)
            yield

    before = len(os.listdir("/proc/self/fd"))
    with patched(), pytest.raises(OSError, match=os.strerror(number)):
        write(file.parent, 2)
    assert names(file.parent) == ["ckpt-000001.h5"]
    assert check(file) == HEADER
    assert len(os.listdir("/proc/self/fd")) == before
    assert check(write(file.parent, 2)) == HEADER


@pytest.mark.parametrize("call", ["fsync", "replace"])
@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EIO])
def test_failing_fsync_and_rename_leave_the_older_file(file, monkeypatch, call, number):
    def fail(*arguments):
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(os, call, fail)
    with pytest.raises(OSError, match=os.strerror(number)):
        write(file.parent, 2)
    assert names(file.parent) == ["ckpt-000001.h5"]


def test_a_bit_that_flips_between_memory_and_disk_is_found_before_the_rename(file, monkeypatch):
    """The written file is read again, with HDF5's checksums made from what was in memory."""
    read = checkpoint._read_everything

    def damaged(path, *arguments):
        data = path.read_bytes()
        number = content(2)["points/u"][350, 1].tobytes()
        assert number in data
        path.write_bytes(data.replace(number, bytes([number[0] ^ 4]) + number[1:]))
        read(path, *arguments)

    monkeypatch.setattr(checkpoint, "_read_everything", damaged)
    with pytest.raises(OSError):
        write(file.parent, 2, seed=2)
    assert names(file.parent) == ["ckpt-000001.h5"]


def test_a_real_full_disk(tmp_path):
    """A memory file system of 64 kB: HDF5 by itself would keep the space of the removed file, and crash at the end."""
    disk = tmp_path / "disk"
    disk.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=64k", "tmpfs", str(disk)]
    if os.geteuid() != 0 or subprocess.run(mount, capture_output=True, check=False).returncode:
        pytest.skip("mounting a file system needs root")
    try:
        (disk / "filler").write_bytes(bytes(56_000))
        with pytest.raises(OSError, match="No space left"):
            write(disk / "checkpoints")
        assert names(disk / "checkpoints") == []
        (disk / "filler").unlink()
        assert check(write(disk / "checkpoints")) == HEADER
    finally:
        subprocess.run(["umount", str(disk)], check=True)


# --- rotation ---------------------------------------------------------------------------------------------


def test_never_below_one_sound_file_over_ten_rotations(tmp_path, monkeypatch):
    """Every other write fails; whenever something is removed, a sound newer file is there."""
    folder = tmp_path / "checkpoints"
    remove = Path.unlink

    def watched(self, missing_ok=False):
        if self.suffix == ".h5":
            newest = list_checkpoints(folder)[0][1]
            assert newest != self and check(newest) == HEADER
        remove(self, missing_ok)

    monkeypatch.setattr(Path, "unlink", watched)
    for number in range(1, 11):
        write(folder, number)
        rotate(folder, 3)
        with monkeypatch.context() as patch, pytest.raises(OSError):
            patch.setattr(os, "fsync", refusing(errno.EIO, ""))
            write(folder, number + 1)
        found = [n for n, _ in list_checkpoints(folder)]
        assert found == list(range(number, max(number - 3, 0), -1))


def test_only_checkpoints_are_listed_newest_first(tmp_path):
    others = ["ckpt-1.h5", "ckpt-000002.h5.tmp.7", "ckpt-000002.h5.damaged", "xckpt-000002.h5", "notes"]
    for name in ["ckpt-000009.h5", "ckpt-1000000.h5", "ckpt-000010.h5", *others]:
        (tmp_path / name).write_bytes(b"")
    assert [number for number, _ in list_checkpoints(tmp_path)] == [1000000, 10, 9]
    assert list_checkpoints(tmp_path / "nowhere") == []
    assert remove_stale(tmp_path) == 1
    assert not (tmp_path / "ckpt-000002.h5.tmp.7").exists()


def test_a_folder_called_like_a_checkpoint_does_not_stop_the_rotation(tmp_path):
    (tmp_path / "ckpt-000001.h5").mkdir()
    for number in (2, 3, 4):
        write(tmp_path, number)
    rotate(tmp_path, 2)
    assert [number for number, _ in list_checkpoints(tmp_path)] == [4, 3, 1]
