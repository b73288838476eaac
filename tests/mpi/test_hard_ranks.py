"""Decks of jobs/hard whose bits once depended on how the body was shared out."""

import pytest

from helpers import ROOT, assert_all
from pdfem_mpi.deck.toml import read_deck
from pdfem_mpi.parallel.comm import mpi, world
from pdfem_mpi.stepping import follow_load_program, make_solver
from verification.bodies import build

HELD = (
    'supports=[{face="x-",x=0.0,y=0.0,z=0.0},{face="y-",y=0.0},{face="y+",y=0.0},{region="elements",z=0.0}]'
)


def rows(comm):
    """Residuals, reactions and balances of all rows."""
    body = build(read_deck(ROOT / "jobs" / "hard" / "supports.toml", [HELD]), comm)
    solve = make_solver(body.scene, body.discretization, body.forces, body.case, lambda text: None)
    program = follow_load_program(body.scene, solve, None, body.state, body.case)
    return [(row.convergence.residual, *row.resultant.tolist(), row.force_balance) for row in program]


@pytest.mark.mpi
def test_digits_of_a_solution_do_not_depend_on_the_ranks():
    """The quanta of sums follow from what all ranks met in each step, not from sums of each rank's own."""
    comm = world()
    assert_all(comm, rows(comm) == rows(mpi().COMM_SELF), "residual, reaction or balance differ")
