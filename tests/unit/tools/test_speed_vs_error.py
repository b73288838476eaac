"""The chart of speed against error: its Pareto front, its tables, and what it recommends."""

import json
from dataclasses import replace
from types import SimpleNamespace

import pytest

from pdfem_mpi.deck.toml import read_deck
from support.helpers import ROOT
from tools.studies.series import Results
from tools.studies.speed_vs_error import report, study
from tools.studies.speed_vs_error.cases import DECKS, Case, make_series, reference_case


def row(total, error, sweeps=1):
    return SimpleNamespace(total=total, error=error, sweeps=sweeps)


def solved(tolerance, solver_error, solver="cg"):
    return SimpleNamespace(case=SimpleNamespace(tolerance=tolerance, solver=solver), solver_error=solver_error)


@pytest.mark.parametrize(
    ("costs", "errors", "front"),
    [
        ([], [], []),
        ([3.0, 1.0, 2.0], [1.0, 9.0, 4.0], [1, 2, 0]),
        ([1.0, 2.0, 3.0], [1.0, 2.0, 3.0], [0]),
        ([1.0, 2.0, 3.0], [5.0, 5.0, 4.0], [0, 2]),
        ([1.0, 1.0, 1.0], [5.0, 3.0, 4.0], [1]),
        ([2.0, 2.0], [3.0, 3.0], [0]),
        ([1.0, 2.0, 3.0, 4.0], [None, 2.0, float("nan"), 1.0], [1, 3]),
        ([None, float("nan"), 2.0], [0.1, 0.1, 2.0], [2]),
    ],
    ids=["empty", "all, by cost", "one beats all", "equal errors", "equal costs", "twins", "no error", "no cost"],
)
def test_pareto_front(costs, errors, front):
    assert report.pareto_front(costs, errors) == front


def test_no_point_of_the_front_is_beaten_and_every_other_is():
    costs = [(7 * k) % 31 for k in range(60)]
    errors = [(11 * k) % 37 for k in range(60)]
    points = list(zip(costs, errors, strict=True))
    front = {points[i] for i in report.pareto_front(costs, errors)}

    def beaten(point):
        return any(other != point and other[0] <= point[0] and other[1] <= point[1] for other in points)

    assert front == {point for point in points if not beaten(point)}


def test_front_with_a_gain_leaves_out_what_is_dearer_and_hardly_better():
    costs, errors = [1.0, 2.0, 3.0, 4.0], [5.0, 4.96, 4.94, 1.0]
    assert report.pareto_front(costs, errors, 0.01) == [0, 2, 3]


def test_table_is_markdown_with_a_place_for_each_cell():
    text = report.table(["case", "error %"], [["|x| < 2", "4.85"], ["fe", None]])
    assert text.splitlines() == [
        "| case | error % |",
        "| --- | --- |",
        r"| \|x\| < 2 | 4.85 |",
        "| fe | - |",
    ]


def test_table_refuses_a_row_that_does_not_fit():
    with pytest.raises(ValueError, match="a row of 1 cells under 2 headings"):
        report.table(["case", "error %"], [["pd"]])


@pytest.mark.parametrize(("level", "index"), [(5.0, 1), (3.0, 2), (1.0, None)])
def test_cheapest_case_that_reaches_a_level(level, index):
    rows = [row(1.0, 6.0), row(2.0, 5.0), row(3.0, 3.0), row(4.0, 2.0), row(0.5, None)]
    assert report.cheapest(rows, level) is (None if index is None else rows[index])


def test_of_cases_as_cheap_the_more_accurate_then_that_of_fewer_sweeps():
    rows = [row(1.0, 4.0, 1), row(1.09, 3.001, 9), row(1.05, 3.0, 8), row(1.2, 1.0, 1), row(1.08, 3.002, 7)]
    assert report.cheapest(rows, 5.0) is rows[4]


