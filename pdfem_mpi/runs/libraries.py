"""Libraries that a run needs, loaded before memory is measured: what is taken from then on is the body's."""

from __future__ import annotations

from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.parallel.comm import lay_out_tables


def load_libraries(scene: Scene, comm) -> None:
    """Let MPI lay out its tables; on rank 0 load HDF5 for checkpoints, and sparse matrices for the last grid."""
    lay_out_tables(comm)
    if comm.rank > 0:
        return
    import pdfem_mpi.results.checkpoint  # noqa: F401

    if scene.has_cycle:
        import scipy.sparse  # noqa: F401
