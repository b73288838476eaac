"""The console command ``pdfem``: commands, exit codes, and everything that is printed about failures.

Exit codes: 0 finished; 64 bad deck, command line or launcher; 65 no checkpoint that can be used; 70 internal
error; 73 results cannot be written; 74 not converged; 75 stopped with a checkpoint. Messages come from rank 0 only.

``pdfem_mpi.runs.run`` and what lies below it are imported inside the commands: numpy, numba and MPI must not load
before the environment is prepared, nor in the process that only becomes ``mpirun``.
"""

from __future__ import annotations

import os
import signal
import sys
import time
from pathlib import Path
from typing import Annotated

import typer
import typer.main

from pdfem_mpi import __version__
from pdfem_mpi.command import options
from pdfem_mpi.command.console import ConsoleReporter, fail, print_at_once, print_problems, print_table
from pdfem_mpi.command.decks import init, schema
from pdfem_mpi.command.folders import clean, export
from pdfem_mpi.command.plotting import plot
from pdfem_mpi.command.world import become_ranks, let_interrupts_end_all, read_scene, start_world
from pdfem_mpi.deck.table import DeckError, SceneError
from pdfem_mpi.deck.toml import write_deck
from pdfem_mpi.system import launcher as launch
from pdfem_mpi.system.exit_codes import (
    EXIT_FINISHED,
    EXIT_INTERNAL_ERROR,
    EXIT_INTERRUPTED,
    EXIT_NO_CHECKPOINT,
    EXIT_NOT_WRITTEN,
    EXIT_STOPPED,
    EXIT_USAGE,
)
from pdfem_mpi.system.garbage import keep_for_good, no_search_for_garbage
from pdfem_mpi.system.process_limits import shared_memory_problem
from pdfem_mpi.system.signals import Requests

# typer carries its own copy of click in newer versions; its exported exception leads to the base in all
ClickException = next(base for base in typer.BadParameter.__mro__ if base.__name__ == "ClickException")
app = typer.Typer(
    pretty_exceptions_enable=False,
    no_args_is_help=True,
)


def _print_version(asked: bool) -> None:
    if asked:
        print(f"pdfem_mpi {__version__}")
        raise typer.Exit()


@app.callback()
def pdfem(
    version: Annotated[
        bool, typer.Option("--version", help="Print the version.", callback=_print_version, is_eager=True)
    ] = False,
) -> None:
    """Quasi-static failure by peridynamics coupled to finite elements, on MPI ranks."""


def main() -> None:
    """Run the command line and exit with its code."""
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="backslashreplace")  # a title that the terminal cannot show must not end a run
    try:
        code = typer.main.get_command(app)(standalone_mode=False, prog_name="pdfem")
    except ClickException as error:
        context = getattr(error, "ctx", None)
        message = error.format_message().rstrip(".")
        hint = f" See `{context.command_path} --help`." if context is not None else ""
        if message:  # empty after the help that a bare `pdfem` prints
            print_problems([f"pdfem: {message}.{hint}"], launch.rank_by_launcher())
        code = EXIT_USAGE
    except launch.LaunchError as error:
        print_problems([f"pdfem: {error}"], launch.rank_by_launcher())
        code = EXIT_USAGE
    except typer.Abort:
        if launch.launcher_variable() is not None:
            # when one rank ends with an exit code, a launcher lets the others wait for ever in the start of MPI
            signal.signal(signal.SIGINT, signal.SIG_DFL)
            os.kill(os.getpid(), signal.SIGINT)
        code = EXIT_INTERRUPTED
    except Exception:
        # typer has replaced the hook at the call; ours, if a command has set it, ends all ranks here
        sys.excepthook(*sys.exc_info())
        sys.stderr.flush()
        code = EXIT_INTERNAL_ERROR
    sys.stdout.flush()
    sys.exit(code if isinstance(code, int) else EXIT_FINISHED)


