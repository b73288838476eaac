"""Start-up before MPI and numba exist: launcher or not, ``mpirun``, threads, compile cache.

Nothing here imports mpi4py, numpy or numba: the decisions have to be made, and the environment set, before.
"""

from __future__ import annotations

import atexit
import os
import platform
import re
import shutil
import subprocess
import sys
from collections.abc import MutableMapping
from pathlib import Path
from typing import NamedTuple

import platformdirs

from pdfem_mpi import __version__
from pdfem_mpi.system.private_folders import make_fresh, make_private

# What the launchers' ranks find in their environment. Not SLURM_NTASKS: the batch shell has it too.
LAUNCHER_VARIABLES = ("PMI_SIZE", "OMPI_COMM_WORLD_SIZE", "PMIX_RANK", "SLURM_STEP_NUM_TASKS")
RANK_VARIABLES = ("PMI_RANK", "OMPI_COMM_WORLD_RANK", "PMIX_RANK", "SLURM_PROCID")
NODE_COUNT_VARIABLES = ("SLURM_JOB_NUM_NODES", "SLURM_NNODES", "PBS_NUM_NODES", "LSB_DJOB_NUMPROC")
THREAD_VARIABLES = (
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "NUMBA_NUM_THREADS",
)

Environment = MutableMapping[str, str]


class LaunchError(Exception):
    """The ranks cannot be started; one plain sentence with the remedy."""


class Launch(NamedTuple):
    """A command that starts the ranks, what it adds to the environment, and a line that says so."""

    command: list[str]
    additions: dict[str, str]
    line: str


def launcher_variable(environ: Environment = os.environ) -> str | None:
    """Return the variable by which a launcher is recognised, or None outside of one.

    An interactive Slurm shell may be a step of one task itself; it is not a launcher that started ranks.
    """
    for name in LAUNCHER_VARIABLES:
        value = environ.get(name)
        if value is not None and not (name == "SLURM_STEP_NUM_TASKS" and value.strip() == "1"):
            return name
    return None


def rank_by_launcher(environ: Environment = os.environ) -> int:
    """Return this process' rank by the launcher's variable, 0 outside of one; for use before MPI starts."""
    if launcher_variable(environ) is not None:
        for name in RANK_VARIABLES:
            if environ.get(name, "").isdigit():
                return int(environ[name])
    return 0


def prepare_environment(environ: Environment = os.environ) -> str | None:
    """Set one thread per rank and the compile cache, where the user has not; before numpy and numba load.

    Unset, every rank would start as many threads as there are cores.

    Returns
    -------
    str or None
        A sentence where the user's cache folder does not serve and kernels are compiled into one for this start.
    """
    for name in THREAD_VARIABLES:
        environ.setdefault(name, "1")
    if environ.get("NUMBA_CACHE_DIR"):
        return None
    folder, reason = compile_cache()
    environ["NUMBA_CACHE_DIR"] = str(folder)
    return reason


def slow_processor(environ: Environment = os.environ) -> str | None:
    """Return a sentence where kernels have no fused multiply-adds of four lanes: they call the C library for each.

    What numba is told to compile for counts, else what the system says of the processor.
    """
    if features := environ.get("NUMBA_CPU_FEATURES"):
        has = {word[1:] for word in features.split(",") if word.startswith("+")}
    elif environ.get("NUMBA_CPU_NAME"):
        return None
    else:
        match = re.search(r"^flags\s*:\s*(.+)$", _cpuinfo(), re.MULTILINE)
        if match is None:
            return None  # of another kind than x86, or not Linux
        has = set(match.group(1).split())
    lacking = [name for name in ("avx2", "fma") if name not in has]
    if not lacking:
        return None
    return (
        f"this processor has no {' and no '.join(lacking)}: results are as exact, their last digits may be others, and "
        "runs take many times as long. Use one of 2013 or later."
    )


def compile_cache() -> tuple[Path, str | None]:
    """Return a folder for compiled kernels that nobody else can write, and a sentence if it is not the usual one.

    The usual one is named by this version and the CPU: homes are shared between machines, and code compiled for one
    CPU may not run on another. Where it cannot be written, or others could have put code into it, a fresh folder with
    a name that nobody can guess serves, and goes when this process ends.

    Raises
    ------
    LaunchError
        There is no safe place for that either.
    """
    usual = Path(platformdirs.user_cache_path("pdfem_mpi", appauthor=False)) / f"{__version__}-{cpu_slug()}"
    usual = Path(os.path.realpath(usual))
    reason = make_private(usual)
    if reason is None:
        return usual, None
    fresh = make_fresh()
    if fresh is None:
        raise LaunchError(
            f"the cache of compiled kernels, {usual}, {reason}, and no temporary folder is safe from other users. "
            "Give a folder of your own with NUMBA_CACHE_DIR."
        )
    atexit.register(shutil.rmtree, fresh, ignore_errors=True)
    return fresh, (
        f"the cache of compiled kernels, {usual}, {reason}. This start compiles into {fresh} (up to 30 s); "
        "give a folder of your own with NUMBA_CACHE_DIR."
    )


