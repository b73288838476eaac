"""A wheel made from the source distribution holds what a run needs, and works where nothing else of this is."""

import subprocess
import sys
import sysconfig
import tarfile
import venv
import zipfile
from pathlib import Path

import pytest

from support.helpers import ROOT, outside_launcher

LINES = """
import pdfem_mpi as pdfem
folder = pdfem.run(pdfem.read_deck("bar.toml"), "out")
print(type(u := folder.nodes.displacement()).__name__, u.shape[1], pdfem.__file__)
"""
BUILD = "import setuptools.build_meta as b, sys; getattr(b, 'build_' + sys.argv[1])(sys.argv[2])"


def run(*command, cwd, **more):
    result = subprocess.run(
        [str(word) for word in command],
        cwd=cwd,
        capture_output=True,
        text=True,
        timeout=300,
        env=outside_launcher(PYTHONPATH="", **more),
        check=False,
    )
    assert result.returncode == 0, result.stderr[-2000:]
    return result.stdout


def tracked():
    """Files under version control; without it, this test has nothing to pack."""
    answer = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, check=False)
    if answer.returncode:
        pytest.skip("the tree is not a git checkout")
    return [name for name in answer.stdout.split("\0") if name and (ROOT / name).is_file()]


@pytest.mark.slow
def test_a_wheel_works_in_an_environment_of_its_own(tmp_path):
    source, dist = tmp_path / "source", tmp_path / "dist"
    dist.mkdir()
    for name in tracked():
        (source / name).parent.mkdir(parents=True, exist_ok=True)
        (source / name).write_bytes((ROOT / name).read_bytes())
    run(sys.executable, "-c", BUILD, "sdist", dist, cwd=source)
    (archive,) = dist.glob("*.tar.gz")
    with tarfile.open(archive) as file:
        file.extractall(tmp_path / "unpacked", filter="data")
    (unpacked,) = (tmp_path / "unpacked").iterdir()
    assert (unpacked / "CITATION.cff").is_file() and (unpacked / "jobs" / "bar_tension.toml").is_file()
    run(sys.executable, "-c", BUILD, "wheel", dist, cwd=unpacked)
    (wheel,) = dist.glob("*.whl")
    with zipfile.ZipFile(wheel) as file:
        names = file.namelist()
    assert "pdfem_mpi/command/templates/bar.toml" in names
    assert not [name for name in names if name.startswith(("tests/", "tools/", "jobs/"))]

    venv.create(tmp_path / "venv", with_pip=True)
    python = tmp_path / "venv" / "bin" / "python"
    run(python, "-m", "pip", "install", "--no-index", "--no-deps", "-q", wheel, cwd=tmp_path)
    # what it depends on is that of this environment: its folder, without the links to this tree
    version = f"python{sys.version_info.major}.{sys.version_info.minor}"
    links = tmp_path / "venv" / "lib" / version / "site-packages" / "dependencies.pth"
    links.write_text(sysconfig.get_path("purelib") + "\n")
    pdfem = tmp_path / "venv" / "bin" / "pdfem"
    assert run(pdfem, "init", "bar", cwd=tmp_path).startswith("wrote bar.toml")
    libraries = sorted(Path(sys.prefix, "lib").glob("libmpi.so*"), key=lambda path: path.stat().st_size)
    mpi = {"MPI4PY_LIBMPI": str(libraries[-1])} if libraries else {}  # a wheel's; a system's is found without
    found = run(python, "-c", LINES, cwd=tmp_path, **mpi).splitlines()[-1]
    assert found.startswith(f"ndarray 3 {tmp_path}"), found
