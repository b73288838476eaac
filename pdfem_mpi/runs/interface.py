"""The door for Python: run, resume, check and open runs from a script, on the ranks that are there.

Nothing here starts a launcher. A script that several ranks execute, ``mpirun -n 4 python script.py``, calls these
functions on all of them; every function is collective over its communicator.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.deck.toml import read_deck, write_deck
from pdfem_mpi.parallel.comm import broadcast, world
from pdfem_mpi.results.run_folder import RunFolder, read_summary
from pdfem_mpi.runs.checking import check_scene
from pdfem_mpi.runs.reporter import LineReporter, NullReporter
from pdfem_mpi.runs.restart_point import CONTINUE, RunOptions
from pdfem_mpi.runs.run import run as run_scene
from pdfem_mpi.system.exit_codes import EXIT_FINISHED, RUN_STATUS


class Unfinished(Exception):
    """A run that did not come to its end. Raised on all ranks alike.

    Attributes
    ----------
    code : int
        The exit code of the command line: 73 results cannot be written, 74 no equilibrium, 75 stopped with a
        checkpoint.
    folder : Path
        What was written before is there, and `open_run` reads it.
    """

    def __init__(self, code: int, reason: str, folder: Path):
        self.code, self.folder = code, folder
        super().__init__(f"{folder}: {RUN_STATUS.get(code, 'failed')}: {reason}")


def run(
    scene: Scene,
    folder: str | Path,
    *,
    comm: Any = None,
    overwrite: bool = False,
    resume: str = "auto",
    report: Callable[[str], None] | None = None,
) -> RunFolder:
    """Solve a scene and write its run folder; go on where an earlier start of the same run was stopped. Collective.

    Parameters
    ----------
    scene : Scene
        From `read_deck`, or made in Python.
    folder : str or Path
        The run folder; made where it is missing.
    comm : mpi4py.MPI.Intracomm, optional
        By default all ranks of the world.
    overwrite : bool
        Replace the results of another run in the folder.
    resume : "auto", "never" or the name of a checkpoint
        Start or go on; only start; go on from there.
    report : callable, optional
        Called on rank 0 with the lines that the command line would print; for example ``print``.

    Returns
    -------
    RunFolder
        Also where the body came apart before the end of the load program.

    Raises
    ------
    SceneError
        The scene cannot be simulated.
    Refused
        The folder holds another run, or its checkpoints cannot be used.
    Unfinished
        No equilibrium was found, results could not be written, or the run was asked to stop.
    """
    comm = world() if comm is None else comm
    reporter = LineReporter(report) if report else NullReporter()
    options = RunOptions(resume=resume)
    code = run_scene(scene, comm, Path(folder), write_deck(scene), overwrite, reporter, options)
    return _finished(code, Path(folder), comm)


def resume(
    folder: str | Path,
    overrides: Mapping[str, Any] | None = None,
    *,
    comm: Any = None,
    report: Callable[[str], None] | None = None,
) -> RunFolder:
    """Go on with the run of a folder from its newest sound checkpoint. Collective.

    Parameters
    ----------
    folder : str or Path
    overrides : dict, optional
        Keys of the deck that change, for example ``{"stepping.end_load_factor": 2.0}``.
    comm, report
        As in `run`.

    Raises
    ------
    DeckError, SceneError, Refused, Unfinished
    """
    comm = world() if comm is None else comm
    scene = read_deck(Path(folder) / "deck.toml", overrides or {})
    reporter = LineReporter(report) if report else NullReporter()
    options = RunOptions(resume=CONTINUE)
    code = run_scene(scene, comm, Path(folder), write_deck(scene), False, reporter, options)
    return _finished(code, Path(folder), comm)


def check(scene: Scene, *, comm: Any = None) -> dict[str, str]:
    """What a run of the scene would allocate, by name; nothing large is allocated. Collective.

    Raises
    ------
    SceneError
        The scene cannot be simulated, or does not fit into memory.
    """
    return check_scene(scene, world() if comm is None else comm)


def open_run(folder: str | Path) -> RunFolder:
    """Open the folder that a run wrote, to read its results.

    Raises
    ------
    FileNotFoundError
        The folder is not that of a run.
    """
    return RunFolder(folder)


def _finished(code: int, folder: Path, comm: Any) -> RunFolder:
    """The folder of a run that ended well."""
    if code != EXIT_FINISHED:
        summary = broadcast(comm, read_summary(folder) if comm.rank == 0 else None) or {}
        raise Unfinished(code, str(summary.get("reason") or "see run.log"), folder)
    return RunFolder(folder)
