"""Plates with one to three random holes and notches, whose bonds are found: nothing breaks unseen."""

import numpy as np
import pytest

from pdfem_mpi import Simulation
from pdfem_mpi.deck.removals import RemovedBox, RemovedCylinder
from pdfem_mpi.deck.table import SceneError
from pdfem_mpi.parallel.comm import mpi
from pdfem_mpi.solvers.convergence import NotConverged
from support.adaptive import plate

pytestmark = pytest.mark.slow
PLATES = 20
LEDGER = 1e-10
THRESHOLD = 0.8


def random_removals(random):
    """Holes inside and notches at the edges, away from the ends that are held."""
    removed = []
    for _ in range(random.integers(1, 4)):
        x = float(random.integers(6, 12)) + 0.5
        if random.random() < 0.5:
            centre = (x, float(random.integers(4, 9)), 0.5)
            removed.append(RemovedCylinder(kind="cylinder", axis="z", centre=centre, radius=random.choice([1.1, 1.6])))
        else:
            low = 0.0 if random.random() < 0.5 else 12.0 - float(random.integers(2, 5))
            lower, upper = (x - 0.5, low, 0.0), (x + 0.5, low + 4.0 if low else float(random.integers(2, 5)), 1.0)
            removed.append(RemovedBox(kind="box", lower=lower, upper=upper))
    return tuple(removed)


def plates():
    """So many simulations of random plates that hang together."""
    random, found = np.random.default_rng(20), 0
    while found < PLATES:
        try:
            yield Simulation(plate(remove=random_removals(random)), mpi().COMM_SELF)
        except SceneError:  # in pieces, or held too near
            continue
        found += 1


def test_nothing_breaks_beside_what_may_fail():
    ended = []
    for simulation in plates():
        try:
            for row in simulation.steps():
                share = simulation.share
                cells = np.unique(simulation.failure.broken_pairs() // 8 % share.counts.cells)
                places = share.mesh.places_of_cells(cells)
                assert not share.found.is_held[places].any()
                assert abs(row["ledger_error"]) < LEDGER
            ended.append("")
        except NotConverged as error:
            ended.append(str(error))
            assert "must stay elements" in str(error)
        assert simulation.state.program.get("foretold", 0.0) < THRESHOLD
    assert ended.count("") >= PLATES // 2
