"""Start-up decisions: launcher or not, which mpirun, what the environment gets."""

import os
import sys
from pathlib import Path

import pytest

from pdfem_mpi import __version__
from pdfem_mpi.system import launcher as launch


def executable(folder, name, text="#!/bin/sh\nexit 0\n"):
    path = folder / name
    path.write_text(text)
    path.chmod(0o755)
    return path


def mpirun_of(folder, version):
    return executable(folder, "mpirun", f"#!/bin/sh\necho '{version}'\n")


@pytest.fixture
def beside_python(tmp_path, monkeypatch):
    """A folder that seems to hold the running Python; PATH is another, empty one."""
    beside, path = tmp_path / "bin", tmp_path / "path"
    beside.mkdir()
    path.mkdir()
    monkeypatch.setattr(sys, "executable", str(beside / "python"))
    monkeypatch.setenv("PATH", f"{path}:/bin:/nowhere")
    monkeypatch.setattr(launch.shutil, "which", lambda name: str(path / name) if (path / name).exists() else None)
    return beside, path


@pytest.mark.parametrize(
    ("environ", "variable"),
    [
        ({}, None),
        ({"PMI_SIZE": "2"}, "PMI_SIZE"),
        ({"PMI_SIZE": "1"}, "PMI_SIZE"),
        ({"OMPI_COMM_WORLD_SIZE": "4"}, "OMPI_COMM_WORLD_SIZE"),
        ({"PMIX_RANK": "0"}, "PMIX_RANK"),
        ({"SLURM_STEP_NUM_TASKS": "8"}, "SLURM_STEP_NUM_TASKS"),
        ({"SLURM_STEP_NUM_TASKS": "1"}, None),  # an interactive shell is a step of one task
        ({"SLURM_NTASKS": "8"}, None),  # the batch shell has it too
    ],
)
def test_launcher_is_told_by_its_variables(environ, variable):
    assert launch.launcher_variable(environ) == variable


@pytest.mark.parametrize(
    ("environ", "rank"),
    [
        ({}, 0),
        ({"PMI_RANK": "3"}, 0),  # no launcher: left over from somewhere
        ({"PMI_SIZE": "4", "PMI_RANK": "3"}, 3),
        ({"OMPI_COMM_WORLD_SIZE": "4", "OMPI_COMM_WORLD_RANK": "2"}, 2),
        ({"SLURM_STEP_NUM_TASKS": "4", "SLURM_PROCID": "1"}, 1),
    ],
)
def test_rank_before_mpi_starts(environ, rank):
    assert launch.rank_by_launcher(environ) == rank


def test_every_rank_gets_one_thread_and_the_users_value_wins():
    environ = {"OMP_NUM_THREADS": "7", "NUMBA_CACHE_DIR": "/mine"}
    launch.prepare_environment(environ)
    assert environ["OMP_NUM_THREADS"] == "7"
    assert environ["OPENBLAS_NUM_THREADS"] == environ["NUMBA_NUM_THREADS"] == "1"
    assert environ["NUMBA_CACHE_DIR"] == "/mine"


def test_compile_cache_is_named_by_version_and_cpu(tmp_path, monkeypatch):
    monkeypatch.setattr(launch.platformdirs, "user_cache_path", lambda *args, **options: tmp_path / "cache")
    environ = {}
    launch.prepare_environment(environ)
    assert environ["NUMBA_CACHE_DIR"] == str(tmp_path / "cache" / f"{__version__}-{launch.cpu_slug()}")
    assert Path(environ["NUMBA_CACHE_DIR"]).is_dir()


def test_compile_cache_that_cannot_be_made_has_a_substitute(tmp_path, monkeypatch):
    """numba refuses to import kernels with a cache folder that it cannot write."""
    (tmp_path / "file").touch()
    (tmp_path / "tmp").mkdir()
    monkeypatch.setattr(launch.platformdirs, "user_cache_path", lambda *args, **options: tmp_path / "file")
    monkeypatch.setattr("tempfile.gettempdir", lambda: str(tmp_path / "tmp"))
    folder, reason = launch.compile_cache()
    assert folder.is_dir() and folder.parent == tmp_path / "tmp"
    assert "is not a folder" in reason and "NUMBA_CACHE_DIR" in reason


def test_no_safe_place_for_the_compile_cache_is_a_sentence(monkeypatch):
    monkeypatch.setattr(launch, "make_private", lambda folder: "belongs to eve")
    monkeypatch.setattr(launch, "make_fresh", lambda: None)
    with pytest.raises(launch.LaunchError, match=r"belongs to eve.*NUMBA_CACHE_DIR"):
        launch.prepare_environment({})


def test_cpu_slug_is_a_plain_folder_name():
    slug = launch.cpu_slug()
    assert slug and set(slug) <= set("abcdefghijklmnopqrstuvwxyz0123456789-")


def test_mpirun_beside_python_comes_before_path(beside_python):
    beside, path = beside_python
    on_path = executable(path, "mpirun")
    assert launch.find_mpirun() == str(on_path)
    assert launch.find_mpirun() != str(executable(beside, "mpirun"))
    assert launch.find_mpirun() == str(beside / "mpirun")


