"""history.csv: exact numbers, whole rows, and cutting back to a checkpoint."""

import csv

import numpy as np
import pytest

from pdfem_mpi.results.history import History

COLUMNS = ("step", "load_factor", "reaction", "note")
HEADER = "step,load_factor,reaction,note,wall_seconds\n"


def row(step, **changes):
    return {
        "step": step,
        "load_factor": step / 3,
        "reaction": None,
        "note": "",
        "wall_seconds": 0.5,
    } | changes


@pytest.fixture
def path(tmp_path):
    return tmp_path / "history.csv"


@pytest.fixture
def three_rows(path):
    """A file of three rows as its writer left it."""
    history = History(path, COLUMNS)
    for step in range(3):
        history.append(row(step))
    return path


def read(path):
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


@pytest.mark.parametrize(
    "columns",
    [COLUMNS, ("wall_seconds", *COLUMNS), (*COLUMNS, "wall_seconds")],
    ids=["absent", "first", "last"],
)
def test_wall_seconds_is_always_the_last_column(path, columns):
    history = History(path, columns)
    assert history.columns == (*COLUMNS, "wall_seconds")
    assert path.read_text() == HEADER


@pytest.mark.parametrize("number", [0.1, 1 / 3, 5e-324, -1.7976931348623157e308, np.float64(2 / 3), np.float32(0.1)])
def test_floats_read_back_as_the_same_bits(path, number):
    history = History(path, COLUMNS)
    history.append(row(0, reaction=number))
    text = read(path)[0]["reaction"]
    assert text == repr(float(number))
    assert float(text) == number


def test_other_values(path):
    values = {"step": np.int64(2**60), "load_factor": float("nan"), "reaction": None, "note": 'bonds, "all"'}
    history = History(path, COLUMNS)
    history.append(values | {"wall_seconds": 1.0})
    history.append(row(1, note=np.bool_(True)))
    first, second = read(path)
    assert first == {
        "step": "1152921504606846976",
        "load_factor": "nan",
        "reaction": "",
        "note": 'bonds, "all"',
        "wall_seconds": "1.0",
    }
    assert second["note"] == "true"


def test_every_row_is_in_the_file_at_once_and_is_counted(path):
    history = History(path, COLUMNS)
    for step in range(3):
        history.append(row(step, note="é"))
        assert len(read(path)) == history.rows == step + 1
        assert path.stat().st_size == history.size


@pytest.mark.parametrize(
    ("bad", "message"),
    [
        (
            {name: 0 for name in (*COLUMNS, "wall_seconds") if name != "reaction"},
            r"missing columns \['reaction'\]",
        ),
        (row(0) | {"reation": 1.0}, r"unknown columns \['reation'\]"),
        (row(0, note="two\nlines"), "line break"),
    ],
)
def test_a_row_that_does_not_fit_is_refused_and_not_written(path, bad, message):
    history = History(path, COLUMNS)
    with pytest.raises(ValueError, match=message):
        history.append(bad)
    assert history.rows == 0
    assert path.read_text() == HEADER


def test_a_column_named_twice_is_refused(path):
    with pytest.raises(ValueError, match="named twice"):
        History(path, ("step", "step"))
    assert not path.exists()


@pytest.mark.parametrize("torn_end", ["", "3,1.0,", "3,1.0,,,0.5"], ids=["whole", "torn", "no_newline"])
@pytest.mark.parametrize("rows", [0, 1, 3])
def test_reopened_file_continues_after_the_rows_asked_for(three_rows, rows, torn_end):
    """Cut back to any row and continued, the file equals one written without interruption."""
    whole = three_rows.read_bytes()
    with three_rows.open("a") as file:
        file.write(torn_end)
    history = History.reopen(three_rows, COLUMNS, rows)
    assert (history.rows, history.size) == (rows, three_rows.stat().st_size)
    for step in range(rows, 3):
        history.append(row(step))
    assert (history.rows, history.size) == (3, len(whole))
    assert three_rows.read_bytes() == whole


@pytest.mark.parametrize(
    ("columns", "rows", "message"),
    [
        (COLUMNS, 4, "has 3 complete rows, expected at least 4"),
        (COLUMNS, 9, "has 3 complete rows, expected at least 9"),
        (COLUMNS[:-1], 1, "other columns than step, load_factor, reaction, wall_seconds"),
    ],
)
def test_reopen_refuses_a_file_it_cannot_continue(three_rows, columns, rows, message):
    with three_rows.open("a") as file:
        file.write("3,1.0,")
    before = three_rows.read_bytes()
    with pytest.raises(ValueError, match=message):
        History.reopen(three_rows, columns, rows)
    assert three_rows.read_bytes() == before