def run(
    deck: options.DeckArgument,
    ranks: options.RanksOption = None,
    overrides: options.SetOption = None,
    out: options.OutOption = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace the results in the folder.")] = False,
    resume: Annotated[
        str, typer.Option(metavar="auto|never|FILE", help="Start or go on; only start; go on from a checkpoint.")
    ] = "auto",
    max_hours: options.MaxHoursOption = None,
    minutes: options.MinutesOption = None,
    steal_lock: options.StealOption = False,
    force: options.ForceOption = False,
) -> int:
    """Solve the case of DECK and write a run folder; go on where an earlier start of the same run was stopped."""
    folder = out or Path("runs") / deck.stem
    ways = {"resume": resume, "steal_lock": steal_lock, "force": force}
    return _run(deck, ranks, _overrides(overrides, minutes), folder, overwrite, max_hours, ways | {"deck": deck})


def resume(
    folder: options.RunFolderArgument,
    ranks: options.RanksOption = None,
    overrides: options.SetOption = None,
    max_hours: options.MaxHoursOption = None,
    minutes: options.MinutesOption = None,
    steal_lock: options.StealOption = False,
    force: options.ForceOption = False,
) -> int:
    """Go on with the run of RUNDIR from its newest sound checkpoint, on any number of ranks."""
    deck = folder / "deck.toml"
    if not deck.is_file():
        what = "there is no deck.toml in it" if folder.is_dir() else "there is no such folder"
        message = f"pdfem: {folder} holds no run: {what}. Give the folder that `pdfem run` wrote."
        print_problems([message], launch.rank_by_launcher())
        return EXIT_NO_CHECKPOINT
    ways = {"resume": "continue", "steal_lock": steal_lock, "force": force}
    return _run(deck, ranks, _overrides(overrides, minutes), folder, False, max_hours, ways)


def _overrides(overrides: list[str] | None, minutes: float | None) -> list[str]:
    return [*(overrides or []), *([] if minutes is None else [f"checkpoint.minutes={minutes}"])]


def _run(deck, ranks, overrides, folder, overwrite, max_hours, ways) -> int:
    """Start the ranks, or be one of them and run."""
    become_ranks(deck, overrides, ranks)
    end = None if max_hours is None else time.monotonic() + 3600.0 * max_hours
    requests = Requests()
    requests.install()
    comm = start_world(ranks)
    requests.comm = comm
    scene = read_scene(deck, overrides, comm)
    with no_search_for_garbage():
        from pdfem_mpi.runs.restart_point import Refused, RunOptions
        from pdfem_mpi.runs.run import run as run_scene
    keep_for_good()
    try:
        ways = RunOptions(**ways, end=end, watched=True, requests=requests)
        return run_scene(scene, comm, folder, write_deck(scene), overwrite, ConsoleReporter(scene), ways)
    except SceneError as error:
        raise fail([f"{deck}: {message}" for message in error.messages], comm.rank) from None
    except Refused as error:
        print_problems([f"pdfem: {error}"], comm.rank)
        return error.code
    finally:
        requests.come_too_late()


def info(
    path: options.PathArgument,
) -> int:
    """Say what a run folder or a checkpoint is: step, load, broken bonds, size, sound or why not."""
    launch.prepare_environment()
    from pdfem_mpi.results.inspect import describe

    title, rows, problem = describe(path)
    if launch.rank_by_launcher() == 0 and rows:
        print_table(title, rows)
    if problem is None:
        return 0
    print_problems([f"pdfem: {problem}"], launch.rank_by_launcher())
    return EXIT_NO_CHECKPOINT


def check(
    deck: options.DeckArgument,
    overrides: options.SetOption = None,
    ranks: Annotated[int | None, typer.Option("-n", "--ranks", min=1, help="Ranks that the run will have.")] = None,
    picture: Annotated[
        Path | None, typer.Option("--picture", metavar="FILE.png", help="Draw what was understood; with -n its ranks.")
    ] = None,
) -> int:
    """Validate DECK as a run would, and print what was understood and what it will take."""
    if picture is not None and picture.suffix.lower() != ".png":
        raise fail([f"pdfem: --picture {picture}: it is a PNG file. Give a name with .png."], launch.rank_by_launcher())
    comm = start_world(None)
    let_interrupts_end_all(comm)
    scene = read_scene(deck, overrides or [], comm)
    from pdfem_mpi.runs.checking import check_scene

    try:
        sizes = check_scene(scene, comm, ranks, picture)
    except SceneError as error:
        raise fail([f"{deck}: {message}" for message in error.messages], comm.rank) from None
    if comm.rank == 0:
        print_table(f"{deck}: sound", sizes.items())
    return EXIT_NOT_WRITTEN if sizes.get("picture", "").startswith("not drawn") else EXIT_FINISHED


