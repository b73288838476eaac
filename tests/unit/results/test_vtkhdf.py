"""VTKHDF files, read back by VTK's own reader: what ParaView will see."""

import subprocess
import sys

import h5py
import numpy as np
import pytest

from pdfem_mpi.results import vtkhdf

vtk = pytest.importorskip("vtk", reason="VTK's reader is the oracle of these tests (extra: test)")
from vtk.util.numpy_support import vtk_to_numpy  # noqa: E402

TIMES = (0.25, 0.5, 1.0)
CUBE = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]], float)


def positions():
    """Seven points far from the origin, where single precision would lose them."""
    return 1.0e6 + np.random.default_rng(7).random((7, 3))


def displacement(time, n=7):
    return time * np.random.default_rng(11).random((n, 3))


def reader(path):
    reader = vtk.vtkHDFReader()
    reader.SetFileName(str(path))
    reader.UpdateInformation()
    return reader


def times(path):
    information = reader(path).GetOutputInformation(0)
    return information.Get(vtk.vtkStreamingDemandDrivenPipeline.TIME_STEPS()) or ()


def frame(path, step=None, time=None):
    """One frame as VTK sees it, asked for by number or, as ParaView does, by time."""
    source = reader(path)
    if step is not None:
        source.SetStep(step)
        source.Update()
    else:
        source.UpdateTimeStep(time)
    assert source.GetErrorCode() == 0
    return source.GetOutput()


def fields(data):
    return {data.GetArrayName(k): vtk_to_numpy(data.GetArray(k)) for k in range(data.GetNumberOfArrays())}


@pytest.fixture
def points_file(tmp_path):
    path = tmp_path / "points.vtkhdf"
    vtkhdf.create_points(path, positions(), {"global_id": np.arange(7, dtype="i8")})
    return path


def append(path, time):
    """Append a frame in which every value tells its time."""
    vtkhdf.append_frame(path, time, {"u": displacement(time), "broken": np.full(7, int(4 * time))}, {"c": [time] * 7})


def assert_frames_are(path, expected):
    assert vtkhdf.frames(path) == len(expected)
    if len(expected) > 1:  # VTK announces no times for a single frame
        assert times(path) == tuple(expected)
    for step, time in enumerate(expected):
        points = fields(frame(path, step).GetPointData())
        np.testing.assert_array_equal(points["u"], displacement(time).astype("f4"))
        np.testing.assert_array_equal(points["broken"], int(4 * time))
        np.testing.assert_array_equal(points["global_id"], np.arange(7))
        np.testing.assert_array_equal(fields(frame(path, step).GetCellData())["c"], np.float32(time))


def test_points_are_vertices_at_their_exact_positions(points_file):
    append(points_file, 1.0)
    grid = frame(points_file, 0)
    np.testing.assert_array_equal(vtk_to_numpy(grid.GetPoints().GetData()), positions())
    assert grid.GetNumberOfCells() == 7
    for k in range(7):
        assert grid.GetCellType(k) == vtk.VTK_VERTEX
        assert grid.GetCell(k).GetPointId(0) == k


def test_elements_are_hexahedra_of_positive_volume(tmp_path):
    """Two unit cubes that share a face: VTK's own volume is +1 each, which needs the right node order."""
    path = tmp_path / "elements.vtkhdf"
    nodes = np.concatenate([CUBE, CUBE[[1, 2, 5, 6]] + [1, 0, 0]])
    cells = np.array([[0, 1, 2, 3, 4, 5, 6, 7], [1, 8, 9, 2, 5, 10, 11, 6]])
    vtkhdf.create_elements(path, nodes, cells, {"region": np.array([3, 5], dtype="i4")}, {"node": np.arange(12)})
    vtkhdf.append_frame(path, 1.0, {"u": displacement(1.0, 12)}, {"energy": np.array([0.5, 0.25])})
    grid = frame(path, 0)
    np.testing.assert_array_equal(vtk_to_numpy(grid.GetPoints().GetData()), nodes)
    for k, cell in enumerate(cells):
        assert grid.GetCellType(k) == vtk.VTK_HEXAHEDRON
        assert [grid.GetCell(k).GetPointId(corner) for corner in range(8)] == list(cell)
    quality = vtk.vtkCellSizeFilter()
    quality.SetInputData(grid)
    quality.Update()
    np.testing.assert_allclose(fields(quality.GetOutput().GetCellData())["Volume"], 1.0, rtol=1e-12)  # round-off
    assert fields(grid.GetCellData())["region"].tolist() == [3, 5]
    assert fields(grid.GetCellData())["energy"].tolist() == [0.5, 0.25]
    assert fields(grid.GetPointData())["node"].tolist() == list(range(12))


