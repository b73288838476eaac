"""tools/figures: the coarse set from decks to docs/paper.md, and what the document refers to."""

import re
import sys
from unittest.mock import patch

import matplotlib.image
import pytest

from pdfem_mpi.command import study
from pdfem_mpi.parallel.comm import mpi
from pdfem_mpi.run.run import run
from support import measure
from support import patch as patches
from support.helpers import ROOT
from support.reporters import Silence

FIGURES = [*map(str, range(1, 17)), "A1", "A2", "A3", "B1", "B2", "B3", "B4", "B5"]
EQUATIONS = [*map(str, range(1, 36)), *(f"A{n}" for n in range(1, 13)), *(f"B{n}" for n in range(1, 6))]


@pytest.fixture(scope="module")
def tools():
    """The modules of tools/figures, importable as they are for the script."""
    sys.path.insert(0, str(ROOT / "tools"))
    try:
        import paper_cases
        import paper_figures
        import paper_report
        import paper_rows

        yield {"cases": paper_cases, "figures": paper_figures, "report": paper_report, "rows": paper_rows}
    finally:
        sys.path.remove(str(ROOT / "tools"))


def test_every_figure_and_equation_of_the_paper_has_a_row(tools):
    rows = tools["rows"]
    assert set(FIGURES) <= {row.figure for row in rows.FIGURES}
    assert [row.equation for row in rows.EQUATIONS] == EQUATIONS


def test_rows_name_code_and_tests_that_exist(tools):
    """A function or test that is renamed has to be renamed in the rows."""
    rows = tools["rows"]
    for row in rows.EQUATIONS:
        for place in row.code:
            file, name = place.split(":")
            source = (ROOT / "pdfem_mpi" / file).read_text(encoding="utf-8")
            assert re.search(rf"^((def|class) {name}\b|{name} = )", source, re.MULTILINE), place
    for test in (test for row in (*rows.FIGURES, *rows.EQUATIONS) for test in row.tests):
        file, name = test.split("::")
        assert f"def {name}(" in (ROOT / "tests" / file).read_text(encoding="utf-8"), test
    decks = set(re.findall(r"jobs/(\w+\.toml)", " ".join(" ".join(row[:6]) for row in rows.FIGURES)))
    assert decks and all((ROOT / "jobs" / deck).exists() for deck in decks)


def here(member, folder, overwrite):
    """Run a member in this process."""
    with patch("pdfem_mpi.run.run.warm_up"):  # it closes the kernels to a second run in the same process
        return run(member.scene, mpi().COMM_SELF, folder, member.text, overwrite, Silence()), ""


def test_coarse_set_from_decks_to_the_document(tools, tmp_path, monkeypatch, capsys):
    """All series, all figures, no number left out; then the same again, for which nothing has to be run."""
    for module, name, value in (
        (tools["figures"], "DPI", 50), (tools["figures"], "LAYOUT", "none"), (study, "draw_study", lambda *rest: None),
        (measure, "POWER_ITERATIONS", 10),
    ):  # fmt: skip
        monkeypatch.setattr(module, name, value)  # what takes the time: texts and eigenvalues
    for name in ("coupled, reading A", "coupled, reading B"):
        monkeypatch.setitem(patches.BLOCKS, name, ((8, 6, 6), 4, patches.BLOCKS[name][2]))
    series = tools["cases"].make_series(full=False)
    runs = tmp_path / "runs"
    for item in series:
        assert tools["cases"].run_series(item, runs / item.name, 1, False, here) == 0, item.name
    tools["report"].write_report(tmp_path / "paper.md", tmp_path / "figures", series, runs, full=False)
    assert tools["report"].unfinished(series, runs) == []
    text = (tmp_path / "paper.md").read_text(encoding="utf-8")
    assert "not run" not in text and "{" not in text
    for name in tools["report"].CAPTIONS:
        assert f"(figures/{name})" in text
        picture = matplotlib.image.imread(tmp_path / "figures" / name)
        assert picture[:, :, :3].std() > 0.05, f"{name} is blank"

    def never(member, folder, overwrite):
        raise AssertionError(f"{member.label} was run again")

    for item in series:
        assert tools["cases"].run_series(item, runs / item.name, 1, False, never) == 0


def test_what_has_not_run_is_told(tools, tmp_path, monkeypatch):
    """A document without runs says so, row by row, and the command that some series are missing."""
    report = tools["report"]
    monkeypatch.setattr(report, "STEPS", tuple(step for step in report.STEPS if step[0]))
    series = tools["cases"].make_series(full=False)
    report.write_report(tmp_path / "paper.md", tmp_path / "figures", series, tmp_path / "runs", full=False)
    missing = report.unfinished(series, tmp_path / "runs")
    assert missing == [f"series {item.name} has no finished run" for item in series]
    assert (tmp_path / "paper.md").read_text(encoding="utf-8").count("not run") > 10


def test_full_set_keeps_to_the_paper(tools):
    """Full size: no deck's mesh is made coarser, and every deck of the series is sound."""
    for item in tools["cases"].make_series(full=True):
        assert not any("spacing" in text for text in item.overrides)
        assert item.members()[1]
