"""A body breaks alike on any number of ranks: every row of the history, and every broken bond."""

from functools import cache

import numpy as np
import pytest

from pdfem_mpi.deck.programs import Ramp, Steps
from pdfem_mpi.parallel.comm import mpi
from support.bodies import build
from support.failing import DEAD, GRIPS, WEIGHT, chipped, failing, followed, numbers, of_bonds, opened, strip
from support.held import beam
from support.helpers import assert_all
from support.owners import deal_out_by

pytestmark = pytest.mark.mpi(min_size=2)

RAMP = Ramp(kind="ramp", increment=2e-3, report_every=20)
FAST = Ramp(kind="ramp", increment=5e-3, report_every=20)
SCENES = {
    "events": ({"report_every": 1}, 25),
    "events, elements": ({"elements": 2}, 12),
    "events, finite": ({"kinematics": "finite"}, 12),
    "events, energy": ({"control": "energy", "report_every": 1}, 12),
    "events, opening": ({"make": opened}, 12),
    "events, opening, constant": ({"make": opened, "loads": (WEIGHT,), "supports": GRIPS}, 8),
    "events, springs and ties": ({"make": beam}, 8),
    "events, finite, springs and ties": ({"make": beam, "kinematics": "finite", "control": "energy"}, 5),
    "ramp, springs and ties": ({"make": beam, "solver": "adr", "tolerance": 1e-6, "stepping": FAST}, 12),
    "events, dead loads": ({"loads": DEAD, "supports": ()}, None),
    "events, chip": ({"make": chipped, "report_every": 1}, 16),
    "events, noise": ({"noise": 0.05, "seed": 3}, 12),
    "events, ratio of 0.1": ({"poissons_ratio": 0.1, "elements": 2, "report_every": 1}, 12),
    "events, finite, ratio of 0.4": (
        {"poissons_ratio": 0.4, "kinematics": "finite", "control": "energy", "report_every": 1}, 12,
    ),
    "ramp, ratio of 0.33": ({"solver": "adr", "tolerance": 1e-6, "stepping": RAMP, "poissons_ratio": 0.33}, 14),
    "ramp": ({"solver": "adr", "tolerance": 1e-6, "stepping": RAMP}, 14),
    "ramp, finite, elements": (
        {"solver": "adr", "tolerance": 1e-6, "stepping": RAMP, "kinematics": "finite", "elements": 2}, 15,
    ),
    "steps": ({"stepping": Steps(load_factors=(0.37, 0.38))}, None),
}  # fmt: skip


def outcome(run):
    """Rows, and the broken bonds of all ranks in order. Collective."""
    pairs = np.concatenate(run.body.model.comm.allgather(run.failure.broken_pairs()))
    return [numbers(row) for row in run.rows], sorted(map(tuple, pairs.tolist()))


def scene_of(name):
    """The scene and how many rows of it."""
    options, rows = SCENES[name]
    return options.get("make", strip)(**{key: value for key, value in options.items() if key != "make"}), rows


@cache
def on_one_rank(name):
    """The same by this rank alone."""
    scene, rows = scene_of(name)
    return outcome(followed(scene, rows, mpi().COMM_SELF))


@pytest.mark.parametrize("name", SCENES)
def test_histories_do_not_depend_on_the_number_of_ranks(comm, name):
    scene, rows = scene_of(name)
    expected = on_one_rank(name)
    found = outcome(followed(scene, rows, comm))
    assert_all(comm, found[0] == expected[0], "rows differ from those of one rank")
    assert_all(comm, found[1] == expected[1], "other bonds broke than on one rank")
    assert_all(comm, len(expected[1]) == expected[0][-1]["broken"] > 0, "no bond broke")


def test_cells_dealt_out_at_random(comm, monkeypatch):
    """Every bond may be between ranks."""
    expected = on_one_rank("events, elements")

    def random_owners(discretization, n_parts, neighbours):
        return (np.random.default_rng(3).permutation(len(discretization.mesh.cells)) % n_parts).astype(np.int32)

    deal_out_by(monkeypatch, random_owners)
    options, rows = SCENES["events, elements"]
    found = outcome(followed(strip(**options), rows, comm))
    assert_all(comm, found == expected, "another history than on one rank")


def test_broken_bonds_of_other_ranks_are_restored(comm):
    """What broke on one rank breaks again on these, with the same count, energy, extent and blocks."""
    options, rows = SCENES["events, elements"]
    alone = followed(strip(**options), rows, mpi().COMM_SELF)
    pairs = alone.failure.broken_pairs()
    together = failing(strip(**options), comm)
    model = together.body.model
    together.failure.restore(*of_bonds(model), pairs, alone.failure.dissipated_digits)
    together.solve.update_after_breaks(together.failure.take())
    found = outcome(together)[1]
    same = found == sorted(map(tuple, pairs.tolist()))
    assert_all(comm, same, "other bonds than on one rank")
    assert_all(comm, together.failure.count == len(pairs) > 0, "count")
    assert_all(comm, together.failure.dissipated == alone.failure.dissipated, "energy")
    assert_all(comm, (together.failure.extent == alone.failure.extent).all(), "extent")
    number = alone.body.model.points.cell_number[: alone.body.model.points.n_owned]
    sums = dict(zip(number.tolist(), alone.solve.preconditioner.of_points.sums.reshape(len(number), -1), strict=True))
    own = model.points.cell_number[: model.points.n_owned].tolist()
    ours = together.solve.preconditioner.of_points.sums.reshape(len(own), -1)
    assert_all(comm, all((sums[n] == row).all() for n, row in zip(own, ours, strict=True)), "blocks")


@pytest.mark.parametrize("options", [{}, {"elements": 2, "kinematics": "finite"}], ids=["bonds", "coupled, finite"])
def test_own_energies_do_not_depend_on_the_number_of_ranks(comm, options):
    """To the last bit: what `summary.json` tells of the body's own fracture energy."""
    expected, found = (build(strip(**options), ranks).model.own_energy for ranks in (mpi().COMM_SELF, comm))
    assert_all(comm, found.tolist() == expected.tolist(), f"{found} differs from {expected}")
