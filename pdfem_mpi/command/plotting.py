"""`pdfem plot`: the figures of a run, finished or stopped, from its result files."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from pdfem_mpi.command import options
from pdfem_mpi.command.console import fail, print_at_once, print_problems, show_progress
from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.deck.table import DeckError
from pdfem_mpi.deck.toml import read_deck
from pdfem_mpi.system import launcher as launch
from pdfem_mpi.system.exit_codes import EXIT_FINISHED, EXIT_NO_CHECKPOINT, EXIT_NOT_WRITTEN

RunArgument = Annotated[Path, typer.Argument(metavar="RUN", help="A run folder.", callback=options.askable)]
ViewOption = Annotated[
    str | None, typer.Option("--view", metavar="iso|x|y|z", help="From where the body is seen.", show_default="iso")
]
FieldOption = Annotated[
    str | None,
    typer.Option("--field", metavar="NAME", help="damage, displacement, displacement_x, ...: what frames hold."),
]
DeformedOption = Annotated[
    float | None,
    typer.Option("--deformed", metavar="FACTOR", help="Displacements so many times larger.", show_default="round"),
]
SectionOption = Annotated[
    bool | None,
    typer.Option("--section/--no-section", help="Cut open through the largest value.", show_default="if it is inside"),
]
FrameOption = Annotated[
    int | None, typer.Option("--frame", metavar="N", help="From 0; -1 is the last.", show_default="the last")
]
MovieOption = Annotated[bool, typer.Option("--movie", help="Draw all frames as a film (body.gif, damage.gif) too.")]


def plot(
    folder: RunArgument,
    view: ViewOption = None,
    field: FieldOption = None,
    deformed: DeformedOption = None,
    section: SectionOption = None,
    frame: FrameOption = None,
    movie: MovieOption = False,
) -> int:
    """Draw the figures of a run, and its body in three dimensions, from its result files."""
    launch.prepare_environment()
    from pdfem_mpi.results.ownership import is_run, refuse_folder
    from pdfem_mpi.results.whole_body import NoPicture
    from pdfem_mpi.runs.outputs import draw_run

    refusal = refuse_folder(folder) or (None if is_run(folder) else f"{folder} holds no run. Give a run folder.")
    if refusal:
        raise fail([f"pdfem: {refusal}"], 0)
    asked = {"view": view, "field": field, "deformed": deformed, "section": section, "frame": frame}
    asked = {name: value for name, value in asked.items() if value is not None}
    missing: list[str] = []
    drawn: list[Path] = []
    try:
        scene = read_deck(folder / "deck.toml")
        if not asked:
            drawn += draw_run(folder, scene, missing.append, movie)
        drawn += _draw_body(folder, scene, asked, movie, optional=not asked and bool(drawn))
    except NoPicture as error:
        for path in drawn:
            print_at_once(path)
        raise fail([f"pdfem: {error}"], 0) from None
    except DeckError as error:
        raise fail(error.messages, 0) from None
    except OSError as error:
        raise fail([f"pdfem: {error.filename}: cannot be read or written ({error.strerror})."], 0) from None
    except (ValueError, KeyError, TypeError, RuntimeError) as error:
        problem = f"history.csv or points.vtkhdf is damaged ({type(error).__name__}: {error})"
        print_problems([f"pdfem: {folder}: {problem}. `pdfem info` says what is sound."], 0)
        return EXIT_NO_CHECKPOINT
    for path in drawn:
        print_at_once(path)
    if missing:
        print_problems([f"pdfem: {text}." for text in missing], 0)
        return EXIT_NOT_WRITTEN
    return EXIT_FINISHED


def _draw_body(folder: Path, scene: Scene, asked: dict, movie: bool, optional: bool) -> list[Path]:
    """Draw the body, and its film.

    Parameters
    ----------
    optional : bool
        There are other figures: why the body is not drawn is a note.

    Raises
    ------
    NoPicture
    """
    from pdfem_mpi.results.camera import VIEWS
    from pdfem_mpi.results.ownership import Written
    from pdfem_mpi.results.pictures import View, draw_body, draw_film
    from pdfem_mpi.results.whole_body import Body, NoPicture

    if asked.get("view", "iso") not in VIEWS:
        raise NoPicture(f"--view {asked['view']} is none of {', '.join(VIEWS)}.")
    try:
        body, view = Body(folder), View(**asked)
        (folder / "figures").mkdir(exist_ok=True)
        written = Written(folder)
        written.begin()
        name = "-".join(["body", *(str(value).lower() for key, value in asked.items() if key != "section")])
        name += "-section" if asked.get("section") else ""
        path = written.new(f"figures/{name}.png")
        print_at_once(f"{path.name}: {draw_body(path, body, view, scene.title, scene.units.length)}")
        drawn = [path]
        if movie:
            film = written.new(f"figures/{name}.gif")
            draw_film(film, body, view, scene.title, scene.units.length, _tell_frames)
            drawn.append(film)
        return drawn
    except NoPicture as error:
        if not optional:
            raise
        print_problems([f"pdfem: note: {error}"], 0)
        return []


def _tell_frames(done: int, count: int) -> None:
    """Say how far a film is: a line that is rewritten on a terminal, and nothing in a file."""
    show_progress(f"frame {done}/{count}", done == count)
