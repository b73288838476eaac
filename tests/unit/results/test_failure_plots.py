"""Figures of failing runs: which frames show the stages, what is drawn from which files, and what the pictures hold."""

import csv

import matplotlib.image
import numpy as np
import pytest

from pdfem_mpi.results import vtkhdf
from pdfem_mpi.results.failure_plots import _Layer, draw_failure, find_peak, stages

COLUMNS = (
    "event", "load_factor", "displacement", "reaction", "broken_bonds", "stored_energy", "dissipated_energy",
    "external_work", "released_energy",
)  # fmt: skip
ROWS = (
    ("critical", 0.5, 1e-3, 50.0, 0, 2.5e-2, 0.0, 2.5e-2, 0.0),
    ("batch", 0.5, 1e-3, 30.0, 300, 1.4e-2, 8e-3, 2.5e-2, 3e-3),
    ("end", 0.5, 1e-3, 1.0, 900, 1e-4, 2e-2, 2.5e-2, 4.9e-3),
)


def run_folder(path, damage=True, rows=ROWS):
    """A folder as a run leaves it: a plate of one layer whose middle column breaks."""
    with open(path / "history.csv", "w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(COLUMNS)
        writer.writerows(rows)
    x, y = np.meshgrid(np.arange(40.0), np.arange(20.0), indexing="ij")
    points = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1)
    vtkhdf.create_points(path / "points.vtkhdf", points)
    for row in rows:
        fields = {"displacement": np.zeros_like(points)}
        if damage:
            fields["damage"] = np.where(points[:, 0] == 20.0, row[4] / 900, 0.0)
        vtkhdf.append_frame(path / "points.vtkhdf", row[1], fields)
    return path


def test_all_figures(tmp_path):
    drawn = draw_failure(run_folder(tmp_path), "a plate", "mm", "N", film=True, warn=pytest.fail)
    assert [path.name for path in drawn] == ["reaction.png", "energies.png", "damage.png", "damage.gif"]
    assert all(path.parent == tmp_path / "figures" and path.stat().st_size > 5000 for path in drawn)
    assert sorted(path.name for path in (tmp_path / "figures").iterdir()) == sorted(path.name for path in drawn)
    assert drawn[3].read_bytes().startswith(b"GIF89a")


def test_a_run_without_failure_has_its_loads_over_displacements(tmp_path):
    """From two rows on; also where a cycle passes 0."""
    columns = [name for name in COLUMNS if name != "broken_bonds"]
    rows = [("step", f, 1e-3 * f, 50.0 * abs(f), *[""] * 4) for f in (0.5, 1.0, -0.5)]
    for count, expected in ((1, []), (3, ["reaction.png"])):
        with open(tmp_path / "history.csv", "w", newline="", encoding="utf-8") as file:
            csv.writer(file).writerows([columns, *rows[:count]])
        drawn = draw_failure(tmp_path, "an elastic bar", "mm", "N", warn=pytest.fail)
        assert [path.name for path in drawn] == expected
    assert drawn[0].stat().st_size > 5000


def test_the_peak_is_that_of_the_run_not_of_the_rows_that_were_told():
    """With `stepping.report_every` the rows leave out states, and the summary knows of them."""
    history = {name: np.array([row[k] for row in ROWS]) for k, name in enumerate(COLUMNS)}
    assert find_peak(history, None) == (1e-3, 50.0)
    summary = {"failure": {"peak": {"load": 62.5, "displacement": 2e-3, "row": 13}}}
    assert find_peak(history, summary) == (2e-3, 62.5)
    history["reaction"][-1] = 62.5
    assert find_peak(history, summary) is None  # it may go on rising
    history["reaction"][-1] = 1.0
    assert find_peak(history, {"failure": None}) == (1e-3, 50.0)


def test_the_crack_is_seen(tmp_path):
    """Dark pixels of the last stage stand in the middle of the plate."""
    draw_failure(run_folder(tmp_path), "", "", "", warn=pytest.fail)
    picture = matplotlib.image.imread(tmp_path / "figures" / "damage.png")[:, :, :3]
    height, width = picture.shape[:2]
    panel = picture[int(0.46 * height) : int(0.5 * height), int(0.54 * width) : int(0.82 * width)]  # the second of two
    columns = np.flatnonzero((panel.max(axis=2) < 0.15).mean(axis=0) > 0.9)
    assert len(columns) >= 3
    assert np.ptp(columns) < 0.15 * panel.shape[1]
    assert abs(columns.mean() - 0.5 * panel.shape[1]) < 0.2 * panel.shape[1]


def test_without_damage_or_breaks(tmp_path):
    (tmp_path / "a").mkdir()
    (tmp_path / "b").mkdir()
    drawn = draw_failure(run_folder(tmp_path / "a", damage=False), "", "", "", film=True, warn=pytest.fail)
    assert [path.name for path in drawn] == ["reaction.png", "energies.png"]
    (tmp_path / "b" / "history.csv").write_text("step,load_factor\n1,1.0\n")
    assert draw_failure(tmp_path / "b", "", "", "", warn=pytest.fail) == []


@pytest.mark.parametrize(
    ("broken", "expected"),
    [
        ([0, 0, 10, 40, 70, 100], [2, 3, 4, 5]),
        ([0, 5], [1]),
        ([3], [0]),
        ([0, 90, 100], [1, 2]),
    ],
)
def test_stages(broken, expected):
    """The first breaks, a third and two thirds of the way where there are such frames, and the end."""
    found = stages(broken, len(broken))
    assert found[0] == expected[0] and found[-1] == expected[-1]
    assert set(expected) <= set(found) and len(found) <= 4


def test_a_crack_that_the_outside_hides_is_drawn_where_it_is(tmp_path):
    """In the middle of a cube: the layer through it, across one of the two directions in which it is wide."""
    corners = np.stack(np.meshgrid(*3 * [np.arange(7.0)], indexing="ij"), axis=-1).reshape(-1, 3)
    inside = (corners[:, 0] == 3.0) & (np.abs(corners[:, 1:] - 3.0) <= 1.0).all(axis=1)
    vtkhdf.create_points(tmp_path / "points.vtkhdf", corners)
    vtkhdf.append_frame(tmp_path / "points.vtkhdf", 1.0, {"damage": np.where(inside, 0.4, 0.0)})
    layer = _Layer(tmp_path / "points.vtkhdf")
    assert layer.where in ("y = 2", "y = 3", "y = 4") and len(layer.chosen) == 49
    assert layer.damage(0).max() == np.float32(0.4)
