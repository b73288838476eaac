"""What all studies share: kept results, tables between markers, and what reports of tests tell; and their pages."""

import json
from xml.sax.saxutils import quoteattr

import pytest

from pdfem_mpi import read_deck
from pdfem_mpi.runs.memory_report import PARTS
from support.helpers import ROOT, run_python
from tools.studies import series
from tools.studies.failure import study as failure
from tools.studies.failure_criterion import study as failure_criterion
from tools.studies.hard_cases import study as hard_cases
from tools.studies.memory import study as memory
from tools.studies.softening import bodies as softening_bodies
from tools.studies.speed_vs_error import study as speed_vs_error

MARKED = "before\n<!-- one: a script -->\nold\n<!-- end of one -->\n<!-- two: a script -->\n<!-- end of two -->\n"


def test_a_result_is_found_by_its_identity(tmp_path):
    results = series.Results(tmp_path / "kept")
    assert results.read("case", 1) is None
    results.write("case", [1, "a"], {"sweeps": 3})
    assert results.read("case", [1, "a"])["sweeps"] == results.read("case")["sweeps"] == 3
    assert results.read("case", [2, "a"]) is None
    (tmp_path / "kept" / "case.json").write_text('{"identity": [1')  # torn
    assert results.read("case") is None
    assert [path.name for path in (tmp_path / "kept").iterdir()] == ["case.json"]


def test_tables_are_written_between_their_markers_again_and_again(tmp_path):
    document = tmp_path / "page.md"
    document.write_text(MARKED)
    for _ in range(2):
        series.fill(document, {"two": ["| b |"], "one": series.table(["x", "y"], [["1", "2"]])})
    expected = MARKED.replace("old", "| x | y |\n|---|---|\n| 1 | 2 |")
    assert document.read_text() == expected.replace("-->\n<!-- end of two", "-->\n| b |\n<!-- end of two")


def test_a_document_without_markers_is_left_alone(tmp_path):
    document = tmp_path / "page.md"
    document.write_text("nothing\n")
    with pytest.raises(SystemExit, match="the markers of one are missing"):
        series.fill(document, {"one": []})
    assert document.read_text() == "nothing\n"


def test_rows_have_as_many_cells_as_there_are_headings():
    with pytest.raises(ValueError, match="a row of 1 cells under 2 headings"):
        series.table(["x", "y"], [["1"]])


@pytest.mark.parametrize("name", ["failure", "failure_criterion", "softening", "memory"])
def test_documents_have_the_markers_of_their_studies(name):
    page = {"memory": "needs", "failure_criterion": "failure", "softening": "failure"}.get(name, name)
    document = (ROOT / "docs" / page).with_suffix(".md").read_text(encoding="utf-8")
    assert f": tools/studies/study {name} -->" in document and "tools/studies/study" in document
    for section in (section[0] for section in failure.SECTIONS) if name == "failure" else ():
        assert f"<!-- {section}: " in document and f"<!-- end of {section} -->" in document


def report(path, *cases):
    """A report of tests: (passed, property) each."""
    text = "".join(
        f'<testcase name="t"><properties><property name="hard case" value={quoteattr(json.dumps(told))}/>'
        f"</properties>{'' if passed else '<failure/>'}</testcase>"
        for passed, told in cases
    )
    path.write_text(f"<testsuites><testsuite>{text}<testcase name='other'/></testsuite></testsuites>")


def test_properties_of_a_report(tmp_path):
    report(tmp_path / "r.xml", (True, {"a": "1 < 2"}), (False, [3]))
    assert series.properties_of(tmp_path / "r.xml", "hard case") == [(True, {"a": "1 < 2"}), (False, [3])]
    assert series.properties_of(tmp_path / "r.xml", "paper") == series.properties_of(tmp_path / "none.xml", "x") == []


