"""Bodies whose bonds soften break alike on any number of ranks: rows, teeth, and what other ranks take over."""

from functools import cache

import numpy as np
import pytest

from pdfem_mpi.deck.outputs import Output
from pdfem_mpi.deck.programs import Ramp, Steps
from pdfem_mpi.measure.fields import gather_damage
from pdfem_mpi.parallel.comm import broadcast, mpi
from support.failing import failing, followed, numbers, of_bonds
from support.helpers import assert_all
from support.softening import soft_strip, with_mirrors

pytestmark = pytest.mark.mpi(min_size=2)

RAMP = Ramp(kind="ramp", increment=2e-3, report_every=40, end_load_factor=0.64)
EDGE = {"crack": (-1.0, 2.1)}
SCENES = {
    "events": (lambda: soft_strip(**EDGE), 12),
    "events, noise, elements": (lambda: soft_strip(noise=0.05, elements=2, **EDGE), 10),
    "events, energy, finite": (lambda: soft_strip(kinematics="finite", control="energy", **EDGE), 3),
    "events, nu 0.39": (lambda: soft_strip(noise=0.05, poissons_ratio=0.39, **EDGE), 8),
    "events, nu 0.1, mirror planes, finite": (
        lambda: with_mirrors(soft_strip(2.0, kinematics="finite", poissons_ratio=0.1, **EDGE)),
        3,
    ),
    "events, mirror planes": (lambda: with_mirrors(soft_strip(2.0, control="energy", **EDGE)), 6),
    "steps": (lambda: soft_strip(stepping=Steps(load_factors=(0.4, 0.6)), **EDGE), None),
    "ramp": (lambda: soft_strip(stepping=RAMP, solver="adr", tolerance=1e-6, **EDGE), None),
}


def outcome(run):
    """Rows, and teeth of the softened bonds of all ranks in order. Collective."""
    broken = np.concatenate(run.body.model.comm.allgather(run.failure.broken_pairs()))
    books = run.failure.count, run.failure.soft, run.failure.left, run.failure.area, run.failure.dissipated
    return [numbers(row) for row in run.rows], sorted(map(tuple, broken.tolist())), books


@cache
def on_one_rank(name):
    """The same by this rank alone."""
    scene, rows = SCENES[name]
    return outcome(followed(scene(), rows, mpi().COMM_SELF))


@pytest.mark.parametrize("name", SCENES)
def test_histories_do_not_depend_on_the_number_of_ranks(comm, name):
    scene, rows = SCENES[name]
    expected = on_one_rank(name)
    found = outcome(followed(scene(), rows, comm))
    for k, what in enumerate(("rows", "teeth", "books")):
        assert_all(comm, found[k] == expected[k], f"{what} differ from those of one rank")
    assert_all(comm, len(expected[1]) == expected[2][2] > 0, "no bond softened")


def test_other_ranks_take_over(comm):
    """Books of one rank restored on all of them: teeth, area, forces and damage are the same."""
    scene = soft_strip(2.0, control="energy", **EDGE).model_copy(update={"output": Output(damage=True)})
    alone = followed(scene, 6, mpi().COMM_SELF)
    assert_all(comm, alone.failure.soft > 0, "no bond softened")
    taken = failing(scene, comm)
    taken.failure.restore(*of_bonds(taken.body.model), alone.failure.broken_pairs(), alone.failure.dissipated_digits)
    assert_all(comm, outcome(taken)[1:] == outcome(alone)[1:], "books differ")
    damage = broadcast(comm, gather_damage(taken.body.share, taken.body.model, parts=True))
    by_one = gather_damage(alone.body.share, alone.body.model, parts=True)
    assert_all(comm, (damage == by_one).all(), "damage differs")
