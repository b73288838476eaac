"""The study of the paper: the coarse set from decks to docs/paper.md, and what the document refers to."""

import dataclasses
import json
import re

import matplotlib.image
import pytest

from pdfem_mpi.command.study import figure, make_members, parse_axes, run_study
from pdfem_mpi.parallel.comm import mpi
from pdfem_mpi.runs.run import run
from support import paper_numbers
from support.helpers import ROOT
from support.reporters import Silence
from tools.studies import members as members_module
from tools.studies.members import run_of, run_series
from tools.studies.paper import drawings, report
from tools.studies.paper.cases import make_series

FIGURES = [*map(str, range(1, 17)), "A1", "A2", "A3", "B1", "B2", "B3", "B4", "B5"]
EQUATIONS = [*map(str, range(1, 36)), *(f"A{n}" for n in range(1, 13)), *(f"B{n}" for n in range(1, 6))]
PICTURES = re.findall(r"\(\{figures\}/(.*)\)", report.TEMPLATE.read_text(encoding="utf-8"))


def rows(section):
    """Rows of the template's table below a heading, as cells."""
    text = report.TEMPLATE.read_text(encoding="utf-8").split(f"## {section}\n")[1].split("\n## ")[0]
    return [cells for cells in map(report.cells_of, text.splitlines()) if cells][1:]


def test_every_figure_and_equation_of_the_paper_has_a_row():
    assert set(FIGURES) <= {cells[0] for cells in rows("Figures")}
    assert [cells[0] for cells in rows("Equations")] == EQUATIONS


def test_rows_name_code_and_tests_that_exist():
    """A function or test that is renamed has to be renamed in the rows."""
    for cells in rows("Equations"):
        for place in re.findall(r"`([^`]+:[^`]+)`", cells[2]):
            file, name = place.split(":")
            source = (ROOT / "pdfem_mpi" / file).read_text(encoding="utf-8")
            assert re.search(rf"^((def|class) {name}\b|{name} = )", source, re.MULTILINE), place
    tests = [test for cells in rows("Figures") for test in re.findall(r"`(\S+\.py)` `(\w+)`", cells[6])]
    tests += [test for cells in rows("Equations") for test in re.findall(r"`(\S+\.py)` `(\w+)`", cells[3])]
    assert len(tests) > len(EQUATIONS)
    for file, name in tests:
        assert f"def {name}(" in (ROOT / "tests" / file).read_text(encoding="utf-8"), (file, name)
    decks = set(re.findall(r"jobs/(\w+\.toml)", " ".join(" ".join(cells) for cells in rows("Figures"))))
    assert decks and all((ROOT / "jobs" / deck).exists() for deck in decks)


def here(member, folder, overwrite):
    """Run a member in this process."""
    return run(member.scene, mpi().COMM_SELF, folder, member.text, overwrite, Silence()), ""


def test_coarse_set_from_decks_to_the_document(tmp_path, monkeypatch, capsys):
    """All series, all figures, no number left out; then the same again, for which nothing has to be run."""
    monkeypatch.setattr(drawings, "DPI", 50)  # texts take most of the time
    monkeypatch.setattr(drawings, "LAYOUT", "none")
    monkeypatch.setattr(figure, "draw_study", lambda *rest: None)
    measured = json.loads(json.dumps(paper_numbers.paper_numbers(full=False)))
    series = make_series(full=False)
    runs = tmp_path / "runs"
    for item in series:
        axes = parse_axes(item.vary)
        members = make_members(ROOT / "jobs" / item.deck, axes, item.overrides)
        assert run_study(members, axes, runs / item.name, here, lambda text: None) == 0, item.name
    report.write_report(tmp_path / "paper.md", tmp_path / "figures", series, runs, measured, full=False)
    assert report.unfinished(series, runs) == []
    text = (tmp_path / "paper.md").read_text(encoding="utf-8")
    assert "not run" not in text and "{" not in text
    assert len(text.splitlines()) == len(report.TEMPLATE.read_text(encoding="utf-8").splitlines()) + 4  # a table
    for name in PICTURES:
        assert f"(figures/{name})" in text
        picture = matplotlib.image.imread(tmp_path / "figures" / name)
        assert picture[:, :, :3].std() > 0.05, f"{name} is blank"

    monkeypatch.setattr(members_module.subprocess, "run", lambda *command: pytest.fail("a member was run again"))
    for item in series:
        assert run_series(item, runs / item.name, 1, False) == 0
        changed = dataclasses.replace(item, overrides=(*item.overrides, "title=another"))
        assert not any(run_of(member, runs / item.name) for member in changed.members())


def test_what_has_not_run_is_told(tmp_path):
    """A document without runs says so, row by row, and the command that some series are missing."""
    series = make_series(full=False)
    report.write_report(tmp_path / "paper.md", tmp_path / "figures", series, tmp_path / "runs", {}, full=False)
    missing = report.unfinished(series, tmp_path / "runs")
    assert missing == [f"series {item.name} has no finished run" for item in series]
    text = (tmp_path / "paper.md").read_text(encoding="utf-8")
    assert text.count("not run") > 10 and "![" not in text


def test_full_set_keeps_to_the_paper():
    """Full size: no deck's mesh is made coarser, and every deck of the series is sound."""
    for item in make_series(full=True):
        assert not any("spacing" in text for text in item.overrides)
        assert item.members()
