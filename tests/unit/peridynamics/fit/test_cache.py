"""Fits on disk: what was stored comes back, and damaged files count as none."""

import os

import numpy as np
import pytest

from pdfem_mpi.peridynamics.fit import cache as factor_cache

REPORT = {"residual": 1.5e-10, "signs": "free"}
KEY = "0123456789abcdef" * 4


@pytest.fixture
def stored(tmp_path):
    """A fit in a folder, its arrays, and its file."""
    arrays = np.random.default_rng(1).standard_normal((3, 5, 8, 10))
    factor_cache.store((tmp_path / "a",), KEY, REPORT, arrays)
    (path,) = (tmp_path / "a").iterdir()
    return tmp_path / "a", arrays, path


def test_what_was_stored_comes_back_to_the_bit(stored):
    folder, arrays, _ = stored
    report, found = factor_cache.load((folder.parent / "none", folder), KEY)
    assert report == REPORT
    assert all((a == b).all() for a, b in zip(arrays, found, strict=True))


def test_another_fit_is_none(stored):
    assert factor_cache.load((stored[0],), KEY[::-1]) is None


@pytest.mark.parametrize("damage", ["truncated", "empty", "flipped"])
def test_a_damaged_file_is_none(stored, damage):
    folder, _, path = stored
    content = bytearray(path.read_bytes())
    if damage == "flipped":
        content[len(content) // 2] ^= 16
    path.write_bytes(bytes(content[: {"truncated": 1000, "empty": 0}.get(damage)]))
    assert factor_cache.load((folder,), KEY) is None


def test_a_folder_that_cannot_be_written_is_no_error(tmp_path, stored):
    _, arrays, _ = stored
    in_the_way = tmp_path / "file"
    in_the_way.write_text("")
    factor_cache.store((in_the_way, tmp_path / "b"), KEY, REPORT, arrays)
    assert factor_cache.load((tmp_path / "b",), KEY) is not None


def test_the_oldest_fits_go_when_a_folder_is_full(tmp_path, monkeypatch):
    arrays = np.zeros((1, 4, 8, 10))
    monkeypatch.setattr(factor_cache, "MOST_BYTES", 10_000)
    keys = [letter * 64 for letter in "abcdef"]
    for age, key in enumerate(keys):
        factor_cache.store((tmp_path,), key, REPORT, arrays)
        for path in tmp_path.glob(f"*{key[:4]}*"):
            os.utime(path, (1000 + age, 1000 + age))
    kept = [factor_cache.load((tmp_path,), key) is not None for key in keys]
    assert kept[-1]
    assert not kept[0]
    assert sum(path.stat().st_size for path in tmp_path.iterdir()) <= 10_000
