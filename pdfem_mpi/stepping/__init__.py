"""The load program: given steps, the paper's ramp, or events from break to break."""

from pdfem_mpi.solvers.equilibrium import make_solver
from pdfem_mpi.stepping.program import follow_load_program
from pdfem_mpi.stepping.report import Report

__all__ = ["Report", "follow_load_program", "make_solver"]