@pytest.mark.parametrize("precision", ["f4", "f8"])
def test_floats_are_stored_in_the_precision_asked_for(tmp_path, precision):
    path = tmp_path / "points.vtkhdf"
    static = np.linspace(0.0, 1.0, 7)
    vtkhdf.create_points(path, positions(), {"volume": static}, precision=precision)
    vtkhdf.append_frame(path, 1.0, {"u": displacement(1.0), "intact": np.arange(7) < 3})
    points = fields(frame(path, 0).GetPointData())
    for name, values in (("volume", static), ("u", displacement(1.0))):
        assert points[name].dtype == precision
        np.testing.assert_array_equal(points[name], values.astype(precision))
    assert points["intact"].tolist() == [1, 1, 1, 0, 0, 0, 0]


def test_frames_are_found_by_number_and_by_time(points_file):
    for time in TIMES:
        append(points_file, time)
    assert_frames_are(points_file, TIMES)
    for time in TIMES:
        u = fields(frame(points_file, time=time).GetPointData())["u"]
        np.testing.assert_array_equal(u, displacement(time).astype("f4"))


def test_frames_larger_than_a_chunk(tmp_path, monkeypatch):
    """The end of one frame and the start of the next may lie in one chunk."""
    monkeypatch.setattr(vtkhdf, "ROWS_PER_CHUNK", 3)
    path = tmp_path / "points.vtkhdf"
    vtkhdf.create_points(path, positions(), {"global_id": np.arange(7)})
    for time in TIMES:
        append(path, time)
    with h5py.File(path) as file:
        assert file["VTKHDF/PointData/u"].chunks == (3, 3)
    assert_frames_are(path, TIMES)


def interrupt(monkeypatch, operation):
    """Let the n-th change to the file (a dataset that grows, or the final NSteps) fail as a full disk does."""
    left = [operation]

    def failing(original):
        def call(*arguments, **keywords):
            left[0] -= 1
            if left[0] < 0:
                raise OSError("No space left on device")
            return original(*arguments, **keywords)

        return call

    monkeypatch.setattr(vtkhdf, "_put", failing(vtkhdf._put))
    monkeypatch.setattr(h5py.AttributeManager, "modify", failing(h5py.AttributeManager.modify))


@pytest.mark.parametrize("operation", range(0, 30, 2))
@pytest.mark.parametrize("n_complete", [0, 1, 2])
def test_a_torn_append_is_invisible_and_does_no_harm(points_file, monkeypatch, n_complete, operation):
    for time in TIMES[:n_complete]:
        append(points_file, time)
    with monkeypatch.context() as patch:
        interrupt(patch, operation)
        try:
            append(points_file, 99.0)
        except OSError:
            torn = True
        else:
            torn = False  # fewer operations than that: the append was complete
            assert operation > 12
    if torn:
        assert_frames_are(points_file, TIMES[:n_complete])
    else:
        vtkhdf.truncate(points_file, n_complete)
    for time in TIMES[n_complete:]:
        append(points_file, time)
    assert_frames_are(points_file, TIMES)


def test_a_process_killed_before_the_last_write_leaves_the_earlier_frames(points_file):
    append(points_file, TIMES[0])
    script = f"""
import os, h5py, numpy
from pdfem_mpi.results import vtkhdf
h5py.AttributeManager.modify = lambda *_: os._exit(9)
one = numpy.ones(7)
vtkhdf.append_frame({str(points_file)!r}, 99, dict(u=one[:, None] * [1, 2, 3], broken=one > 0), dict(c=one))
"""
    assert subprocess.run([sys.executable, "-c", script], check=False).returncode == 9
    with h5py.File(points_file) as file:
        assert len(file["VTKHDF/Steps/Values"]) == 2  # the torn frame did reach the file
    assert_frames_are(points_file, TIMES[:1])
    for time in TIMES[1:]:
        append(points_file, time)
    assert_frames_are(points_file, TIMES)


