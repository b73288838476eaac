"""Studies: one deck run with several values of some keys, into one folder with one table and one figure."""

from pdfem_mpi.command.study.members import Axis, Member, StudyError, make_members, parse_axes
from pdfem_mpi.command.study.outcomes import Outcome, changed_members, check_folder, outcome_in
from pdfem_mpi.command.study.refinement import describe_refinement, vary_cells
from pdfem_mpi.command.study.running import Interruption, Start, starter
from pdfem_mpi.command.study.study import prepare, run_study

__all__ = [
    "Axis",
    "Interruption",
    "Member",
    "Outcome",
    "Start",
    "StudyError",
    "changed_members",
    "check_folder",
    "describe_refinement",
    "make_members",
    "outcome_in",
    "parse_axes",
    "prepare",
    "run_study",
    "starter",
    "vary_cells",
]