@pytest.mark.parametrize(("level", "tolerance"), [(10.0, 5e-2), (1.0, 1e-4), (1e-3, None)])
def test_loosest_tolerance_leaves_a_tenth_in_all_cases_and_at_all_tighter_tolerances(level, tolerance):
    rows = [solved(1e-2, 0.9), solved(1e-3, 0.05), solved(1e-3, 0.2), solved(1e-4, 0.1), solved(1e-6, 1e-3)]
    rows += [solved(5e-2, 1e-5), solved(1e-2, 0.01), solved(1e-4, 5.0, "adr"), solved(1e-6, None)]
    assert report.enough(rows, level, "cg") == tolerance


@pytest.mark.parametrize(
    ("value", "text"), [(5.234, "5.23"), (0.1, "0.10"), (0.0123, "1.2e-2"), (3.4e-12, "3.4e-12"), (None, None)]
)
def test_percent(value, text):
    assert report.percent(value) == text


def test_every_mode_of_bonds_has_rows_on_both_bodies_with_the_fit_counted_and_found():
    """Fitted factors where the body is at least two cells thick: bars of 0.4 in, plates of 0.2 in."""
    series = make_series(quick=False)
    for body, thickness in (("bar", 0.4), ("plate", 0.2)):
        modes = {
            (case.model, case.spacing, case.correction, case.signs, case.fit)
            for case in series[f"{body}: surface correction"]
        }
        expected = set()
        for model in ("pd", "paper"):
            for spacing in (0.2, 0.1, 0.05):
                expected |= {(model, spacing, name, "free", "fresh") for name in ("appendix_a", "none", "virial")}
                if thickness > 1.5 * spacing:
                    expected |= {
                        (model, spacing, "fitted", s, f) for s in ("free", "bounded") for f in ("fresh", "found")
                    }
        assert modes == expected


def test_decks_of_fitted_cases():
    """Coupled exactly, both signs asked for, pulled by tractions; other corrections keep what the paper prints."""
    for body, force in (("bar", 1600.0), ("plate", 6000.0)):
        for model in ("pd", "paper"):
            plain = Case(body, model, 0.1)
            for case in (replace(plain, correction="fitted"), replace(plain, correction="fitted", signs="bounded")):
                scene = read_deck(ROOT / "jobs" / DECKS[body, model], case.overrides)
                assert (scene.peridynamics.surface_correction, scene.peridynamics.signs) == ("fitted", case.signs)
                assert model == "pd" or scene.coupling.kind == "exact"
                pulls = [(load.kind, load.face, load.total) for load in scene.loads]
                assert pulls == [("traction", "x+", (force, 0.0, 0.0)), ("traction", "x-", (-force, 0.0, 0.0))]
            scene = read_deck(ROOT / "jobs" / DECKS[body, model], plain.overrides)
            assert ("body_force" in {load.kind for load in scene.loads}) == ((body, model) != ("plate", "paper"))
            assert model == "pd" or scene.coupling.kind == "paper"


def test_names_and_identities_tell_modes_apart(monkeypatch):
    case = Case("bar", "pd", 0.2)
    fitted = replace(case, correction="fitted")
    cases = [case, fitted, replace(fitted, signs="bounded"), replace(fitted, fit="found")]
    assert len({case.name for case in cases}) == len({study.identity(case, 2) for case in cases}) == 4
    before = [study.identity(each, 2) for each in cases]
    monkeypatch.setattr(study, "__version__", "another")
    after = [study.identity(each, 2) for each in cases]
    assert not set(before) & set(after)


class Runs:
    """In place of the program: finds a fit where an earlier run has left one, as the program does."""

    def __init__(self, keeps=True):
        self.keeps, self.found = keeps, []

    def __call__(self, case, ranks, cache):
        cache.mkdir(exist_ok=True)
        fit = cache / "bond_factors-0.npz"
        self.found.append(fit.exists())
        if self.keeps:
            fit.write_text("")
        return {"fit": {"reused": self.found[-1]} if case.correction == "fitted" else None}


