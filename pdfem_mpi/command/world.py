"""The ranks of a command: MPI started and looked at, and the deck read on all of them alike."""

from __future__ import annotations

import faulthandler
import math
import os
import signal
import sys
from pathlib import Path
from typing import Any

from pdfem_mpi.command.console import fail, print_problems
from pdfem_mpi.command.launching import start_ranks
from pdfem_mpi.deck.meshes import FileMesh, PlateWithHoleMesh
from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.deck.table import DeckError
from pdfem_mpi.deck.toml import parse_deck, read_deck, read_text
from pdfem_mpi.system import launcher as launch
from pdfem_mpi.system.process_limits import shared_memory_problem


def become_ranks(deck: Path, overrides: list[str], ranks: int | None) -> None:
    """Become a launcher of so many ranks, each of which comes here again; do nothing for one, or under a launcher."""
    if launch.launcher_variable() is None and ranks is not None and ranks > 1:
        try:
            _refuse_ranks(read_deck(deck, overrides), deck, ranks)  # problems show before any rank starts
            start_ranks(ranks)
        except DeckError as error:
            raise fail(error.messages, 0) from None
        except launch.LaunchError as error:
            raise fail([f"pdfem: {error}"], 0) from None


def _refuse_ranks(scene: Scene, deck: Path, ranks: int) -> None:
    """Refuse more ranks than there are cells where the deck tells, before as many processes start.

    Raises
    ------
    DeckError
    """
    if isinstance(scene.mesh, FileMesh | PlateWithHoleMesh) or ranks <= (most := math.prod(scene.mesh.n_cells)):
        return  # of a file, a plate with a hole, or a body with something taken out, the ranks find out
    from pdfem_mpi.body.counts import too_many_ranks

    raise DeckError([f"{deck}: {too_many_ranks(ranks, most)}"])


def start_world(ranks: int | None) -> Any:
    """Initialise MPI, guard against a launcher of another library, and return the communicator."""
    note = launch.prepare_environment()
    if problem := _shared_memory_problem():
        raise fail([f"pdfem: {problem}"], launch.rank_by_launcher())
    from pdfem_mpi.parallel import comm as parallel
    from pdfem_mpi.parallel.watchdog import patience

    try:
        if launch.launcher_variable() is not None:
            # the launcher does not notice a rank that leaves before MPI has started, and the others would wait for ever
            faulthandler.dump_traceback_later(patience(), exit=True)
        comm = parallel.world()
        faulthandler.cancel_dump_traceback_later()
    except (ImportError, RuntimeError) as error:
        reason = str(error).strip().splitlines() or ["no reason given"]
        raise fail(
            [
                f"pdfem: no MPI library could be loaded ({reason[0]}). Install one with "
                "pip install mpich, or set MPI4PY_LIBMPI to the path of libmpi.so."
            ],
            launch.rank_by_launcher(),
        ) from None
    sys.excepthook = sys.__excepthook__  # typer's, set when the app was called
    parallel.install_abort_hook(comm)
    mismatch = parallel.check_launcher(comm)
    if mismatch is not None:
        raise fail([f"pdfem: {mismatch}"], launch.rank_by_launcher())
    if ranks is not None and ranks != comm.size:
        raise fail(
            [
                f"pdfem: -n {ranks} is not the {comm.size} ranks that the launcher started. "
                "Leave -n away, or start pdfem without a launcher."
            ],
            comm.rank,
        )
    # before numba loads: a rank whose own look at the cache went otherwise compiles where the others of its node do
    os.environ["NUMBA_CACHE_DIR"] = parallel.same_on_node(comm, os.environ["NUMBA_CACHE_DIR"])
    if notes := [text for text in (note, launch.slow_processor()) if text]:
        print_problems([f"pdfem: note: {text}" for text in notes], comm.rank)
    return comm


def _shared_memory_problem() -> str | None:
    """Too little of it ends MPI's start in a bus error; Open MPI makes do with other places."""
    variable = launch.launcher_variable()
    if variable is None:
        return shared_memory_problem(1)
    here = os.environ.get("MPI_LOCALNRANKS", "")  # MPICH's launcher tells
    return shared_memory_problem(int(here), started=True) if here.isdigit() and int(here) else None


def let_interrupts_end_all(comm: Any) -> None:
    """Let Ctrl-C end a rank by the signal itself: one that left in an orderly way would wait for the others."""
    if comm.size > 1 and signal.getsignal(signal.SIGINT) != signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.SIG_DFL)


def read_scene(deck: Path, overrides: list[str], comm: Any) -> Scene:
    """Return the scene on every rank: rank 0 reads, the text travels, all validate the same. Collective."""
    from pdfem_mpi.parallel import comm as parallel

    text, messages = None, []
    if comm.rank == 0:
        try:
            text = read_text(deck)
        except DeckError as error:
            messages = error.messages
    text, messages = parallel.broadcast(comm, (text, messages))
    if not messages:
        try:
            return parse_deck(text, str(deck), overrides)
        except DeckError as error:
            messages = error.messages
    raise fail(messages, comm.rank)
