"""Regions that are found where it is not easy: at a corner, between two cracks, in a symmetric plate."""

import numpy as np
import pytest

from pdfem_mpi import Simulation, read_deck
from pdfem_mpi.deck.loads import Support
from pdfem_mpi.deck.meshes import BoxMesh
from pdfem_mpi.deck.peridynamics import Crack
from pdfem_mpi.deck.programs import Events
from pdfem_mpi.deck.removals import RemovedBox, RemovedCylinder
from pdfem_mpi.parallel.comm import mpi
from pdfem_mpi.solvers.convergence import NotConverged
from support.adaptive import FAST, plate, rows_of
from support.helpers import ROOT

pytestmark = pytest.mark.slow
LEDGER = 1e-10


def followed(scene):
    """A simulation at its end, and its rows, whose books close."""
    simulation = Simulation(scene, mpi().COMM_SELF)
    rows = rows_of(simulation)
    assert all(abs(row["ledger_error"]) < LEDGER for row in rows)
    assert simulation.state.program["foretold"] < 0.8
    return simulation, rows


def middles(simulation):
    """Midpoints of the broken bonds of a body without mirror planes, shape (n, 3)."""
    points = simulation.points.reshape(-1, 8, 3)
    row = np.full(simulation.share.counts.cells, -1)
    row[np.flatnonzero(simulation.share.has_points)] = np.arange(len(points))
    pairs = simulation.broken_bonds()
    return points[row[pairs // 8], pairs % 8].mean(axis=1)


def test_two_notches_meet():
    """Cracks from both edges, and switches at each: one region in the end."""
    notches = (
        RemovedBox(kind="box", lower=(8.0, 0.0, 0.0), upper=(10.0, 3.0, 1.0)),
        RemovedBox(kind="box", lower=(8.0, 9.0, 0.0), upper=(10.0, 12.0, 1.0)),
    )
    simulation, rows = followed(plate(remove=notches))
    y = middles(simulation)[:, 1]
    assert y.min() < 4.0
    assert y.max() > 8.0
    assert rows[-1]["event"] == "end"


def test_a_corner():
    """An L from whose inner corner the crack starts."""
    corner = (RemovedBox(kind="box", lower=(9.0, 4.0, 0.0), upper=(18.0, 12.0, 1.0)),)
    supports = (
        Support(face="y+", layers=1, x=0.0, y=0.0, z=0.0),
        Support(face="x+", layers=1, y=-0.2, z=0.0),
    )
    events = Events(kind="events", **FAST | {"end_reaction": 0.7})
    scene = plate(remove=corner, stepping=events).model_copy(update={"supports": supports})
    simulation, _ = followed(scene)
    start = middles(simulation)
    assert np.linalg.norm(start[:, :2] - [9.0, 4.0], axis=1).min() < 1.0


def test_a_symmetric_plate_breaks_on_both_sides_alike():
    """A hole in the middle: as many cells are turned, and bonds broken, above as below."""
    hole = (RemovedCylinder(kind="cylinder", axis="z", centre=(9.0, 6.0, 0.5), radius=1.6),)
    simulation, _ = followed(plate(remove=hole))
    share = simulation.share
    y = share.mesh.centroids[share.found.is_turned][:, 1]
    assert np.count_nonzero(y < 6.0) == np.count_nonzero(y > 6.0) > 0
    y = middles(simulation)[:, 1]
    assert np.count_nonzero(y < 6.0 - 1e-9) == np.count_nonzero(y > 6.0 + 1e-9) > 0


@pytest.mark.parametrize("control", ["load", "energy"])
def test_an_initial_crack_is_followed(control):
    """Elements do not know it: bonds begin around it."""
    crack = (Crack(polygon=((9.0, -1.0, -1.0), (9.0, 4.1, -1.0), (9.0, 4.1, 2.0), (9.0, -1.0, 2.0))),)
    events = Events(kind="events", **FAST | {"control": control})
    simulation, rows = followed(plate(remove=(), cracks=crack, stepping=events))
    assert sum(row["event"] == "switch" for row in rows) >= 1
    assert middles(simulation)[:, 1].max() > 8.0


def test_a_region_that_comes_to_a_support_ends_with_a_sentence():
    """The notch is beside the end that is held."""
    notch = (RemovedBox(kind="box", lower=(4.0, 0.0, 0.0), upper=(6.0, 4.0, 1.0)),)
    short = BoxMesh(lower=(0.0, 0.0, 0.0), upper=(18.0, 12.0, 1.0), spacing=1.0, remove=notch)
    scene = plate().model_copy(update={"mesh": short})
    with pytest.raises(NotConverged, match="cells that must stay elements"):
        rows_of(Simulation(scene, mpi().COMM_SELF))


def test_a_mesh_that_is_coarse_outside():
    """Cells of 3 stay elements; the crack runs through those of 1."""
    simulation, rows = followed(read_deck(ROOT / "jobs" / "hard" / "found_region.toml"))
    x = simulation.share.mesh.centroids[simulation.share.found.can_turn][:, 0]
    assert np.abs(x).max() < 6.0
    assert rows[-1]["event"] == "end"
    assert rows[-1]["crack_y_max"] > 10.0