@pytest.mark.parametrize(
    ("fits", "found"),
    [
        (("fresh",), [False]),
        (("fresh", "fresh"), [False, False]),
        (("fresh", "found"), [False, True]),
        (("found",), [False, True]),
        (("found", "found", "fresh"), [False, True, True, False]),
    ],
    ids=["counted", "counted twice", "counted then found", "found needs a run before", "found twice then counted"],
)
def test_fits_are_counted_or_found_as_a_case_asks(tmp_path, monkeypatch, fits, found):
    runs = Runs()
    monkeypatch.setattr(study, "RESULTS", Results(tmp_path))
    monkeypatch.setattr(study, "run_once", runs)
    (tmp_path / "cache").mkdir()
    (tmp_path / "cache" / "kernel.nbi").write_text("")
    for fit in fits:
        study.run_case(Case("bar", "pd", 0.2, correction="fitted", fit=fit), 1)
    assert runs.found == found
    assert (tmp_path / "cache" / "kernel.nbi").exists()


def test_a_fit_that_is_not_kept_is_told(tmp_path, monkeypatch):
    monkeypatch.setattr(study, "RESULTS", Results(tmp_path))
    monkeypatch.setattr(study, "run_once", Runs(keeps=False))
    with pytest.raises(SystemExit, match="the fit is not found"):
        study.run_case(Case("bar", "pd", 0.2, correction="fitted", fit="found"), 1)


@pytest.mark.parametrize(
    ("settings", "text", "breaks"),
    [
        ({}, "coupled, reading B, spacing 0.1, cg to 1e-6", True),
        ({"correction": "virial"}, "coupled, reading B, spacing 0.1, virial, cg to 1e-6", True),
        ({"correction": "none"}, "coupled, reading B, spacing 0.1, no correction, cg to 1e-6", True),
        ({"correction": "fitted"}, "coupled, exact, spacing 0.1, fitted, cg to 1e-6", False),
        (
            {"correction": "fitted", "signs": "bounded", "fit": "found"},
            "coupled, exact, spacing 0.1, fitted, positive, fit found, cg to 1e-6",
            True,
        ),
    ],
    ids=["appendix A", "virial", "none", "fitted", "positive"],
)
def test_modes_in_words_and_which_may_break(settings, text, breaks):
    case = Case("bar", "paper", 0.1, **settings)
    assert report.settings(case) == text
    assert report.may_break(case) is breaks
    assert [suits(case) for suits in report.NEEDS.values()] == [False, breaks, not breaks, False]


def make_result(seconds, error, fit=None, others=0.0):
    """What is kept of a run of the bar whose end has an error in percent."""
    return {
        "status": "finished",
        "notes": [],
        "sweeps": 20,
        "fit": fit,
        "setup_core_seconds": seconds - 1.0,
        "solve_core_seconds": 1.0,
        "counts": {"undirected_bonds": 1000},
        "probes": {"end_displacement": 5.0e-3 * (1.0 + error / 100.0), "end_error_percent": error},
        "cores_used_by_others": others,
        "ranks": 2,
    }


def test_a_found_fit_is_on_a_front_of_its_own_and_is_not_recommended():
    plain = Case("bar", "pd", 0.1)
    fresh = replace(plain, correction="fitted")
    found = replace(fresh, fit="found")
    fits = {"sweeps": 213, "reused": False}
    results = {
        plain: make_result(3.0, 6.0),
        fresh: make_result(9.0, 0.001, fits),
        found: make_result(2.0, 0.001, fits | {"reused": True}),
    }
    rows = {case: report.make_row(case, results, None) for case in results}
    front = report.front_of(row for row in rows.values() if row.case.fit == "fresh")
    with_found = report.front_of(rows.values())
    assert [row.case for row in front] == [plain, fresh]
    assert [row.case for row in with_found] == [found]
    lines = report.series_table(
        "bar: surface correction", results, rows, results, {"bar": front}, {"bar": with_found}
    ).splitlines()
    cells = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines[4:7]]
    assert [(line[2], line[-1]) for line in cells] == [("", "**yes**"), ("213", "**yes**"), ("0", "found")]
    recommended = report.recommendations("bar", list(rows.values()))
    assert "fitted, cg to 1e-6: 1.0e-3 %, 9.00 core-s" in recommended
    assert "found" not in recommended


