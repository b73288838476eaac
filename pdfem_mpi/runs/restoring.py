"""Bringing a checkpoint back into a state, on any number of ranks."""

from __future__ import annotations

import contextlib
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING

import numpy as np

from pdfem_mpi.body.share import Share
from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.model.model import Model
from pdfem_mpi.model.state import FIELDS, State
from pdfem_mpi.parallel.comm import broadcast
from pdfem_mpi.peridynamics.failure import Failure
from pdfem_mpi.peridynamics.softening_failure import GONE
from pdfem_mpi.runs.tables import BROKEN, TURNED, Layout, columns_of_broken, make_layout, read_broken, read_fields
from pdfem_mpi.solvers.equilibrium import EquilibriumSolver
from pdfem_mpi.system.exit_codes import EXIT_NO_CHECKPOINT

if TYPE_CHECKING:
    from pdfem_mpi.results.checkpoint import Reader
from pdfem_mpi.runs.restart_point import Refused, RestartPoint


def restore(start: RestartPoint, share: Share, model: Model, state: State) -> np.ndarray:
    """Fill the state from a checkpoint. Collective.

    Parameters
    ----------
    state : State
        Overwritten, but for the bounds: they belong to the solver as well, which is made with new ones.

    Returns
    -------
    int64, shape (n, 2 or 3)
        Broken bonds with an end in a cell of this rank, with their teeth where bonds soften.

    Raises
    ------
    OSError
        On all ranks.
    Refused
        Its tables are not those of the scene.
    """
    saved = start.header["state"]
    state.step, state.load_factor = saved["step"], saved["load_factor"]
    state.iteration, state.spent = saved["iteration"], saved["spent"]
    state.program = dict(saved["program"])
    state.began = perf_counter() - saved["seconds"]
    for name in saved.get("fields", [entry.name for entry in FIELDS]):  # all, before they were named
        state.add(name)
    layout = make_layout(share, columns_of_broken(model))
    with _reader(start.path, model.comm) as reader:
        fault = broadcast(model.comm, _shape_fault(layout, state, reader) if reader else None)
        if fault:
            raise Refused(EXIT_NO_CHECKPOINT, f"{start.path}: {fault}. Start again with --overwrite.")
        read_fields(model, layout, state, reader)
        return _as_wanted(read_broken(share, model, reader, start.header["schema"]), layout.columns)


def read_turned(start: RestartPoint, scene: Scene, comm) -> np.ndarray | None:
    """The cells that a run had turned into bonds by itself, int64; None where the deck says which are. Collective.

    Raises
    ------
    Refused
        On all ranks: the file does not say.
    """
    if not start.path or not scene.is_adaptive:
        return None
    found = None
    with _reader(start.path, comm) as reader:
        if reader and reader.shape(TURNED):
            found = reader.read_rows(TURNED, 0, reader.rows(TURNED))[:, 0].astype(np.int64)
    found = broadcast(comm, found)
    if found is None:
        raise Refused(EXIT_NO_CHECKPOINT, f"{start.path} has no table {TURNED}. Start again with --overwrite.")
    return found


def _shape_fault(layout: Layout, state: State, reader: Reader) -> str | None:
    """Which table of a checkpoint has not the rows that this scene has; None if all have."""
    for name, (rows, width, _) in layout.tables(0, False, state.fields).items():
        if name != BROKEN and reader.shape(name) != (rows, width):
            return f"its table {name} has shape {reader.shape(name)}, and the scene needs {(rows, width)}"
    return None


def _as_wanted(broken: np.ndarray, columns: int) -> np.ndarray:
    """Broken bonds as the scene books them: those of a brittle run are gone where bonds soften now."""
    if broken.shape[1] < columns:
        return np.column_stack([broken, np.full(len(broken), GONE)])
    return broken[:, :columns]


def restore_late(
    start: RestartPoint, pairs: np.ndarray, state: State, failure: Failure | None, solve: EquilibriumSolver
) -> None:
    """Set the bounds, break the checkpoint's bonds, and let the solver know. Collective.

    The solver was made for the intact body with new bounds, as in the run that broke them one after the other.

    Parameters
    ----------
    pairs : int64, shape (n, 2)
        From `restore`.

    Raises
    ------
    Refused
        They are not bonds of this scene.
    """
    state.bounds.fill(start.header["state"]["bounds"])
    if failure is None:
        return
    books = start.header["failure"]
    try:
        model, total = solve.forces.model, start.header["broken_bonds"]
        failure.restore(model.comm, model.points, model.bonds, pairs, np.array(books["dissipated"]), total)
    except ValueError as error:
        raise Refused(EXIT_NO_CHECKPOINT, f"{start.path}: {error}. Start again with --overwrite.") from None
    failure.last_extent = np.array(books["last_extent"])
    broken = failure.take()
    if start.header["broken_bonds"]:
        solve.update_after_breaks(broken)


def _reader(path: Path, comm):
    if comm.rank > 0:
        return contextlib.nullcontext()
    from pdfem_mpi.results.checkpoint import open_checkpoint

    return open_checkpoint(path)
