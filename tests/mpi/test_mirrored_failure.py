"""Failure in an eighth of a body: the same bits, and the same bonds to mirror images, on any number of ranks."""

import numpy as np
import pytest

from pdfem_mpi.deck.outputs import Output
from pdfem_mpi.measure.fields import gather_damage
from pdfem_mpi.model.breaking import make_failure
from pdfem_mpi.parallel.comm import broadcast, mpi
from pdfem_mpi.peridynamics.damage import Remaining
from support.bodies import build
from support.helpers import assert_all
from support.notched import notched, pull

pytestmark = pytest.mark.mpi(min_size=2)

ROWS = 8


@pytest.mark.parametrize("nu", [0.25, 0.4])
def test_events_and_books_do_not_depend_on_the_number_of_ranks(comm, nu):
    """Rows of the history, ids of broken bonds, local damage, and a run on one rank taken over by all."""
    scene = notched(("x-", "y-", "z-"), nu).model_copy(update={"output": Output(damage=True)})
    alone, books, expected = pull(scene, mpi().COMM_SELF, ROWS)
    remaining = Remaining()
    body, failure, rows = pull(
        scene, comm, ROWS, lambda body, failure: gather_damage(body.share, body.model, remaining, failure)
    )
    pairs = np.concatenate(comm.allgather(failure.broken_pairs()))
    told = [
        [(row.event, row.load_factor, row.reaction, row.broken, row.stored, row.released) for row in history]
        for history in (rows, expected)
    ]
    again = build(scene, comm)
    taken = make_failure(scene, again.share, again.model)
    bonded = again.model.comm, again.model.points, again.model.bonds
    taken.restore(*bonded, books.broken_pairs(), books.dissipated_digits)
    restored = np.concatenate(comm.allgather(taken.broken_pairs()))
    damage = broadcast(comm, gather_damage(body.share, body.model, remaining, failure))
    by_all = gather_damage(alone.share, alone.model)
    assert_all(comm, told[0] == told[1], "histories differ")
    assert_all(comm, (damage == by_all).all(), "damage differs")
    one = np.unique(books.broken_pairs(), axis=0).tolist()
    assert_all(comm, len(pairs) == len(one) and np.unique(pairs, axis=0).tolist() == one, "broken bonds differ")
    assert_all(comm, len(restored) == len(one) and np.unique(restored, axis=0).tolist() == one, "restored bonds differ")
    assert_all(comm, (taken.count, taken.dissipated) == (books.count, books.dissipated), "books differ")
    assert_all(comm, alone.forces.evaluations == body.forces.evaluations, "evaluations differ")