@pytest.mark.parametrize("kept", [0, 1, 2, 3])
def test_truncated_file_continues_as_if_it_had_never_been_longer(points_file, kept):
    for time in (*TIMES[:kept], *[77.0] * (3 - kept)):
        append(points_file, time)
    vtkhdf.truncate(points_file, kept)
    assert_frames_are(points_file, TIMES[:kept])
    for time in TIMES[kept:]:
        append(points_file, time)
    assert_frames_are(points_file, TIMES)


def test_truncate_refuses_more_frames_than_there_are(points_file):
    append(points_file, TIMES[0])
    with pytest.raises(ValueError, match="has 1 frames, cannot be cut to 2"):
        vtkhdf.truncate(points_file, 2)
    assert_frames_are(points_file, TIMES[:1])


@pytest.mark.parametrize(
    ("point_data", "message"),
    [
        ({"u": np.zeros((6, 3)), "broken": np.zeros(7)}, r"u has shape \(6, 3\), needs 7 rows"),
        ({"u": np.zeros((7, 3))}, r"frame 1 has PointData \['u'\], earlier frames \['broken', 'u'\]"),
        ({"u": np.zeros((7, 3)), "broken": np.zeros(7), "v": np.zeros(7)}, "frame 1 has PointData"),
    ],
)
def test_a_frame_that_does_not_fit_is_refused(points_file, point_data, message):
    append(points_file, TIMES[0])
    with pytest.raises(ValueError, match=message):
        vtkhdf.append_frame(points_file, 99.0, point_data, {"c": np.zeros(7)})
    assert_frames_are(points_file, TIMES[:1])


def test_a_static_field_cannot_be_a_field_of_a_frame(points_file):
    with pytest.raises(ValueError, match="global_id is a static field"):
        vtkhdf.append_frame(points_file, 1.0, {"global_id": np.zeros(7)})


def test_cells_outside_the_nodes_are_refused_before_a_file_exists(tmp_path):
    with pytest.raises(ValueError, match="cells name nodes 0 to 8 of 8"):
        vtkhdf.create_elements(tmp_path / "e.vtkhdf", CUBE, np.array([[0, 1, 2, 3, 4, 5, 6, 8]]))
    assert list(tmp_path.iterdir()) == []


def test_a_file_open_in_a_viewer_can_still_grow(points_file):
    append(points_file, TIMES[0])
    code = f"import h5py; f = h5py.File({str(points_file)!r}, 'r'); print('open', flush=True); input()"
    viewer = subprocess.Popen([sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    try:
        assert viewer.stdout.readline() == "open\n"
        append(points_file, TIMES[1])
    finally:
        viewer.communicate("\n")
    assert_frames_are(points_file, TIMES[:2])


def test_attributes_tell_what_the_file_belongs_to(tmp_path):
    path = tmp_path / "points.vtkhdf"
    vtkhdf.create_points(path, positions(), attributes={"format_version": 1, "deck_sha256": "ab12"})
    with h5py.File(path) as file:
        assert dict(file.attrs) == {"field_precision": "f4", "format_version": 1, "deck_sha256": "ab12"}


def test_frames_read_back(tmp_path):
    """Positions in double precision, fields of each frame by name; a frame that is not there is refused."""
    x = np.random.default_rng(5).uniform(size=(7, 3))
    path = tmp_path / "points.vtkhdf"
    vtkhdf.create_points(path, x, {"region": np.arange(7)}, precision="f8")
    for frame in range(3):
        vtkhdf.append_frame(path, float(frame), {"displacement": x + frame, "damage": x[:, 0] * frame})
    assert (vtkhdf.read_points(path) == x).all()
    assert vtkhdf.frame_fields(path) == ["damage", "displacement"]
    assert (vtkhdf.read_frame(path, "displacement", 2) == x + 2).all()
    assert (vtkhdf.read_frame(path, "damage", 1) == x[:, 0]).all()
    with pytest.raises(ValueError, match="has 3 frames, and no frame 3"):
        vtkhdf.read_frame(path, "damage", 3)
