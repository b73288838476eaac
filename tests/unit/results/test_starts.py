"""Every start of a run counts in its seconds and restarts; a start that does nothing says so."""

import json
import time

import pytest

from support.reporters import Listener
from support.restarts import StopAt, alone, in_child, often

FINISHED, STOPPED = 0, 75


def summary(out):
    return json.loads((out / "summary.json").read_text())


def test_all_starts_count_also_those_that_wrote_no_checkpoint(tmp_path):
    """The tables of the starts add up: two stop at the place of the checkpoint that they started from."""
    out, seconds = tmp_path / "run", []
    for stop in (30, 1, 1, 10**9):
        assert alone(often(), out, requests=StopAt(stop)) == (FINISHED if stop > 100 else STOPPED)
        seconds.append(summary(out)["seconds"]["total"])
        assert summary(out)["seconds_of_all_starts"] == pytest.approx(sum(seconds), rel=1e-12)  # sums of a few floats
    restarts = summary(out)["restarts"]
    assert len(restarts) == 3 and len({(entry["checkpoint"], entry["iteration"]) for entry in restarts}) == 1
    assert [entry["seconds_before"] for entry in restarts] == pytest.approx(
        [sum(seconds[:n]) for n in (1, 2, 3)], rel=1e-12
    )


def test_a_start_that_was_killed_counts_until_its_last_word(tmp_path):
    """Once before the first checkpoint and once after it; a run begun anew knows nothing of them."""
    out = tmp_path / "run"
    assert in_child(lambda: alone(often(), out), PDFEM_CRASH_AT="flush:1") == 99
    assert in_child(lambda: alone(often(), out), PDFEM_CRASH_AT="flush:3") == 99
    assert alone(often(), out) == FINISHED
    found = summary(out)
    assert [entry["checkpoint"] for entry in found["restarts"]] == [None, "ckpt-000002.h5"]
    assert 0.0 < found["restarts"][0]["seconds_before"] < found["restarts"][1]["seconds_before"]
    assert found["seconds_of_all_starts"] == pytest.approx(
        found["restarts"][1]["seconds_before"] + found["seconds"]["total"], rel=1e-12
    )
    assert alone(often(), out, overwrite=True) == FINISHED
    assert summary(out)["restarts"] == []
    assert summary(out)["seconds_of_all_starts"] == summary(out)["seconds"]["total"]


def test_less_time_than_start_up_takes_is_told_as_nothing_done(tmp_path):
    """The jobs of a chain that get nowhere count themselves; one that gets somewhere ends the count."""
    out = tmp_path / "run"
    for number in (1, 2, 3):
        reporter = Listener()
        assert alone(often(), out, reporter=reporter, end=time.monotonic()) == STOPPED
        reason = summary(out)["reason"]
        assert "Nothing was done. Start-up alone took" in reason and "allow more" in reason
        assert (f"start {number} in a row" in reason) == (number > 1)
        assert reporter.said("stopped: the time allowed by --max-hours", "Nothing was done")
    assert alone(often(), out, requests=StopAt(30)) == STOPPED
    assert "Nothing" not in summary(out)["reason"]
    assert alone(often(), out, end=time.monotonic()) == STOPPED
    assert "in a row" not in summary(out)["reason"]
