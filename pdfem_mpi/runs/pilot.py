"""Where a run on coarser cells broke: what regions that are found begin with, beside what elements foretell."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from pdfem_mpi.body.meshing import make_mesh
from pdfem_mpi.body.share import Share
from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.deck.table import SceneError, show
from pdfem_mpi.deck.toml import read_deck
from pdfem_mpi.parallel.comm import broadcast

#: Names in the run folder of the pilot.
DECK, CHECKPOINTS = "deck.toml", "checkpoints"


def broken_places(scene: Scene, share: Share) -> tuple[np.ndarray, float]:
    """Centres of the cells at the ends of the pilot's broken bonds, and the distance from them that counts. Collective.

    Parameters
    ----------
    share : Share
        Of the body that the places are for.

    Returns
    -------
    float64, shape (n, 3), dimension length
    float, dimension length

    Raises
    ------
    SceneError
        On all ranks: no run, one in which nothing broke, or one of another body.
    """
    comm, found, messages = share.comm, None, []
    if comm.rank == 0:
        try:
            found = _read(scene, np.array([share.lower, share.upper]) * share.units.length + share.units.origin)
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


def _read(scene: Scene, box: np.ndarray) -> tuple[np.ndarray, float]:
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
    edge = mesh.average_edge if mesh_spacing(pilot) is None else mesh_spacing(pilot)
    if problem := _other_units(pilot, scene) or _other_body(np.array([mesh.lower, mesh.upper]), box, edge):
        raise SceneError([f"adaptive.pilot = {folder} {problem}"])
    with open_checkpoint(max(kept)[1]) as reader:
        rows = reader.rows("broken")
        pairs = reader.read_rows("broken", 0, rows)[:, :2].astype(np.int64)
    if not len(pairs):
        raise SceneError([f"adaptive.pilot = {folder} broke no bond. Run it to its end, or remove the key."])
    cells = np.unique(pairs // 8 % len(mesh.cells))
    distance = settings.pilot_distance
    if distance is None:
        distance = (settings.reach + 1.0) * pilot.peridynamics.lengths(edge)[0]
    return mesh.centroids[cells], distance


def _other_units(pilot: Scene, scene: Scene) -> str | None:
    """What is wrong with the names of the units, where both decks have them."""
    for what in ("length", "force"):
        then, now = getattr(pilot.units, what), getattr(scene.units, what)
        if then and now and then != now:
            return f"has units.{what} = {show(then)}, and this deck {show(now)}. Give a run in the same units."
    return None


def _other_body(then: np.ndarray, now: np.ndarray, edge: float) -> str | None:
    """What is wrong with the corners of a body, float64, shape (2, 3), which may differ by an edge of a cell."""
    if np.abs(then - now).max() <= edge:
        return None
    sides = [" x ".join(f"[{a:.6g}, {b:.6g}]" for a, b in box.T) for box in (then, now)]
    return f"is of another body, in {sides[0]}, and that of this deck lies in {sides[1]}. Give a run of the same body."


def mesh_spacing(scene: Scene) -> float | None:
    """Edge of the cells as the deck gives it."""
    return getattr(scene.mesh, "spacing", None)
