"""The chart of speed against error: its Pareto front, its tables, and what it recommends."""

import importlib.util
from pathlib import Path
from types import SimpleNamespace

import pytest

PATH = Path(__file__).resolve().parents[2] / "tools" / "speed_report.py"


@pytest.fixture(scope="module")
def report():
    spec = importlib.util.spec_from_file_location("speed_report", PATH)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


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
def test_pareto_front(report, costs, errors, front):
    assert report.pareto_front(costs, errors) == front


def test_no_point_of_the_front_is_beaten_and_every_other_is(report):
    costs = [(7 * k) % 31 for k in range(60)]
    errors = [(11 * k) % 37 for k in range(60)]
    points = list(zip(costs, errors, strict=True))
    front = {points[i] for i in report.pareto_front(costs, errors)}

    def beaten(point):
        return any(other != point and other[0] <= point[0] and other[1] <= point[1] for other in points)

    assert front == {point for point in points if not beaten(point)}


def test_front_with_a_gain_leaves_out_what_is_dearer_and_hardly_better(report):
    costs, errors = [1.0, 2.0, 3.0, 4.0], [5.0, 4.96, 4.94, 1.0]
    assert report.pareto_front(costs, errors, 0.01) == [0, 2, 3]


def test_table_is_markdown_with_a_place_for_each_cell(report):
    text = report.table(["case", "error %"], [["|x| < 2", "4.85"], ["fe", None]])
    assert text.splitlines() == [
        "| case | error % |",
        "| --- | --- |",
        r"| \|x\| < 2 | 4.85 |",
        "| fe | - |",
    ]


def test_table_refuses_a_row_that_does_not_fit(report):
    with pytest.raises(ValueError, match="a row of 1 cells under 2 headings"):
        report.table(["case", "error %"], [["pd"]])


@pytest.mark.parametrize(("level", "index"), [(5.0, 1), (3.0, 2), (1.0, None)])
def test_cheapest_case_that_reaches_a_level(report, level, index):
    rows = [row(1.0, 6.0), row(2.0, 5.0), row(3.0, 3.0), row(4.0, 2.0), row(0.5, None)]
    assert report.cheapest(rows, level) is (None if index is None else rows[index])


def test_of_cases_as_cheap_the_more_accurate_then_that_of_fewer_sweeps(report):
    rows = [row(1.0, 4.0, 1), row(1.09, 3.001, 9), row(1.05, 3.0, 8), row(1.2, 1.0, 1), row(1.08, 3.002, 7)]
    assert report.cheapest(rows, 5.0) is rows[4]


@pytest.mark.parametrize(("level", "tolerance"), [(10.0, 5e-2), (1.0, 1e-4), (1e-3, None)])
def test_loosest_tolerance_leaves_a_tenth_in_all_cases_and_at_all_tighter_tolerances(report, level, tolerance):
    rows = [solved(1e-2, 0.9), solved(1e-3, 0.05), solved(1e-3, 0.2), solved(1e-4, 0.1), solved(1e-6, 1e-3)]
    rows += [solved(5e-2, 1e-5), solved(1e-2, 0.01), solved(1e-4, 5.0, "adr"), solved(1e-6, None)]
    assert report.enough(rows, level, "cg") == tolerance


@pytest.mark.parametrize(
    ("value", "text"), [(5.234, "5.23"), (0.1, "0.10"), (0.0123, "1.2e-2"), (3.4e-12, "3.4e-12"), (None, None)]
)
def test_percent(report, value, text):
    assert report.percent(value) == text
