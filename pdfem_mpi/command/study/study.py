"""Studies: one deck run with several values of some keys, into one folder with one table and one figure.

``runs/NAME/study.csv`` has a row for each member, ``runs/NAME/study.png`` draws it, and ``runs/NAME/members/`` holds
the run folders. The table is written anew after each member. A member that has finished is known by the hash of its
complete deck and is not run again: the same command goes on where a study stopped.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from pdfem_mpi.command.study.figure import draw
from pdfem_mpi.command.study.members import Axis, Member, StudyError, make_members, parse_axes
from pdfem_mpi.command.study.outcomes import changed_members, check_folder
from pdfem_mpi.command.study.result_table import table
from pdfem_mpi.command.study.running import Interruption, Start, exit_code, follow
from pdfem_mpi.results.study_files import write_table


def prepare(
    deck: Path, vary: Sequence[str], overrides: Sequence[str], folder: Path, overwrite: bool
) -> tuple[list[Axis], list[Member]]:
    """Axes and members of a study, each of them sound, whose folder is free for them.

    Parameters
    ----------
    vary : list of str
        As ``--vary`` takes them.
    overwrite : bool
        Whether members may be run anew whose folder holds a run of another deck.

    Raises
    ------
    DeckError
        The deck cannot be read.
    StudyError
    """
    axes = parse_axes(vary)
    members = make_members(deck, axes, overrides)
    check_folder(folder)
    changed = [] if overwrite else changed_members(members, folder)
    if changed:
        raise StudyError(changed)
    return axes, members


def run_study(
    members: Sequence[Member],
    axes: Sequence[Axis],
    folder: Path,
    start: Start,
    report: Callable[[str], None],
    wanted: Sequence[str] = (),
    interruption: Interruption | None = None,
) -> int:
    """Run the members of a study that have not finished, keeping ``study.csv`` up to date, and draw it.

    Returns
    -------
    int
        As `exit_code`.

    Raises
    ------
    StudyError
        A wanted result that no member has; the table is there.
    OSError
        The folder cannot be written.
    """
    interruption = interruption or Interruption()
    folder.mkdir(parents=True, exist_ok=True)

    def update(outcomes):
        write_table(folder / "study.csv", *table(members, outcomes))

    with interruption.listening():
        outcomes = follow(members, folder, start, report, interruption, update)
    draw(folder / "study.png", members, axes, outcomes, wanted, report)
    return exit_code(outcomes, interruption)
