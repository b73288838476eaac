"""A deck at cells h, h/2, h/4: which members there are, and what the results come to."""

import pytest

from pdfem_mpi.command.study import StudyError, describe_refinement, make_members, parse_axes, refinement, vary_cells
from pdfem_mpi.command.study.outcomes import Outcome
from pdfem_mpi.command.study.refinement import limit_of
from support.helpers import ROOT

DECK = ROOT / "jobs" / "bar_pd.toml"


@pytest.mark.parametrize("order", [1.0, 2.0])
def test_results_of_one_order_are_extrapolated(order):
    """f + c h^p at three levels gives f, and p; the uncertainty covers the correction."""
    values = [7.0 + 0.3 * h**order for h in (1.0, 0.5, 0.25)]
    limit = limit_of(values)
    assert limit.value == pytest.approx(7.0, rel=1e-12)
    assert limit.order == pytest.approx(order, rel=1e-9)
    assert limit.uncertainty == pytest.approx(1.25 * 0.3 * 0.25**order, rel=1e-9)


@pytest.mark.parametrize("values", [[1.0, 1.1, 1.0], [1.0, 1.1, 1.3], [2.0, 2.1], [3.0, 3.0, 3.0]])
def test_results_without_an_order_stand(values):
    """Those that go up and down, or away: the finest, with three times the spread."""
    limit = limit_of(values)
    assert limit.order is None and limit.value == values[-1]
    assert limit.uncertainty == pytest.approx(3.0 * (max(values) - min(values)))


def test_levels_halve_the_cells():
    text, left = vary_cells(DECK, 3, ["mesh.spacing=0.2", "output.figures=false"])
    assert text == "mesh.spacing=0.2,0.1,0.05" and left == ["output.figures=false"]
    assert len(make_members(DECK, parse_axes([text]))) == 3


@pytest.mark.parametrize("levels", [1, 6])
def test_too_few_or_too_many_levels_are_refused(levels):
    with pytest.raises(StudyError, match="must be 2 to 5 levels"):
        vary_cells(DECK, levels, [])


def test_cells_of_a_file_are_refused():
    with pytest.raises(StudyError, match="has its cells in a file"):
        vary_cells(ROOT / "jobs" / "plate_fe_gmsh.toml", 3, [])


def test_each_level_and_the_limits_are_told(monkeypatch, tmp_path):
    """Peaks first, then probes; sweeps, seconds and memory of each level; nothing while a level is missing."""
    members = make_members(DECK, parse_axes([vary_cells(DECK, 3, ["mesh.spacing=0.2"])[0]]))

    def outcome(folder, member):
        h = member.scene.mesh.spacing
        summary = {
            "failure": {"peak": {"load": 10.0 + h}, "first_break": {"load": 5.0}},
            "probes": {"end_displacement": 1.0 + h**2},
            "solve": {"evaluations": int(100 / h)},
            "seconds": {"total": 1.0},
            "memory": {"peak_bytes_per_rank": [2**20]},
        }
        return Outcome("finished", 0, "", summary)

    monkeypatch.setattr(refinement, "outcome_in", outcome)
    lines = list(describe_refinement(members, tmp_path))
    assert (
        lines[0] == "mesh.spacing=0.2, peak 10.2, first break 5, end displacement 1.04, 500 sweeps, 1.0 s, 1 MiB a rank"
    )
    assert lines[3].startswith("peak 10 +- ") and lines[3].endswith("of order 1")
    assert lines[4].startswith("first break 5 +- 0") and "no order" in lines[4]
    assert lines[5].startswith("end displacement 1 +- ") and lines[5].endswith("of order 2")
    monkeypatch.setattr(refinement, "outcome_in", lambda folder, member: Outcome())
    (line,) = describe_refinement(members, tmp_path)
    assert "has not finished" in line
