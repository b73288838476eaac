"""Hard cases in short form: each is solved within the stated error, or refused by name; tools/hard_cases runs all."""

import functools
import sys
from unittest.mock import patch

import pytest

from helpers import ROOT
from pdfem_mpi.deck.scene import SceneError
from pdfem_mpi.deck.toml import DeckError
from pdfem_mpi.parallel.comm import mpi
from pdfem_mpi.run.run import run

sys.path.insert(0, str(ROOT / "tools"))

from hard_checks import run_check
from hard_suite import BAD_DECK, FAMILIES, Outcome, deck_text, read_outcome, read_scene
from hard_table import CASES

SHORT = [case for case in CASES if case.short is not None]
NAMED = {case.name: case for case in CASES}


class Listener:
    """A reporter that keeps what is said."""

    def __init__(self):
        self.said = []

    def line(self, text):
        """Keep a line."""
        self.said.append(text)

    def progress(self, *arguments):
        """Say nothing."""

    def row(self, columns):
        """Say nothing."""

    def table(self, title, rows):
        """Say nothing."""


def outcome_of(case, folder, short=True):
    """Run the short form of a case on this rank alone."""
    listener, comm = Listener(), mpi().COMM_SELF
    try:
        scene = read_scene(case, short)
        scene = scene.model_copy(update={"output": scene.output.model_copy(update={"figures": False})})
        if case.program != "run":
            run_check(case.program, scene, comm, folder)
            return scene, read_outcome(folder, 0, "")
        # warm_up would close the kernels to a second run in the same process; the user's cache knows earlier fits
        with patch("pdfem_mpi.run.run.warm_up"), patch("pdfem_mpi.run.run.fit_folders", lambda out: (out,)):
            code = run(scene, comm, folder, deck_text(case), True, listener)
    except (DeckError, SceneError) as error:
        return None, Outcome(BAD_DECK, "\n".join(error.messages))
    return scene, read_outcome(folder, code, "\n".join(listener.said))


@pytest.fixture(scope="module")
def compared_with(tmp_path_factory):
    """The outcomes of cases that others are compared with, each run once."""

    @functools.cache
    def outcome(name):
        return outcome_of(NAMED[name], tmp_path_factory.mktemp("against") / "run")[1]

    return outcome


@pytest.mark.parametrize("case", SHORT, ids=lambda case: f"{case.family}: {case.name}")
def test_case_is_solved_or_refused_by_name(case, tmp_path, compared_with):
    others = {"against": compared_with(case.against)} if case.against else {}
    scene, outcome = outcome_of(case, tmp_path / "case")
    finding = case.judge(case, scene, outcome, others)
    assert finding.holds, f"{finding.got} (error {finding.error}); expected: {case.expected}"


def test_every_family_has_a_case_and_names_are_unique():
    """Twenty families; a stored result is found by its name."""
    assert {case.family for case in CASES} == set(FAMILIES) == set(range(1, 21))
    assert len(NAMED) == len(CASES)
    assert all(not case.against or case.against in NAMED for case in CASES)
