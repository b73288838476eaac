"""All that studies use of the package beside its public names; each leaves this list when a public name replaces it."""

from __future__ import annotations

from pdfem_mpi.system.launcher import mpirun_command, prepare_environment

__all__ = ["mpirun_command", "prepare_environment"]
