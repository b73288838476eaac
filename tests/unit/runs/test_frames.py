"""Frames of a run by time: the viewer finds each row's own, with its numbers; every n-th and the last are written."""

import numpy as np
import pytest

from pdfem_mpi import open_run
from pdfem_mpi.deck.outputs import Output
from pdfem_mpi.deck.programs import Events, Steps
from pdfem_mpi.deck.toml import write_deck
from pdfem_mpi.parallel.comm import world
from pdfem_mpi.results import vtkhdf
from pdfem_mpi.results.ownership import Written
from pdfem_mpi.runs.frames import FramesOutput
from pdfem_mpi.runs.output import Place
from pdfem_mpi.runs.reporter import NullReporter
from pdfem_mpi.runs.run import run
from pdfem_mpi.system.exit_codes import EXIT_STOPPED
from support.failing import strip
from support.restarts import StopAt, alone, failing, outcome

vtk = pytest.importorskip("vtk", reason="VTK's reader is the oracle of these tests (extra: test)")
from vtk.util.numpy_support import vtk_to_numpy  # noqa: E402

PROGRAMS = {
    "load control": Events(kind="events", eta=0.01, report_every=1, end_reaction=0.5),
    "energy control": Events(kind="events", eta=0.05, control="energy", report_every=1, end_reaction=0.5),
}


def followed(folder, stepping, **output):
    """A small strip with a crack in its middle, and elements at both ends."""
    scene = strip(stepping=stepping, elements=2, cells=(12, 6, 1))
    scene = scene.model_copy(update={"output": Output(figures=False, damage=True, **output)})
    assert run(scene, world(), folder, write_deck(scene), False, NullReporter()) == 0
    return open_run(folder)


def by_time(path, time):
    """The frame that ParaView shows at a time."""
    reader = vtk.vtkHDFReader()
    reader.SetFileName(str(path))
    reader.UpdateInformation()
    reader.UpdateTimeStep(float(time))
    return reader.GetOutput()


def arrays(data):
    return {data.GetArrayName(k): vtk_to_numpy(data.GetArray(k)) for k in range(data.GetNumberOfArrays())}


def times_of(path):
    reader = vtk.vtkHDFReader()
    reader.SetFileName(str(path))
    reader.UpdateInformation()
    return reader.GetOutputInformation(0).Get(vtk.vtkStreamingDemandDrivenPipeline.TIME_STEPS())


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A run with a frame at each row."""
    return followed(tmp_path_factory.mktemp("whole"), PROGRAMS["load control"])


@pytest.mark.parametrize("control", PROGRAMS)
def test_every_frame_is_reached_by_time(tmp_path, whole, control):
    """Load factors repeat (load control) or fall (energy control): the number of the row is what rises."""
    folder = whole if control == "load control" else followed(tmp_path, PROGRAMS[control])
    history = folder.history
    rows = len(history["step"])
    assert rows > 4 and not (np.diff(history["load_factor"]) > 0.0).all()
    for name in ("points.vtkhdf", "elements.vtkhdf", "body.vtkhdf"):
        path = folder.path / name
        assert times_of(path) == tuple(range(1, rows + 1))
        for row in range(rows):
            data = by_time(path, row + 1)
            numbers = arrays(data.GetFieldData())
            for column in ("load_factor", "reaction", "broken_bonds"):
                assert numbers[column] == history[column][row], (name, row, column)
            expected = vtkhdf.read_frame(path, "displacement", row)
            np.testing.assert_array_equal(arrays(data.GetPointData())["displacement"], expected)
    assert (folder.points.load_factors == history["load_factor"]).all()
    assert (folder.points.rows == np.arange(rows)).all()


def test_the_whole_body_is_in_one_file_with_damage_on_cells(whole):
    grid = by_time(whole.path / "body.vtkhdf", len(whole.reaction))
    cells = arrays(grid.GetCellData())
    assert grid.GetNumberOfCells() == 72 and set(cells) == {"region", "material", "model", "damage"}
    assert set(cells["model"]) == {0, 1, 2}
    damage = whole.points.damage().reshape(-1, 8).mean(axis=1)
    np.testing.assert_allclose(cells["damage"][cells["model"] > 0], damage, rtol=1e-6)
    assert damage.max() > 0.2


@pytest.mark.parametrize(
    "every", [3, pytest.param(2, marks=pytest.mark.slow), pytest.param(999, marks=pytest.mark.slow)]
)
def test_every_nth_row_and_the_last_have_a_frame(tmp_path, whole, every):
    some = followed(tmp_path, PROGRAMS["load control"], every=every)
    rows = len(whole.reaction)
    chosen = sorted({*range(0, rows, every), rows - 1})
    assert some.points.rows.tolist() == chosen
    for frame, row in enumerate(chosen):
        np.testing.assert_array_equal(some.points.field("damage", frame), whole.points.field("damage", row))
        np.testing.assert_array_equal(some.nodes.displacement(frame), whole.nodes.displacement(row))


def test_a_run_that_was_stopped_has_the_same_frames(tmp_path):
    """The last row of a start has no frame of its own until the run is over."""
    scene = failing("events")
    scene = scene.model_copy(update={"output": Output(figures=False, damage=True, every=3)})
    assert alone(scene, tmp_path / "straight") == 0
    assert alone(scene, tmp_path / "stopped", requests=StopAt(7)) == EXIT_STOPPED
    assert alone(scene, tmp_path / "stopped") == 0
    straight, stopped = outcome(tmp_path / "straight"), outcome(tmp_path / "stopped")
    assert straight.keys() == stopped.keys()
    for name, value in straight.items():
        assert stopped[name] == value, name


def test_without_the_file_of_the_whole_body(tmp_path):
    followed(tmp_path, Steps(load_factors=(0.1,)), body=False)
    assert not (tmp_path / "body.vtkhdf").exists() and (tmp_path / "points.vtkhdf").exists()


def test_one_frame_has_one_time(tmp_path):
    folder = followed(tmp_path, Steps(load_factors=(0.1,)))
    assert folder.points.rows.tolist() == [0] and folder.points.load_factors.tolist() == [0.1]
    assert arrays(by_time(tmp_path / "points.vtkhdf", 1).GetFieldData())["load_factor"] == 0.1


def test_frames_of_an_older_version_are_set_aside(tmp_path):
    """They have load factors for times: numbers of rows would not go with them."""
    written = Written(tmp_path)
    written.begin()
    path = written.new("points.vtkhdf")
    vtkhdf.create_points(path, np.zeros((3, 3)))
    with vtkhdf.guarded(path, "r+") as file:
        del file["VTKHDF/FieldData"], file["VTKHDF/Steps/FieldDataOffsets"]
    scene = failing("events")
    digest = vtkhdf.digest_of(path).hexdigest()
    cursors = {"points.vtkhdf": {"frames": 0, "sha256": digest, "deck": None}, "history.csv": {"rows": 4}}
    notes = []
    place = Place(scene, None, written, "", cursors, False, notes.append, notes.append)
    output = FramesOutput("points.vtkhdf", lambda place, path: vtkhdf.create_points(path, np.zeros((3, 3))), None, ())
    output.open(place)
    assert output.row == 4 and (tmp_path / "points.vtkhdf.before").exists()
    assert notes == [
        "points.vtkhdf begins anew: its frames are those of an older version; it is now points.vtkhdf.before"
    ]
