"""Libraries that a run needs, loaded before memory is measured: what is taken from then on is the body's."""

from __future__ import annotations

import numpy as np

from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.parallel.comm import lay_out_tables

#: What numpy loads only when it is asked for by name: translators of Fortran, and helpers of tests.
LAZY_PARTS = ("f2py", "testing")


def load_libraries(scene: Scene, comm) -> None:
    """Let MPI lay out its tables; on rank 0 load HDF5 for checkpoints, and sparse matrices for the last grid."""
    lay_out_tables(comm)
    if comm.rank > 0:
        return
    import pdfem_mpi.results.checkpoint  # noqa: F401

    if scene.has_cycle:
        load_sparse_matrices()


def load_sparse_matrices() -> None:
    """Load them in half of the time: scipy copies all names of numpy, and thereby asks for parts that nobody needs."""
    asleep = [name for name in LAZY_PARTS if name not in vars(np)]
    for name in asleep:
        setattr(np, name, None)
    try:
        import scipy.sparse  # noqa: F401
    finally:
        for name in asleep:
            if vars(np).get(name, np) is None:  # else it was loaded meanwhile
                delattr(np, name)