def test_page_of_the_hard_cases_from_reports(tmp_path, monkeypatch):
    """Verdicts of the tests, ranks on which bits differ, and cases that did not run on all their ranks."""
    monkeypatch.setattr(hard_cases, "FOLDER", tmp_path)
    told = {"family": 3, "case": "b", "expected": "e", "got": "x | y", "error": 1e-9, "evaluations": 1234}
    told |= {"seconds": 1.23, "verdict": "solved", "ranks": [1, 2], "number": 1}
    refused = told | {"case": "a", "error": None, "evaluations": None, "verdict": "refused", "number": 0}
    many = told | {"case": "c", "ranks": [1, 2, 8], "number": 2}
    report(tmp_path / "ranks-1.xml", (True, told), (True, refused), (False, many))
    ranks = [{"case": name, "ranks": [1, 2], "differing": []} for name in "abc"]
    ranks[1]["differing"] = [2]
    report(tmp_path / "ranks-2.xml", *((not told["differing"], told) for told in ranks))
    page = hard_cases.page(hard_cases.collect())
    assert "0 cases solved, 1 refused by name, 2 failed. Not run on all numbers of ranks: c." in page
    rows = [line for line in page.splitlines() if line.endswith((" FAILED |", " refused |", " solved |"))]
    assert rows == [
        "| a | e | x / y | - | - | 1.2 | refused |",
        "| b | e | x / y; other bits on 2 ranks | 1.0e-09 | 1,234 | 1.2 | FAILED |",
        "| c (1 to 8 ranks) | e | x / y | 1.0e-09 | 1,234 | 1.2 | FAILED |",
    ]


def test_the_page_of_the_hard_cases_begins_as_its_study_says():
    """Words are changed in the study, of which a new page is made, or the next run would undo them."""
    assert (ROOT / "docs" / "hard_cases.md").read_text(encoding="utf-8").startswith(hard_cases.HEAD)


def test_a_case_of_the_failure_study_without_a_run_is_marked(tmp_path, monkeypatch):
    monkeypatch.setattr(failure, "RESULTS", series.Results(tmp_path))
    lines = failure.section(*failure.SECTIONS[0])
    assert len(lines) == 2 + len(failure.SECTIONS[0][2])
    assert all("| not run here |" in line for line in lines[2:])


def test_sizes_of_the_memory_table():
    assert [memory.show(size) for size in (0, 1000, 2**20, 50 * 2**20)] == ["-", "< .1", "1.0", "50"]


def test_groups_of_the_memory_table_have_each_part_once():
    assert sorted(part for parts in memory.GROUPS.values() for part in parts) == sorted(PARTS)


def test_a_study_that_does_not_exist_is_refused_with_the_names_of_those_that_do():
    answer = run_python("tools/studies/study", "nothing")
    assert answer.returncode == 1 and "Traceback" not in answer.stderr
    names = "failure", "failure_criterion", "fitted", "hard_cases", "materials", "memory", "paper", "speed_vs_error"
    for name in names:
        assert name in answer.stderr


@pytest.mark.parametrize("body", softening_bodies.BODIES)
def test_decks_of_bodies_that_soften_are_decks(body, tmp_path):
    """Each with its mesh, of softening bonds and of brittle ones."""
    of = softening_bodies.BODIES[body]
    for keys in (set(of.material), {"youngs_modulus", "fracture_energy"}):
        path = tmp_path / "deck.toml"
        text = of.write(of.h, {key: of.material[key] for key in keys}, tmp_path)
        path.write_text(softening_bodies.with_length(text, of.h), encoding="utf-8")
        scene = read_deck(path)
        assert scene.softens == ("tensile_strength" in keys)
        assert scene.peridynamics.internal_length == of.h


@pytest.mark.parametrize("study", [failure, failure_criterion, speed_vs_error], ids=lambda study: study.__name__)
def test_dry_runs_list_what_is_left_and_write_nothing(study, capsys):
    before = {path: path.read_bytes() for path in (ROOT / "docs").glob("*.md")}
    assert study.main(["--dry-run"]) == 0
    assert before == {path: path.read_bytes() for path in (ROOT / "docs").glob("*.md")}


def test_a_report_fills_the_tables_of_criteria_once(monkeypatch):
    filled, drawn = [], []
    monkeypatch.setattr(failure_criterion, "fill", lambda *arguments: filled.append(arguments))
    monkeypatch.setattr(failure_criterion, "draw", lambda: drawn.append(1))
    assert failure_criterion.main(["--report"]) == 0
    assert len(filled) == len(drawn) == 1


def test_rows_without_a_new_one_are_kept(tmp_path):
    page = tmp_path / "page.md"
    old = series.table(["test", "model", "n"], [["a", "x", "1"], ["a", "y", "2"], ["b", "x", "3"]])
    page.write_text("<!-- one: script -->\n" + "\n".join(old) + "\n<!-- end of one -->\n")
    new = series.table(["test", "model", "n"], [["a", "x", "9"], ["a", "z", "4"], ["c", "x", "5"]])
    rows = series.kept(new, page, "one", 2)
    assert rows[2:] == ["| a | x | 9 |", "| a | y | 2 |", "| a | z | 4 |", "| b | x | 3 |", "| c | x | 5 |"]
    assert series.kept(new, page, "none", 2) == new
