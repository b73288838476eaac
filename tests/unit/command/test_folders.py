"""What is done with the folder of a run that is over: exported for others, cleaned of what only a restart needs."""

import csv
import shutil

import numpy as np
import pytest
import typer

from pdfem_mpi import open_run
from pdfem_mpi.command.folders import clean, export
from support.restarts import StopAt, alone, failing

STOPPED = 75


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs") / "a strip"
    assert alone(failing("steps"), folder) == 0
    return folder


@pytest.fixture
def run_folder(finished, tmp_path):
    return shutil.copytree(finished, tmp_path / "a strip")


def refused(capsys, command, *arguments):
    with pytest.raises(typer.Exit) as caught:
        command(*arguments)
    assert caught.value.exit_code == 64
    return capsys.readouterr().err


def names(folder):
    return {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()}


def test_checkpoints_go_and_results_stay(run_folder, capsys):
    before = names(run_folder)
    assert clean(run_folder, True, False, True) == 0
    gone = before - names(run_folder)
    assert gone and all(name.startswith("checkpoints/ckpt-") for name in gone)
    assert "MB are free" in capsys.readouterr().out and not (run_folder / "checkpoints").exists()
    assert len(open_run(run_folder).reaction) == 2


def test_frames_go_where_they_are_named(run_folder):
    before = names(run_folder)
    assert clean(run_folder, False, True, True) == 0
    assert before - names(run_folder) == {"points.vtkhdf", "elements.vtkhdf", "body.vtkhdf"}


def test_what_the_program_did_not_write_stays(run_folder, capsys):
    """A file with a checkpoint's name, one with the name of frames, a link, and anything else."""
    mine = {"checkpoints/ckpt-000077.h5": "mine", "notes.txt": "mine", "body.vtkhdf": "mine"}
    for name, text in mine.items():
        (run_folder / name).write_text(text)
    (run_folder / "checkpoints" / "ckpt-000078.h5").symlink_to(run_folder / "notes.txt")
    assert clean(run_folder, True, True, True) == 0
    assert {*mine, "checkpoints/ckpt-000078.h5"} <= names(run_folder)
    assert all((run_folder / name).read_text() == "mine" for name in mine)
    assert "stays: it is not what pdfem wrote" in capsys.readouterr().out


def test_nothing_goes_without_an_answer(run_folder, monkeypatch, capsys):
    before = names(run_folder)
    for answer in (False, typer.Abort()):

        def confirm(text, answer=answer):
            if isinstance(answer, Exception):
                raise answer
            return answer

        monkeypatch.setattr(typer, "confirm", confirm)
        assert clean(run_folder, True, False, False) == 0
    assert names(run_folder) == before and capsys.readouterr().out.count("nothing was removed") == 2


def test_a_run_that_may_go_on_is_not_cleaned(tmp_path, capsys):
    assert alone(failing("events"), tmp_path / "run", requests=StopAt(3)) == STOPPED
    before = names(tmp_path)
    assert "not finished" in refused(capsys, clean, tmp_path / "run", True, True, True)
    assert "holds no run" in refused(capsys, clean, tmp_path, True, True, True)
    assert names(tmp_path) == before


def test_frames_become_files_that_vtk_reads(run_folder, tmp_path):
    pytest.importorskip("vtk", reason="VTK's reader is the oracle (extra: test)")
    from vtk import vtkXMLUnstructuredGridReader
    from vtk.util.numpy_support import vtk_to_numpy

    assert export(run_folder, "pvd", -1, tmp_path / "out") == 0
    folder = open_run(run_folder)
    for name in ("points", "elements", "body"):
        assert (tmp_path / "out" / f"{name}.pvd").read_text().count("timestep=") == 2
    for frame in range(2):
        reader = vtkXMLUnstructuredGridReader()
        reader.SetFileName(str(tmp_path / "out" / f"points-{frame + 1:05d}.vtu"))
        reader.Update()
        grid = reader.GetOutput()
        data = grid.GetPointData()
        np.testing.assert_array_equal(vtk_to_numpy(grid.GetPoints().GetData()), folder.points.positions)
        np.testing.assert_array_equal(vtk_to_numpy(data.GetArray("displacement")), folder.points.displacement(frame))
        np.testing.assert_array_equal(vtk_to_numpy(data.GetArray("damage")), folder.points.damage(frame))


def test_a_frame_becomes_a_table(run_folder, tmp_path):
    assert export(run_folder, "csv", 0, tmp_path / "out") == 0
    with (tmp_path / "out" / "points.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    folder = open_run(run_folder)
    found = np.array([[float(row[f"displacement_{axis}"]) for axis in "xyz"] for row in rows])
    np.testing.assert_array_equal(found.astype("f4"), folder.points.displacement(0))
    assert (tmp_path / "out" / "nodes.csv").exists()


def test_bad_input_of_export_is_a_sentence(run_folder, tmp_path, capsys):
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "mine").write_text("")
    assert "none of pvd and csv" in refused(capsys, export, run_folder, "xlsx", -1, tmp_path / "out")
    assert "left alone" in refused(capsys, export, run_folder, "pvd", -1, tmp_path / "full")
    assert "has no frame 2: they count from 0 to 1." in refused(capsys, export, run_folder, "csv", 2, tmp_path / "out")
    assert "holds no run" in refused(capsys, export, tmp_path, "pvd", -1, tmp_path / "out")
