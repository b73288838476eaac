"""Hard cases: each is solved within the stated error, or refused by name. What is too long by default is slow.

Whole cases are told in the report of the tests, from which `tools/studies/hard_cases` makes docs/hard_cases.md.
"""

import functools

import pytest
from hard.cases import CASES, NAMED
from hard.running import judged, outcome_of, record

from pdfem_mpi.parallel.comm import mpi

BRIEF = [case for case in CASES if case.short is not None]
LONG = [case for case in CASES if case.short != ()]


@pytest.fixture(scope="module")
def compared_with(tmp_path_factory):
    """The outcomes of cases that others are compared with, each run once."""

    @functools.cache
    def outcome(name, short):
        return outcome_of(NAMED[name], mpi().COMM_SELF, tmp_path_factory.mktemp("against") / "run", short)[1]

    return outcome


def check(case, folder, compared_with, short, record_property):
    """Run, judge, and tell of a whole case."""
    others = {"against": compared_with(case.against, short)} if case.against else {}
    finding, told = judged(case, mpi().COMM_SELF, folder / "case", others, short)
    if not (short and case.short):
        record(record_property, told | {"number": CASES.index(case)})
    assert finding.holds, f"{finding.got} (error {finding.error}); expected: {case.expected}"


@pytest.mark.parametrize("case", BRIEF, ids=lambda case: case.title)
def test_case_is_solved_or_refused_by_name(case, tmp_path, compared_with, record_property):
    check(case, tmp_path, compared_with, True, record_property)


@pytest.mark.slow
@pytest.mark.parametrize("case", LONG, ids=lambda case: case.title)
def test_whole_case_is_solved_or_refused_by_name(case, tmp_path, compared_with, record_property):
    check(case, tmp_path, compared_with, False, record_property)


def test_every_family_has_a_case_and_names_are_unique():
    """Twenty-two families; a result is found by its name."""
    assert {case.family for case in CASES} == set(range(1, 23))
    assert len(NAMED) == len(CASES)
    assert all(not case.against or case.against in NAMED for case in CASES)
