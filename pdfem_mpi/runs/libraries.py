"""Libraries that rank 0 alone needs, loaded before memory is measured: what is taken from then on is the body's."""

from __future__ import annotations

from pdfem_mpi.deck.scene import Scene


def load_libraries(scene: Scene, comm) -> None:
    """Load what a run of the scene will need on rank 0: HDF5 for its checkpoints, sparse matrices for the last grid."""
    if comm.rank > 0:
        return
    import pdfem_mpi.results.checkpoint  # noqa: F401

    if scene.has_cycle:
        import scipy.sparse  # noqa: F401
