"""Regions that are found are the same on any number of ranks, across switches and stops."""

import json
from functools import cache

import numpy as np
import pytest

from pdfem_mpi import Simulation
from pdfem_mpi.body import cutting, found_region
from pdfem_mpi.deck.programs import Events
from pdfem_mpi.parallel.comm import broadcast, mpi
from pdfem_mpi.parallel.slabs import redistribute
from pdfem_mpi.runs import widening
from support.adaptive import FAST, plate, rows_of
from support.helpers import assert_all
from support.restarts import StopAt, differing, go, outcome

pytestmark = pytest.mark.mpi(min_size=2)

FINISHED = 0


def told(scene, comm):
    """Rows, turned cells and broken bonds of all ranks. Collective."""
    simulation = Simulation(scene, comm)
    rows = rows_of(simulation)
    broken = np.concatenate(comm.allgather(simulation.failure.broken_pairs()))
    return rows, simulation.share.found.turned.tolist(), sorted(map(tuple, broken.tolist()))


@cache
def on_one_rank():
    return told(plate(), mpi().COMM_SELF)


def test_histories_do_not_depend_on_the_number_of_ranks(comm):
    expected, found = on_one_rank(), told(plate(), comm)
    for what, one, many in zip(("rows", "turned cells", "broken bonds"), expected, found, strict=True):
        assert_all(comm, one == many, f"{what} differ from those of one rank")
    assert_all(comm, sum(row["event"] == "switch" for row in expected[0]) >= 2, "nothing was switched")


def test_a_body_that_is_made_anew_is_the_same(comm, monkeypatch):
    """To the first switch: the body without bonds is kept, as on one rank always, or made again, as in large meshes."""
    made, discretize = [], cutting.discretize
    monkeypatch.setattr(cutting, "discretize", lambda *body: made.append(True) or discretize(*body))

    def switched():
        made.clear()
        simulation = Simulation(plate(), comm)
        reactions = []
        for row in simulation.steps():
            reactions.append(row["reaction"])
            if row["event"] == "switch":
                return reactions, simulation.share.found.turned.tolist(), len(made)
        raise AssertionError("nothing was switched")

    kept = switched()
    monkeypatch.setattr(found_region, "FEW_CELLS", 0)
    again = switched()
    assert_all(comm, kept[:2] == again[:2], "the body that is made anew is another one")
    expected = (1, 3 if comm.size > 1 else 1)
    assert_all(comm, (kept[2], again[2]) == expected, f"it was made {kept[2]} and {again[2]} times")


def test_runs_go_on_on_other_ranks(comm, tmp_path):
    """Stopped within an avalanche and right after a switch, gone on with on one rank and on all."""
    straight, stopped = (broadcast(comm, tmp_path / name) for name in ("straight", "stopped"))
    if comm.rank == 0:
        go(plate(), mpi().COMM_SELF, straight)
    comm.Barrier()
    for k, n in enumerate((4, 9, 2, 1, 1, 1)):
        if k % 2:
            go(plate(), comm, stopped, requests=StopAt(n, here=comm.rank == 0))
        elif comm.rank == 0:
            go(plate(), mpi().COMM_SELF, stopped, requests=StopAt(n))
        comm.Barrier()
    code = go(plate(), comm, stopped)
    wrong = differing(outcome(stopped), outcome(straight)) if comm.rank == 0 else []
    assert_all(comm, code == FINISHED and not wrong, f"{wrong} differ")


def test_a_narrow_body_that_goes_first_changes_nothing(comm, tmp_path, monkeypatch):
    """The error of the peak, told while the narrow body is gone: on all ranks, and stopped, as with both on one."""
    scene = plate(adaptive={"widening_check": "peak"}, stepping=Events(kind="events", **FAST | {"end_reaction": 0.9}))
    straight, all_ranks, stopped = (broadcast(comm, tmp_path / name) for name in ("straight", "all", "stopped"))
    if comm.rank == 0:
        go(scene, mpi().COMM_SELF, straight)
    comm.Barrier()
    monkeypatch.setattr(widening, "MANY_BONDS", 0)
    codes = [go(scene, comm, all_ranks)]
    for n in (1, 2, 1):
        go(scene, comm, stopped, requests=StopAt(n, here=comm.rank == 0))
    codes.append(go(scene, comm, stopped))
    wrong = []
    if comm.rank == 0:
        expected = outcome(straight) | errors_of(straight)
        for out in (all_ranks, stopped):
            wrong += differing(outcome(out) | errors_of(out), expected)
    assert_all(comm, codes == [FINISHED] * 2 and not wrong, f"{codes}, {wrong} differ")


def errors_of(out):
    """What a run says of its errors."""
    found = json.loads((out / "summary.json").read_text(encoding="utf-8"))["adaptive"]
    return {name: found[name] for name in ("error", "error_of_peak")}


def test_rows_are_sent_to_where_they_are_wanted(comm):
    n = 70_001  # more than one slab
    own = np.arange(n)[comm.rank :: comm.size][::-1]
    wanted = np.random.default_rng(comm.rank).permutation(n)[:1000]
    found = redistribute(comm, own, np.stack([own, -own], axis=1), wanted, n)
    assert_all(comm, (found == np.stack([wanted, -wanted], axis=1)).all(), "other rows came")
    try:
        redistribute(comm, own[own > 5], own[own > 5], np.arange(10), n)
    except ValueError as error:
        assert_all(comm, "id 0 has no owner" in str(error), str(error))
    else:
        assert_all(comm, False, "a missing row was not told")
