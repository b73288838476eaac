"""Arguments and options that commands share, with their help."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
import typer.main


def askable(path: Path | None) -> Path | None:
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
    Path, typer.Argument(metavar="DECK", help="TOML deck; see jobs/.", show_default=False, callback=askable)
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
StealOption = Annotated[bool, typer.Option("--steal-lock", help="Take a folder that another job held and surely left.")]
RefineOption = Annotated[
    int | None,
    typer.Option("--refine", metavar="N", help="Cells h, h/2, ... in N levels; tells peaks and probes at h -> 0."),
]
VaryOption = Annotated[
    list[str] | None,
    typer.Option(
        "--vary",
        metavar="KEY=V1,V2",
        help="Values of a key; keys that change together: a:b=1:2,3:4. Repeat it for all combinations.",
    ),
]
PlotOption = Annotated[
    list[str] | None, typer.Option("--plot", metavar="RESULT", help="A column of study.csv to draw. Repeatable.")
]
ForceOption = Annotated[
    bool, typer.Option("--force", help="Go on although the checkpoint is of another scene; recorded.")
]
RunFolderArgument = Annotated[
    Path, typer.Argument(metavar="RUNDIR", help="Run folder.", show_default=False, callback=askable)
]
PathArgument = Annotated[
    Path,
    typer.Argument(metavar="RUNDIR|FILE", help="Run folder or checkpoint.", show_default=False, callback=askable),
]
OutOption = Annotated[
    Path | None,
    typer.Option("--out", metavar="DIR", help="Run folder.", show_default="runs/<deck>", callback=askable),
]
StudyOutOption = Annotated[
    Path | None,
    typer.Option(
        "--out", metavar="DIR", help="Folder of the study.", show_default="runs/<deck>-study", callback=askable
    ),
]
