"""What equal bits rest on beside the deck."""

from __future__ import annotations

import hashlib
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pdfem_mpi import __version__
from pdfem_mpi.system.launcher import cpu_name

if TYPE_CHECKING:
    pass


def environment() -> dict[str, Any]:
    """What equal bits rest on beside the deck."""
    total = hashlib.sha256()
    package = Path(__file__).parents[1]
    for file in sorted(package.rglob("*.py")):
        total.update(f"{file.relative_to(package)}\n".encode() + file.read_bytes())
    return {
        "versions": {"pdfem_mpi": __version__, "numpy": np.__version__, "numba": sys.modules["numba"].__version__},
        "cpu": cpu_name(),
        "code_sha256": total.hexdigest(),
    }
