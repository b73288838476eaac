"""What several tests share: assertions agreed by all ranks, and the command line as a subprocess."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
# what a launcher or a started MPI leaves in the environment; a launcher started by a test must not see it
LAUNCHER_PREFIXES = (
    "PMI",
    "OMPI_COMM",
    "OMPI_UNIVERSE",
    "PRTE_",
    "HYD",
    "MPI_LOCAL",
    "SLURM_",
    "FLUX_",
    "PALS_",
)


def assert_all(comm, condition, message=""):
    """Fail on all ranks of ``comm`` if the condition is false on any of them. Collective.

    A plain assert that fails on one rank leaves the others waiting in the next collective call.
    """
    failing = [rank for rank, holds in enumerate(comm.allgather(bool(condition))) if not holds]
    assert not failing, f"{message or 'false'} (on ranks {failing} of {comm.size})"


def outside_launcher(**additions):
    """Return this process' environment without the traces of a launcher."""
    kept = {name: value for name, value in os.environ.items() if not name.startswith(LAUNCHER_PREFIXES)}
    return kept | {"PYTHONPATH": str(ROOT)} | additions


def run_python(*arguments, cwd=ROOT, timeout=60, **additions):
    """Run Python outside of any launcher; return the completed process with its output as text."""
    return subprocess.run(
        [sys.executable, *map(str, arguments)],
        cwd=cwd,
        env=outside_launcher(**additions),
        capture_output=True,
        text=True,
        timeout=timeout,
        check=False,
    )


def run_pdfem(*arguments, **options):
    """Run ``pdfem`` with some arguments as a user would."""
    return run_python("-m", "pdfem_mpi", *arguments, **options)