def test_mpiexec_serves_where_mpirun_is_missing(beside_python):
    beside, _ = beside_python
    assert launch.find_mpirun() is None
    mpiexec = executable(beside, "mpiexec")
    assert launch.find_mpirun() == str(mpiexec)


def test_no_mpirun_is_a_sentence_with_a_remedy(beside_python):
    with pytest.raises(launch.LaunchError, match=r"-n 2: there is no mpirun .* pip install mpich"):
        launch.mpirun_command(2)


def test_mpich_needs_nothing(beside_python):
    beside, _ = beside_python
    mpirun_of(beside, "HYDRA build details: Version: 5.0.2")
    assert launch.mpirun_command(3) == ([str(beside / "mpirun"), "-n", "3"], {})


@pytest.mark.parametrize("version", ["mpirun (Open MPI) 5.0.11", "prterun (PRRTE) 3.0.13"])
def test_open_mpi_is_recognized(beside_python, version):
    beside, _ = beside_python
    assert launch.is_open_mpi(str(mpirun_of(beside, version)))


def test_open_mpi_binds_only_where_ranks_fill_the_node(beside_python, monkeypatch):
    beside, _ = beside_python
    mpirun_of(beside, "mpirun (Open MPI) 5.0.11")
    monkeypatch.setattr(launch, "allowed_cores", lambda: 4)
    assert launch.mpirun_command(2)[0][-2:] == ["--bind-to", "none"]
    assert "--bind-to" not in launch.mpirun_command(4)[0]


ROOT = {"OMPI_ALLOW_RUN_AS_ROOT": "1", "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1"}
CROWDED = {"PRTE_MCA_rmaps_default_mapping_policy": ":oversubscribe"}
NO_FABRIC = {"OMPI_MCA_btl": "^ofi", "OMPI_MCA_mtl": "^ofi"}


@pytest.mark.parametrize(
    ("ranks", "environ", "is_root", "needs"),
    [
        (2, {}, False, NO_FABRIC),
        (2, {}, True, ROOT | NO_FABRIC),
        (3, {}, False, CROWDED | NO_FABRIC),
        (2, {"SLURM_JOB_NUM_NODES": "1"}, False, NO_FABRIC),
        (2, {"SLURM_JOB_NUM_NODES": "4"}, False, {}),  # its fabric is needed there
        (2, {"OMPI_MCA_btl": "tcp"}, False, {"OMPI_MCA_mtl": "^ofi"}),  # the user's value wins
    ],
)
def test_open_mpi_gets_what_it_needs(monkeypatch, ranks, environ, is_root, needs):
    monkeypatch.setattr(launch, "allowed_cores", lambda: 2)
    assert launch.open_mpi_needs(ranks, environ, is_root) == needs


def test_launch_runs_this_python_with_the_same_arguments(beside_python, monkeypatch):
    beside, _ = beside_python
    mpirun_of(beside, "HYDRA")
    monkeypatch.setattr(sys, "argv", ["/somewhere/__main__.py"])
    plan = launch.plan_launch(2, ["run", "a b.toml", "-n", "2"])
    expected = [str(beside / "mpirun"), "-n", "2", str(beside / "python"), "-m", "pdfem_mpi"]
    assert plan.command == [*expected, "run", "a b.toml", "-n", "2"]
    assert "mpirun -n 2" in plan.line


def test_launch_of_the_console_script_does_not_depend_on_the_working_folder(beside_python, monkeypatch):
    """``python -m`` would look into the working folder first."""
    beside, _ = beside_python
    mpirun_of(beside, "HYDRA")
    script = executable(beside, "pdfem")
    monkeypatch.setattr(sys, "argv", [str(script)])
    assert launch.plan_launch(2, ["doctor"]).command[-3:] == [str(beside / "python"), str(script), "doctor"]


def test_mpirun_that_cannot_be_executed_is_a_sentence(tmp_path, monkeypatch):
    monkeypatch.setattr(os, "environ", dict(os.environ))
    broken = tmp_path / "mpirun"
    with pytest.raises(launch.LaunchError, match="cannot be executed: No such file"):
        launch.become(launch.Launch([str(broken), "-n", "2"], {}, ""))


@pytest.mark.parametrize(
    ("cpuinfo", "environ", "told"),
    [
        ("flags\t: fpu sse2 avx avx2 fma", {}, None),
        ("flags\t: fpu sse2 avx", {}, "no avx2 and no fma"),
        ("flags\t: fpu sse2 avx avx2", {}, "no fma"),
        ("Features\t: fp asimd", {}, None),
        ("flags\t: fpu sse2 avx avx2 fma", {"NUMBA_CPU_FEATURES": "+sse2,-avx2,+avx"}, "no avx2 and no fma"),
        ("flags\t: fpu sse2", {"NUMBA_CPU_NAME": "znver3"}, None),
    ],
)
def test_a_processor_without_fused_lanes_is_told(monkeypatch, cpuinfo, environ, told):
    """Its results are right, and late."""
    monkeypatch.setattr(launch, "_cpuinfo", lambda: cpuinfo)
    found = launch.slow_processor(environ)
    assert found is None if told is None else told in found
