"""The console command ``pdfem``: a run on several ranks becomes their launcher before anything else is loaded.

The ranks read command line and deck themselves, and rank 0 tells what is wrong with them.
"""

from __future__ import annotations

import itertools
import sys
from contextlib import suppress

from pdfem_mpi.system import launcher as launch
from pdfem_mpi.system.process_limits import shared_memory_problem

#: Commands that run on ranks which they start.
ON_RANKS = ("run", "resume")


def main() -> None:
    """Become the launcher of the ranks that are plainly asked for, or read the command line, as each of them does."""
    if launch.launcher_variable() is None and (ranks := ranks_asked(sys.argv[1:])) > 1:
        with suppress(launch.LaunchError):  # told below, after what is wrong with the deck
            start_ranks(ranks)
    from pdfem_mpi.command.cli import main as read_command_line

    read_command_line()


def ranks_asked(arguments: list[str]) -> int:
    """The ranks that a command asks for in the usual words; 0 where the command line has to be read to tell.

    For more ranks than cores the deck is read before as many processes start: it may have fewer cells.
    """
    if not arguments or arguments[0] not in ON_RANKS or "--help" in arguments:
        return 0
    asked = [value for name, value in itertools.pairwise(arguments) if name in ("-n", "--ranks")]
    ranks = int(asked[0]) if len(asked) == 1 and asked[0].isascii() and asked[0].isdigit() else 0
    return ranks if ranks <= launch.allowed_cores() else 0


def start_ranks(ranks: int) -> None:
    """Become a launcher of so many ranks, each of which reads the same command line.

    Raises
    ------
    LaunchError
    """
    plan = launch.plan_launch(ranks, sys.argv[1:])
    if not launch.is_open_mpi(plan.command[0]) and (problem := shared_memory_problem(ranks)):
        raise launch.LaunchError(problem)
    print(plan.line, flush=True)
    launch.become(plan)
