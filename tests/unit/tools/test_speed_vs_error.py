"""The chart of speed against error: its cases, its reference, its rows, a peer that is missing, and the page."""

import pytest

import pdfem_mpi
from support.helpers import ROOT
from tools.studies.series import JOBS, Results
from tools.studies.speed_vs_error import study
from tools.studies.speed_vs_error.cases import ALL, BOX, DECK, FOUND, SOFT, THIRD, cases, plate_cases

PEER = "elements of 10: 809 in all, peak 2,648 N at 0.180 mm, rms 2.9 %, 3.4 s of a processor, 31 MiB\n"
PLATE_PEER = (
    "cells of 0.2: 5,216 points, first break 4,100 lbf, peak 4,300 lbf, 3,800 steps, 57.5 s of a processor, 150 MiB\n"
)


def row(peak, spacing=10.0, group=SOFT, setting=""):
    return study.Row(group, spacing, setting, 1000.0, peak, 100, 3.0, 250.0)


def test_every_case_is_a_deck():
    found = cases(fine=True)
    assert len({case.name for case in found}) == len(found)
    for case in found:
        scene = pdfem_mpi.read_deck(JOBS / DECK, [f"{key}={value}" for key, value in case.overrides().items()])
        assert scene.mesh.upper[2] == scene.mesh.spacing == case.spacing and "z+" in scene.mesh.symmetry
        assert scene.softens != ("brittle" in case.group)


def test_every_case_of_the_plate_is_a_deck():
    found = plate_cases()
    assert len({case.name for case in found}) == len(found)
    for case in found:
        scene = pdfem_mpi.read_deck(JOBS / case.deck, [f"{key}={value}" for key, value in case.overrides().items()])
        assert scene.mesh.spacing == case.spacing and len(scene.mesh.symmetry) == (3 if case.scale == 4.0 else 0)
        assert (scene.regions[0].model == "auto") == (case.group == FOUND)
        assert case.name.isascii() and not set(case.name) & set("/\"' ")


def test_the_plate_is_held_to_bonds_everywhere_in_the_same_cells():
    everywhere, third = row(200.0, 0.1, ALL), row(100.0, 0.1, ALL, THIRD)
    rows = [everywhere, third, row(202.0, 0.1, BOX), row(101.0, 0.1, BOX, THIRD), row(198.0, 0.1, BOX, "appendix A")]
    errors = study.plate_errors([*rows, row(5.0, 0.05, BOX)])
    assert [errors[one][1] for one in rows] == pytest.approx([0.0, 0.0, 1.0, 1.0, -1.0]) and len(errors) == len(rows)
    lines = study.plate_table(rows)
    assert "| 0 | 200 | 0 |" in lines[2] and "| +1.00 |" in lines[4] and "| -1.00 |" in lines[6]
    assert [mark.error for mark in study.marks_of_plate(rows)][2:] == pytest.approx([1.0, 1.0, -1.0])


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
    rows = [row(limit := 90.0 + h**2, h, study.BEAM_PEER.group) for h in (2.0, 1.0)]
    assert study.reference([*rows, row(500.0)]) == pytest.approx((90.0, 1.0)) and limit == 91.0


def test_rows_tell_the_error():
    lines = study.rows_table([row(103.0, setting="eta 1e-2"), row(97.0, group="others")], 100.0)
    assert lines[2].startswith(f"| {SOFT}, eta 1e-2 | 10 | 1,000 | 103 | +3.0 |") and "| -3.0 |" in lines[3]


def test_a_peer_is_read_and_one_that_is_missing_is_said(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(study, "FOLDER", tmp_path)
    assert study.peer_rows(study.BEAM_PEER) == [] and "no rows of OOFEM" in capsys.readouterr().out
    (tmp_path / "oofem.txt").write_text(PEER)
    (found,) = study.peer_rows(study.BEAM_PEER)
    assert (found.spacing, found.peak, found.seconds, found.memory) == (10.0, 2648.0, 3.4, 31.0)
    (tmp_path / "lammps.txt").write_text(PLATE_PEER)
    (found,) = study.peer_rows(study.PLATE_PEER)
    assert (found.spacing, found.first, found.peak, found.sweeps) == (0.2, 4100.0, 4300.0, 3800)


def test_the_study_draws_what_there_is(tmp_path, monkeypatch):
    page = tmp_path / "page.md"
    page.write_text("<!-- rows: x -->\n<!-- end of rows -->\n<!-- plate: x -->\n<!-- end of plate -->\n")
    for name, value in (("DOCUMENT", page), ("FIGURES", tmp_path), ("FOLDER", tmp_path)):
        monkeypatch.setattr(study, name, value)
    monkeypatch.setattr(study, "COSTS", Results(tmp_path / "costs"))
    monkeypatch.setattr(study, "row_of", lambda case: row(100.0 + case.spacing, case.spacing, case.group, case.setting))
    assert study.main(["--report"]) == 0
    assert "| +10.0 |" in page.read_text() and page.read_text().count(f"| {ALL}") == 5
    for name in ("speed_vs_error", "speed_vs_error_plate"):
        assert (tmp_path / f"{name}.svg").stat().st_size > 10_000


def test_the_page_is_one_page_of_the_study():
    page = (ROOT / "docs" / "speed_vs_error.md").read_text(encoding="utf-8")
    for name, figure in (("rows", "speed_vs_error"), ("plate", "speed_vs_error_plate")):
        assert f"<!-- {name}: tools/studies/study speed_vs_error -->" in page and f"figures/{figure}.svg" in page
    assert len(" ".join(line for line in page.splitlines() if not line.startswith("|")).split()) < 750