def test_a_dearer_case_is_not_on_the_front_for_errors_that_are_both_negligible():
    cases = [Case("bar", "pd", spacing, correction="fitted") for spacing in (0.2, 0.1)]
    fit = {"sweeps": 213, "reused": False}
    results = {
        case: make_result(*numbers, fit) for case, numbers in zip(cases, ((3.0, 1e-5), (9.0, 1e-7)), strict=True)
    }
    assert [row.case for row in report.front_of(report.make_row(c, results, None) for c in cases)] == cases[:1]


@pytest.mark.parametrize(
    ("others", "cores", "seconds"),
    [(0.2, 2, 8.0), (1.0, 2, 4.0), (1.5, 2, 2.0), (1.5, 3, 6.0), (1.5, 4, 8.0), (1.0, None, 4.0)],
    ids=["a little", "half", "most", "a core to spare", "two to spare", "cores not kept"],
)
def test_time_that_others_took_is_taken_off(others, cores, seconds):
    """Two ranks that were 8 core-seconds under way."""
    case = Case("bar", "pd", 0.1)
    result = make_result(8.0, 6.0, others=others) | ({"cores": cores} if cores else {})
    row = report.make_row(case, {case: result}, None)
    assert row.total == pytest.approx(seconds)
    assert row.solve == pytest.approx(seconds / 8.0)


def test_runs_of_an_earlier_build_fill_in_and_are_marked(tmp_path):
    case, other = Case("bar", "pd", 0.1), Case("bar", "pd", 0.1, solver="adr")
    settings = {
        "body": "bar",
        "model": "pd",
        "spacing": 0.1,
        "tolerance": 1e-6,
        "solver": "cg",
        "correction": "appendix_a",
    }
    stored = make_result(3.0, 6.0) | {"case": settings}
    for each in (case, other):
        (tmp_path / f"{each.name}.json").write_text(json.dumps(stored))
    assert study.of_earlier_build(tmp_path, case, 2) == stored | {"earlier_build": True}
    assert study.of_earlier_build(tmp_path, other, 2) is None  # a file of other settings
    assert study.of_earlier_build(tmp_path, case, 4) is None
    assert study.of_earlier_build(tmp_path, replace(case, cutoff=3.0), 2) is None
    results = {case: stored | {"earlier_build": True}}
    row = report.make_row(case, results, None)
    cells = report.series_table("bar: any", [case], {case: row}, results, {"bar": []}, {"bar": []}).splitlines()[4]
    assert "| 20^ | 1.00 | 3.00 |" in cells
    assert "1 of the runs, marked `^`" in report.opening(results, 2)


def test_report_of_a_series_that_has_just_begun(tmp_path):
    """Of one body nothing has run: its rows say so, and its panel is empty."""
    series, reference = make_series(quick=True), reference_case(quick=True)
    results = {Case("bar", "pd", 0.1): make_result(3.0, 6.0)}
    report.write_report(tmp_path, series, reference, results, 2)
    text = (tmp_path / "speed_vs_error.md").read_text()
    assert "| peridynamics, spacing 0.1, cg to 1e-6 | 1,000 | 20 | 1.00 | 3.00 | 6.00 | **yes** |" in text
    assert "| peridynamics, spacing 0.1, fitted, fit found, cg to 1e-6 | not run |" in text
    figure = (tmp_path / "figures" / "speed_vs_error.svg").read_text()
    assert all(f">{words}<" in figure for words in ("virial", "fitted, positive", "fit found", "spacing 0.05"))
