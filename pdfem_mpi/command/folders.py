"""Commands on the folder of a run that is over: export, clean."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from pdfem_mpi.command import options
from pdfem_mpi.command.console import fail, print_at_once, print_problems
from pdfem_mpi.system import launcher as launch
from pdfem_mpi.system.exit_codes import EXIT_FINISHED, EXIT_NOT_WRITTEN

FORMATS = ("pvd", "csv")
MOST_SHOWN = 20

FormatOption = Annotated[
    str, typer.Option("--format", metavar="pvd|csv", help="Every frame for ParaView; or a table of one frame.")
]
FrameOption = Annotated[int, typer.Option("--frame", help="Of the table; they count from 0, -1 is the last.")]
ExportOption = Annotated[
    Path | None,
    typer.Option("--out", metavar="DIR", help="A new or an empty folder.", show_default="RUNDIR-FORMAT"),
]


def export(
    folder: options.RunFolderArgument, format: FormatOption = "pvd", frame: FrameOption = -1, out: ExportOption = None
) -> int:
    """Write the fields of RUNDIR for other programs: VTU files with a PVD list, or a table of text."""
    launch.prepare_environment()
    if format not in FORMATS:
        raise fail([f"pdfem: --format {format} is none of {' and '.join(FORMATS)}."], 0)
    from pdfem_mpi.results.export import NotExported, export_csv, export_pvd, parts_of
    from pdfem_mpi.results.ownership import is_run

    if not folder.is_dir() or not is_run(folder):
        raise fail([f"pdfem: {folder} holds no run. Give a run folder."], 0)
    if not parts_of(folder):
        raise fail([f"pdfem: {folder} has no fields. Run the deck with output.fields = true."], 0)
    out = out or folder.with_name(f"{folder.resolve().name}-{format}")
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise fail([f"pdfem: {out} is there already, and is left alone. Give a new folder with --out."], 0)
    try:
        out.mkdir(parents=True, exist_ok=True)
        paths = list(export_csv(folder, out, frame) if format == "csv" else export_pvd(folder, out))
    except NotExported as error:
        raise fail([f"pdfem: {error}"], 0) from None
    except (KeyError, ValueError) as error:
        problem = f"the frames of {folder} cannot be read ({type(error).__name__}: {error})"
        raise fail([f"pdfem: {problem}. `pdfem info` says what is sound."], 0) from None
    except OSError as error:
        print_problems([f"pdfem: {error.filename or out}: {error.strerror or error}. Choose another folder."], 0)
        return EXIT_NOT_WRITTEN
    shown = [path for path in paths if path.suffix != ".vtu"]
    count = "1 file" if len(paths) == 1 else f"{len(paths):,} files"
    print_at_once(f"{count} in {out}; open {', '.join(path.name for path in shown)}")
    return EXIT_FINISHED


def clean(
    folder: options.RunFolderArgument,
    checkpoints: Annotated[bool, typer.Option(help="Remove checkpoints: the run cannot go on further then.")] = True,
    frames: Annotated[bool, typer.Option(help="Remove the fields (.vtkhdf) as well.")] = False,
    yes: Annotated[bool, typer.Option("--yes", "-y", help="Do not ask.")] = False,
) -> int:
    """List the checkpoints, and with --frames the fields, of a finished run, and remove them; nothing else."""
    launch.prepare_environment()
    from pdfem_mpi.results.cleaning import NotCleaned, find_removable, remove

    try:
        removable = find_removable(folder, checkpoints, frames)
    except NotCleaned as error:
        raise fail([f"pdfem: {error}"], 0) from None
    for path in removable.kept:
        print_at_once(f"{path}  stays: it is not what pdfem wrote")
    for path, size in removable.files[:MOST_SHOWN]:
        print_at_once(f"{path}  {size / 1e6:.1f} MB")
    if len(removable.files) > MOST_SHOWN:
        print_at_once(f"and {len(removable.files) - MOST_SHOWN:,} more")
    if not removable.files:
        print_at_once("there is nothing to remove")
        return EXIT_FINISHED
    count = "this file" if len(removable.files) == 1 else f"these {len(removable.files):,} files"
    total = sum(size for _, size in removable.files) / 1e6
    try:
        if not yes and not typer.confirm(f"remove {count} ({total:.1f} MB)?"):
            print_at_once("nothing was removed")
            return EXIT_FINISHED
    except typer.Abort:
        print_at_once("\nnothing was removed: nobody answered. Say --yes where nobody can.")
        return EXIT_FINISHED
    try:
        free = remove(removable)
    except OSError as error:
        print_problems([f"pdfem: {error.filename} cannot be removed ({error.strerror})."], 0)
        return EXIT_NOT_WRITTEN
    print_at_once(f"{free / 1e6:.1f} MB are free")
    return EXIT_FINISHED
