"""summary.json: strict JSON that appears whole or not at all."""

import json
import os
from pathlib import Path

import numpy as np
import pytest

from pdfem_mpi.results.summary_file import write_summary


def refuse(constant):
    raise AssertionError(f"{constant} is not JSON")


def read(path):
    return json.loads(path.read_text(encoding="utf-8"), parse_constant=refuse)


@pytest.fixture
def path(tmp_path):
    return tmp_path / "summary.json"


@pytest.mark.parametrize("unknown", [float("nan"), float("inf"), -np.inf, np.float64("nan"), np.float32("inf"), None])
def test_unknown_numbers_become_null_at_any_depth(path, unknown):
    write_summary(path, {"a": unknown, "b": [1.0, {"c": (unknown, 2.0)}], "d": np.array([unknown, 3.0], float)})
    assert read(path) == {"a": None, "b": [1.0, {"c": [None, 2.0]}], "d": [None, 3.0]}


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        (np.int64(2**60), 2**60),
        (np.float64(1 / 3), 1 / 3),
        (np.bool_(True), True),
        (np.arange(4).reshape(2, 2), [[0, 1], [2, 3]]),
        (np.array(2.5), 2.5),
        ((1, (2, "three")), [1, [2, "three"]]),
        ({1: "a", np.int32(2): "b"}, {"1": "a", "2": "b"}),
        (Path("runs/plate"), "runs/plate"),
        ("Größe", "Größe"),
    ],
)
def test_values_are_converted(path, value, expected):
    write_summary(path, {"value": value})
    result = read(path)["value"]
    assert result == expected
    assert type(result) is type(expected)


def test_keys_keep_their_order(path):
    write_summary(path, {"z": 1, "a": {"y": 1, "b": 2}, "m": 3})
    assert list(read(path)) == ["z", "a", "m"]
    assert list(read(path)["a"]) == ["y", "b"]


@pytest.mark.parametrize("failing", ["content", "replace", "fsync"])
def test_a_failure_leaves_the_older_file_and_nothing_else(path, monkeypatch, failing):
    write_summary(path, {"status": "running"})
    content = {"status": object()} if failing == "content" else {"status": "finished"}

    def fail(*_):
        raise OSError("No space left on device")

    with monkeypatch.context() as patch:
        if failing != "content":
            patch.setattr(os, failing, fail)
        with pytest.raises((TypeError, OSError)):
            write_summary(path, content)
    assert read(path) == {"status": "running"}
    assert list(path.parent.iterdir()) == [path]


def test_the_file_is_on_the_disk_before_it_gets_its_name(path, monkeypatch):
    calls = []
    for name in ("fsync", "replace"):
        original = getattr(os, name)
        monkeypatch.setattr(os, name, lambda *a, n=name, o=original: (calls.append(n), o(*a))[1])
    write_summary(path, {"status": "finished"})
    assert calls == ["fsync", "replace", "fsync"]  # the file, its name, the folder
