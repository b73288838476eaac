"""The chart of speed against error: its cases, its reference, its rows, a peer that is missing, and the page."""

import pytest

import pdfem_mpi
from support.helpers import ROOT
from tools.studies.series import JOBS, Results
from tools.studies.speed_vs_error import study
from tools.studies.speed_vs_error.cases import DECK, SOFT, cases

PEER = "elements of 10: 809 in all, peak 2,648 N at 0.180 mm, rms 2.9 %, 3.4 s of a processor, 31 MiB\n"


def row(peak, spacing=10.0, group=SOFT, setting=""):
    return study.Row(group, spacing, setting, 1000.0, peak, 100, 3.0, 250.0)


def test_every_case_is_a_deck():
    found = cases(fine=True)
    assert len({case.name for case in found}) == len(found)
    for case in found:
        scene = pdfem_mpi.read_deck(JOBS / DECK, [f"{key}={value}" for key, value in case.overrides().items()])
        assert scene.mesh.upper[2] == scene.mesh.spacing == case.spacing and "z+" in scene.mesh.symmetry
        assert scene.softens != ("brittle" in case.group)


@pytest.mark.parametrize(("order", "limit"), [(1, 100.0), (2, -7.0)])
def test_the_reference_is_the_limit_of_three_cells(order, limit):
    """Peaks with an error in a power of the cells have their limit exactly."""
    peaks = [limit + 3.0 * h**order for h in (4.0, 2.0, 1.0)]
    assert study.richardson(*peaks) == pytest.approx((limit, 3.0))


def test_differences_that_do_not_shrink_have_no_limit():
    assert study.richardson(1.0, 2.0, 4.0) == (4.0, 2.0)
    assert study.richardson(1.0, 2.0, 3.0) == (3.0, 1.0)
    assert study.richardson(2.0, 2.0, 2.0) == (2.0, 0.0)


def test_a_reference_needs_all_cells():
    assert study.reference([row(3.0), row(2.0, 5.0)]) is None
    limit, own = study.reference([row(104.0), row(102.0, 5.0), row(101.0, 2.5), row(9.0, 5.0, "others")])
    assert (limit, own) == pytest.approx((100.0, 1.0))


def test_a_peer_at_two_cells_gives_the_reference():
    rows = [row(limit := 90.0 + h**2, h, study.PEER_GROUP) for h in (2.0, 1.0)]
    assert study.reference([*rows, row(500.0)]) == pytest.approx((90.0, 1.0)) and limit == 91.0


def test_rows_tell_the_error():
    lines = study.rows_table([row(103.0, setting="eta 1e-2"), row(97.0, group="others")], 100.0)
    assert lines[2].startswith(f"| {SOFT}, eta 1e-2 | 10 | 1,000 | 103 | +3.0 |") and "| -3.0 |" in lines[3]


def test_a_peer_is_read_and_one_that_is_missing_is_said(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(study, "PEER", tmp_path / "oofem.txt")
    assert study.peer_rows() == [] and "no rows of OOFEM" in capsys.readouterr().out
    (tmp_path / "oofem.txt").write_text(PEER)
    (found,) = study.peer_rows()
    assert (found.spacing, found.peak, found.seconds, found.memory) == (10.0, 2648.0, 3.4, 31.0)


def test_the_study_draws_what_there_is(tmp_path, monkeypatch):
    page = tmp_path / "page.md"
    page.write_text("<!-- rows: x -->\n<!-- end of rows -->\n")
    for name, value in (("DOCUMENT", page), ("FIGURE", tmp_path / "figure.svg"), ("FOLDER", tmp_path)):
        monkeypatch.setattr(study, name, value)
    monkeypatch.setattr(study, "PEER", tmp_path / "none.txt")
    monkeypatch.setattr(study, "COSTS", Results(tmp_path / "costs"))
    monkeypatch.setattr(study, "row_of", lambda case: row(100.0 + case.spacing, case.spacing, case.group, case.setting))
    assert study.main(["--report"]) == 0
    assert "| +10.0 |" in page.read_text() and (tmp_path / "figure.svg").stat().st_size > 10_000


def test_the_page_is_one_page_of_the_study():
    page = (ROOT / "docs" / "speed_vs_error.md").read_text(encoding="utf-8")
    assert "<!-- rows: tools/studies/study speed_vs_error -->" in page and "figures/speed_vs_error.svg" in page
    assert len(page.split()) < 1200