def _cpuinfo() -> str:
    try:
        return Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace")
    except OSError:
        return ""


def cpu_name() -> str:
    """Return the model name of the CPU."""
    match = re.search(r"^model name\s*:\s*(.+)$", _cpuinfo(), re.MULTILINE)
    return match.group(1).strip() if match else platform.processor() or platform.machine() or "unknown"


def cpu_slug() -> str:
    """Return the CPU's name as part of a folder's name."""
    return re.sub(r"[^a-z0-9]+", "-", cpu_name().lower()).strip("-")[:60]


def allowed_cores() -> int:
    """Return the number of cores this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def find_mpirun() -> str | None:
    """Return ``mpirun`` from the directory of the running Python, then from PATH.

    The one beside Python belongs to the library that mpi4py loads; another one would start N worlds of one
    rank. The path of Python is not resolved: in a virtual environment it is a link to another place.
    """
    beside = Path(sys.executable).parent
    for name in ("mpirun", "mpiexec"):
        if os.access(beside / name, os.X_OK):
            return str(beside / name)
    return shutil.which("mpirun") or shutil.which("mpiexec")


def is_open_mpi(mpirun: str) -> bool:
    """Return whether ``mpirun --version`` names Open MPI."""
    try:
        answer = subprocess.run([mpirun, "--version"], capture_output=True, text=True, timeout=20, check=False)
    except (OSError, subprocess.SubprocessError):
        return False
    return bool(re.search(r"open\s?mpi|open-rte|prte", answer.stdout + answer.stderr, re.IGNORECASE))


def on_one_node(environ: Environment = os.environ) -> bool:
    """Return whether no batch system gives more than one node."""
    return all(environ.get(name, "1").strip() in ("", "1") for name in NODE_COUNT_VARIABLES)


def open_mpi_needs(ranks: int, environ: Environment = os.environ, is_root: bool | None = None) -> dict[str, str]:
    """Return the variables Open MPI needs that the user has not set.

    Root has to be allowed twice; more ranks than cores have to be allowed; on one node probing for network
    fabrics takes 1 s and is of no use (on a cluster it is, and left alone).
    """
    is_root = os.geteuid() == 0 if is_root is None else is_root
    needs = {}
    if is_root:
        needs |= {"OMPI_ALLOW_RUN_AS_ROOT": "1", "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1"}
    if ranks > allowed_cores():
        needs["PRTE_MCA_rmaps_default_mapping_policy"] = ":oversubscribe"
    if on_one_node(environ):
        needs |= {"OMPI_MCA_btl": "^ofi", "OMPI_MCA_mtl": "^ofi"}
    return {name: value for name, value in needs.items() if name not in environ}


def mpirun_command(ranks: int) -> tuple[list[str], dict[str, str]]:
    """Return the opening of a command that starts ranks, and what it adds to the environment.

    Raises
    ------
    LaunchError
        If there is no ``mpirun``.
    """
    mpirun = find_mpirun()
    if mpirun is None:
        raise LaunchError(
            f"-n {ranks}: there is no mpirun beside {sys.executable} and none in PATH. Install one with "
            "pip install mpich, load this machine's MPI module, or leave -n away (one rank)."
        )
    command = [mpirun, "-n", str(ranks)]
    if not is_open_mpi(mpirun):
        return command, {}
    if ranks != allowed_cores():
        command += ["--bind-to", "none"]  # else two jobs of one rank share core 0
    return command, open_mpi_needs(ranks)


def plan_launch(ranks: int, arguments: list[str]) -> Launch:
    """Return how ``pdfem ARGUMENTS`` is started on several ranks.

    Raises
    ------
    LaunchError
        If there is no ``mpirun``.
    """
    opening, additions = mpirun_command(ranks)
    script = Path(sys.argv[0])
    program = [str(script)] if script.name == "pdfem" and script.is_file() else ["-m", "pdfem_mpi"]
    line = "pdfem: " + " ".join(f"{name}={value}" for name, value in additions.items())
    return Launch(
        [*opening, sys.executable, *program, *arguments],
        additions,
        f"{line}{' ' if additions else ''}{' '.join(opening)} pdfem {' '.join(arguments)}",
    )


def become(launch: Launch) -> None:
    """Replace this process by ``mpirun``, so that a signal to its pid reaches the launcher. Never returns.

    Raises
    ------
    LaunchError
        If it cannot be executed.
    """
    os.environ.update(launch.additions)
    try:
        os.execv(launch.command[0], launch.command)
    except OSError as error:
        raise LaunchError(
            f"{launch.command[0]} cannot be executed: {error.strerror}. Repair the MPI runtime, "
            "for example with pip install --force-reinstall mpich."
        ) from None
