"""Where a run on coarser cells broke: what regions that are found begin with, beside what elements foretell."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from pdfem_mpi.body.meshing import make_mesh
from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.deck.table import SceneError
from pdfem_mpi.deck.toml import read_deck
from pdfem_mpi.parallel.comm import broadcast

#: Names in the run folder of the pilot.
DECK, CHECKPOINTS = "deck.toml", "checkpoints"


def broken_places(scene: Scene, comm) -> tuple[np.ndarray, float]:
    """Centres of the cells at the ends of the pilot's broken bonds, and the distance from them that counts. Collective.

    Returns
    -------
    float64, shape (n, 3), dimension length
    float, dimension length

    Raises
    ------
    SceneError
        On all ranks: no run, or one in which nothing broke.
    """
    found, messages = None, []
    if comm.rank == 0:
        try:
            found = _read(scene)
        except SceneError as error:
            messages = error.messages
        except OSError as error:
            messages = [
                f"adaptive.pilot = {scene.adaptive.pilot} has a checkpoint that cannot be read ({error}). "
                "Run it again, or remove the key."
            ]
    if messages := broadcast(comm, messages):
        raise SceneError(messages)
    return broadcast(comm, found)


def _read(scene: Scene) -> tuple[np.ndarray, float]:
    from pdfem_mpi.results.checkpoint import open_checkpoint
    from pdfem_mpi.results.checkpoint_files import list_checkpoints

    settings, folder = scene.adaptive, Path(scene.adaptive.pilot)
    if not (folder / DECK).is_file():
        raise SceneError([f"adaptive.pilot = {folder} is no run folder: it has no {DECK}. Give that of a run."])
    kept = list_checkpoints(folder / CHECKPOINTS)
    if not kept:
        raise SceneError([f"adaptive.pilot = {folder} has no checkpoint. Run it to its end."])
    pilot = read_deck(folder / DECK)
    mesh = make_mesh(pilot)
    with open_checkpoint(max(kept)[1]) as reader:
        rows = reader.rows("broken")
        pairs = reader.read_rows("broken", 0, rows)[:, :2].astype(np.int64)
    if not len(pairs):
        raise SceneError([f"adaptive.pilot = {folder} broke no bond. Run it to its end, or remove the key."])
    cells = np.unique(pairs // 8 % len(mesh.cells))
    distance = settings.pilot_distance
    if distance is None:
        edge = mesh.average_edge if mesh_spacing(pilot) is None else mesh_spacing(pilot)
        distance = (settings.reach + 1.0) * pilot.peridynamics.lengths(edge)[0]
    return mesh.centroids[cells], distance


def mesh_spacing(scene: Scene) -> float | None:
    """Edge of the cells as the deck gives it."""
    return getattr(scene.mesh, "spacing", None)