def warmup() -> int:
    """Compile all kernels into the cache, for images and continuous integration."""
    comm = start_world(None)
    let_interrupts_end_all(comm)
    from pdfem_mpi.runs.prepare import warm_up

    start = time.perf_counter()
    warm_up(comm)
    if comm.rank == 0:
        seconds = time.perf_counter() - start
        print(f"pdfem: kernels are compiled in {os.environ['NUMBA_CACHE_DIR']} ({seconds:.1f} s)")
    return 0


def study(
    deck: options.DeckArgument,
    vary: options.VaryOption = None,
    refine: options.RefineOption = None,
    ranks: Annotated[int | None, typer.Option("-n", "--ranks", min=1, help="MPI ranks of each member.")] = None,
    overrides: options.SetOption = None,
    out: options.StudyOutOption = None,
    plot: options.PlotOption = None,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Run members anew whose deck has changed since.")
    ] = False,
) -> int:
    """Run DECK once for each combination of values, into one table and one figure; go on where it stopped."""
    launch.prepare_environment()
    if variable := launch.launcher_variable():
        raise fail(
            [f"pdfem: {variable} is set: study starts its own ranks. Run it from a plain shell, with -n."],
            launch.rank_by_launcher(),
        )
    from pdfem_mpi.command import study as studies

    overrides, folder, vary = overrides or [], out or Path("runs") / f"{deck.stem}-study", vary or []
    interruption = studies.Interruption()
    try:
        if refine is None and not vary:
            raise studies.StudyError(["study: give --vary KEY=V1,V2, or --refine 3 for cells h, h/2, h/4."])
        if refine is not None:
            cells, overrides = studies.vary_cells(deck, refine, overrides)
            vary = [cells, *vary]
        if ranks is not None and ranks > 1:
            launch.mpirun_command(ranks)  # a missing launcher is reported once, not by every member
        axes, members = studies.prepare(deck, vary, overrides, folder, overwrite)
        start = studies.starter(deck, overrides, ranks, interruption)
        code = studies.run_study(members, axes, folder, start, print_at_once, plot or [], interruption)
        if refine is not None and len(axes) == 1:
            for line in studies.describe_refinement(members, folder):
                print_at_once(line)
    except DeckError as error:
        raise fail(error.messages, 0) from None
    except studies.StudyError as error:
        raise fail([f"pdfem: {message}" for message in error.messages], 0) from None
    except launch.LaunchError as error:
        raise fail([f"pdfem: {error}"], 0) from None
    except OSError as error:
        print_problems([f"pdfem: {folder}: cannot be written: {error.strerror}. Choose another folder."], 0)
        return EXIT_NOT_WRITTEN
    words = {EXIT_FINISHED: "finished", EXIT_STOPPED: "stopped; the same command goes on"}
    print(f"pdfem: study {words.get(code, 'finished, members failed')}; results in {folder / 'study.csv'}", flush=True)
    return code


def doctor() -> int:
    """Print MPI runtime, cores, threads and cache; test that ranks start and files can be written."""
    from pdfem_mpi.command.doctor import examine

    launch.prepare_environment()
    if problem := shared_memory_problem(1):  # MPI would end this process
        raise fail([f"pdfem: {problem}"], launch.rank_by_launcher())
    rows, problems = examine()
    if launch.rank_by_launcher() == 0:
        print_table("pdfem doctor", rows)
    if problems:
        raise fail([f"pdfem: {problem}" for problem in problems], launch.rank_by_launcher())
    return EXIT_FINISHED


#: In the order of the help: before a run, the run, after it, the machine.
for command in (init, schema, check, run, resume, study, info, plot, export, clean, doctor, warmup):
    app.command()(command)
