"""`pdfem plot`: the figures of a run, from its result files."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from pdfem_mpi.command import options
from pdfem_mpi.command.console import fail, print_problems
from pdfem_mpi.deck.table import DeckError
from pdfem_mpi.deck.toml import read_deck
from pdfem_mpi.system import launcher as launch
from pdfem_mpi.system.exit_codes import EXIT_NO_CHECKPOINT, EXIT_NOT_WRITTEN


def plot(
    folder: Annotated[Path, typer.Argument(metavar="RUN", help="A run folder.", callback=options.askable)],
    film: Annotated[bool, typer.Option("--movie", help="Draw the film of the damage too (damage.gif).")] = False,
) -> int:
    """Draw the figures of a run with failure again, from its result files."""
    launch.prepare_environment()
    from pdfem_mpi.results.ownership import is_run, refuse_folder
    from pdfem_mpi.runs.outputs import draw_run

    refusal = refuse_folder(folder) or (None if is_run(folder) else f"{folder} holds no run. Give a run folder.")
    if refusal:
        raise fail([f"pdfem: {refusal}"], 0)
    missing: list[str] = []
    try:
        scene = read_deck(folder / "deck.toml")
        drawn = draw_run(folder, scene, missing.append, film)
    except DeckError as error:
        raise fail(error.messages, 0) from None
    except OSError as error:
        raise fail([f"pdfem: {error.filename}: cannot be read or written ({error.strerror})."], 0) from None
    except (ValueError, KeyError, TypeError, RuntimeError) as error:
        problem = f"history.csv or points.vtkhdf is damaged ({type(error).__name__}: {error})"
        print_problems([f"pdfem: {folder}: {problem}. `pdfem info` says what is sound."], 0)
        return EXIT_NO_CHECKPOINT
    for path in drawn:
        print(path)
    if missing:
        print_problems([f"pdfem: {text}." for text in missing], 0)
        return EXIT_NOT_WRITTEN
    if not drawn:
        raise fail([f"pdfem: {folder} has no history of broken bonds to draw."], 0)
    if film and not any(path.suffix == ".gif" for path in drawn):
        raise fail([f"pdfem: {folder} has no damage to film. Run the deck with --set output.damage=true."], 0)
    return 0


