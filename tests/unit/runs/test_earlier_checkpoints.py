"""A run folder of an earlier version, kept as it was written, is gone on with, or refused with what changed.

`tests/data/run_before_may_fail` is a failing strip of elements and bonds, stopped after eleven rows, of a version
in which `may_fail` was true by default, also for bonds between two points of the overlap.
"""

import json
import shutil

import pytest

from pdfem_mpi.deck.toml import read_deck
from support.helpers import ROOT
from support.reporters import Listener
from support.restarts import alone

KEPT = ROOT / "tests" / "data" / "run_before_may_fail"
ROWS = 11  # that the earlier version wrote


@pytest.fixture
def folder(tmp_path):
    """A copy that may be gone on with."""
    return shutil.copytree(KEPT, tmp_path / "run")


def test_a_run_of_an_earlier_version_is_gone_on_with(folder):
    """By its own deck, which has every default of then: bonds in the overlap go on to break, and the run warns."""
    before = (folder / "history.csv").read_text().splitlines()
    reporter = Listener()
    assert alone(read_deck(folder / "deck.toml"), folder, reporter=reporter) == 0
    after = (folder / "history.csv").read_text().splitlines()
    assert after[: ROWS + 1] == before and len(after) > len(before)
    assert json.loads((folder / "summary.json").read_text())["status"] == "finished"
    assert any("regions.0.may_fail = true lets bonds" in text for text in reporter.lines)
    assert any("another version of pdfem_mpi's source" in text for text in reporter.lines)


def test_a_deck_that_now_says_something_else_is_refused(folder):
    """Only the region of elements: for that of bonds the key left out means what it did."""
    scene = read_deck(folder / "deck.toml")
    unset = tuple(region.model_copy(update={"may_fail": None}) for region in scene.regions)
    reporter = Listener()
    assert alone(scene.model_copy(update={"regions": unset}), folder, reporter=reporter) == 65
    (refusal,) = [text for text in reporter.lines if "another scene" in text]
    assert "regions.0.may_fail was true, the deck has nothing" in refusal
    assert "bonds between two points of the overlap no longer break unless the deck says so" in refusal
    assert "set regions.0.may_fail = true to go on as before" in refusal
    assert "regions.1" not in refusal
