"""What a run wrote is read back with the same numbers; what is not there is said, not guessed."""

import json

import numpy as np
import pytest

from pdfem_mpi.results import vtkhdf
from pdfem_mpi.results.history import History, read_history
from pdfem_mpi.results.lines import write_line
from pdfem_mpi.results.run_folder import RunFolder, read_summary

COLUMNS = ("step", "event", "load_factor", "displacement", "reaction", "ledger_error")
X = np.array([[0.0, 0.0, 0.1], [1.0, 0.0, 0.2], [2.0, 1.0, 0.3]])


@pytest.fixture
def folder(tmp_path):
    """A folder as a run leaves it: two rows, two frames at points, one line."""
    history = History(tmp_path / "history.csv", COLUMNS)
    for step in (1, 2):
        history.append(
            {
                "step": step,
                "event": "critical",
                "load_factor": 0.1 * step,
                "displacement": 1e-3 * step,
                "reaction": 7.0 / step,
                "ledger_error": None,
                "wall_seconds": 0.5,
            }
        )
    vtkhdf.create_points(tmp_path / "points.vtkhdf", X)
    for frame in (1, 2):
        fields = {"displacement": frame * X, "damage": np.full(3, 0.25 * frame)}
        vtkhdf.append_frame(tmp_path / "points.vtkhdf", 0.1 * frame, fields)
    (tmp_path / "lines").mkdir()
    rows = [(0.0, X[0], X[1], "peridynamics"), (1.5, X[1], None, "")]
    write_line(tmp_path / "lines" / "axis.csv", rows)
    (tmp_path / "summary.json").write_text(json.dumps({"status": "finished", "probes": {"end": 1.5}}))
    return RunFolder(tmp_path)


def test_columns_are_numbers_with_all_their_digits(folder):
    history = folder.history
    assert list(history) == [*COLUMNS, "wall_seconds"]
    np.testing.assert_array_equal(history["load_factor"], [0.1, 0.2])
    np.testing.assert_array_equal(folder.reaction, [7.0, 3.5])
    np.testing.assert_array_equal(folder.displacement, [1e-3, 2e-3])
    assert history["event"].tolist() == ["critical", "critical"]
    assert np.isnan(history["ledger_error"]).all()


def test_frames_count_from_both_ends(folder):
    points = folder.points
    np.testing.assert_array_equal(points.positions, X)
    np.testing.assert_allclose(points.load_factors, [0.1, 0.2], rtol=1e-15)
    np.testing.assert_array_equal(points.displacement(), (2 * X).astype("f4"))
    np.testing.assert_array_equal(points.displacement(0), points.displacement(-2))
    np.testing.assert_array_equal(folder.damage, np.full(3, 0.5, "f4"))
    assert points.names == ["damage", "displacement"]
    assert folder.nodes is None


@pytest.mark.parametrize("frame", [2, -3])
def test_a_frame_that_is_not_there_is_an_index_error(folder, frame):
    with pytest.raises(IndexError, match="has 2 frames"):
        folder.points.displacement(frame)


def test_a_field_that_is_not_there_is_named_with_those_that_are(folder):
    with pytest.raises(KeyError, match="holds damage, displacement, and no stress"):
        folder.points.field("stress")


def test_a_line_has_gaps_outside_of_the_body(folder):
    line = folder.line("axis")
    np.testing.assert_array_equal(line["distance"], [0.0, 1.5])
    np.testing.assert_array_equal(line["u_z"], [0.2, np.nan])
    assert line["model"].tolist() == ["peridynamics", ""]


def test_a_summary_that_is_missing_or_torn_is_said(folder):
    assert folder.summary["probes"]["end"] == folder.numbers["end"] == 1.5
    (folder.path / "summary.json").write_text('{"status": ')
    assert read_summary(folder.path) is None
    with pytest.raises(FileNotFoundError, match="the run has not ended"):
        _ = folder.summary


def test_another_folder_is_not_a_run(tmp_path):
    with pytest.raises(FileNotFoundError, match="is not the folder of a run"):
        RunFolder(tmp_path)


def test_a_history_with_a_word_among_its_numbers_is_refused(tmp_path):
    (tmp_path / "history.csv").write_text("step,reaction\n1,many\n")
    with pytest.raises(ValueError, match="many"):
        read_history(tmp_path / "history.csv")


def test_a_history_is_read_with_gaps(tmp_path):
    """Columns that came with a restart are empty in the rows before."""
    (tmp_path / "history.csv").write_text("event,reaction,external_work\nstep,1.5,\nstep,2.5,0.25\n")
    found = read_history(tmp_path / "history.csv")
    assert found["event"].tolist() == ["step", "step"]
    np.testing.assert_array_equal(found["reaction"], [1.5, 2.5])
    np.testing.assert_array_equal(found["external_work"], [np.nan, 0.25])
