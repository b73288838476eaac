"""Hard cases on several ranks: the same bits as on one."""

import json

import pytest
from hard.cases import CASES
from hard.running import outcome_of
from hard.suite import digest

from pdfem_mpi.deck.toml import read_deck
from pdfem_mpi.parallel.comm import broadcast, mpi, world
from pdfem_mpi.stepping import follow_load_program, make_solver
from support.bodies import build
from support.helpers import ROOT, assert_all

HELD = 'supports=[{face="x-",x=0.0,y=0.0,z=0.0},{face="y-",y=0.0},{face="y+",y=0.0},{region="elements",z=0.0}]'


def rows(comm):
    """Residuals, reactions and balances of all rows."""
    body = build(read_deck(ROOT / "jobs" / "hard" / "supports.toml", [HELD]), comm)
    solve = make_solver(body.scene, body.share, body.forces, body.case, lambda text: None)
    program = follow_load_program(body.scene, solve, None, body.state, body.case)
    return [(row.convergence.residual, *row.resultant.tolist(), row.force_balance) for row in program]


@pytest.mark.mpi
def test_digits_of_a_solution_do_not_depend_on_the_ranks():
    """The quanta of sums follow from what all ranks met in each step, not from sums of each rank's own."""
    comm = world()
    assert_all(comm, rows(comm) == rows(mpi().COMM_SELF), "residual, reaction or balance differ")


def digest_on(case, n, comm, folder):
    """What a case leaves on the first ranks of a communicator; None on the others. Collective."""
    part = comm.Split(0 if comm.rank < n else 1, comm.rank)
    try:
        if comm.rank >= n:
            return None
        _, outcome = outcome_of(case, part, folder / f"on {n}")
        return digest(outcome) if part.rank == 0 else None
    finally:
        part.Free()


# those that are long on one rank already are left to the study
WHOLE = [pytest.param(case, marks=pytest.mark.study if case.short != () else (), id=case.title) for case in CASES]


@pytest.mark.mpi
@pytest.mark.slow
@pytest.mark.parametrize("case", WHOLE)
def test_whole_case_has_the_same_bits_on_all_its_numbers_of_ranks(case, mpi_tmp_path, record_property):
    """As many of them as there are; on more than two ranks, cases that are meant for more."""
    comm = world()
    if comm.size > max(case.ranks):
        pytest.skip("more ranks than this case is meant for")
    found = {n: digest_on(case, n, comm, mpi_tmp_path) for n in case.ranks if n <= comm.size}
    differing = broadcast(comm, [n for n, value in found.items() if value != found[1]])
    record_property("hard case", json.dumps({"case": case.name, "ranks": list(found), "differing": differing}))
    assert not differing, f"other bits on {differing} ranks"
