"""Foretold stretches, against all pairs of points by numpy."""

import numpy as np
import pytest

from pdfem_mpi import Simulation
from pdfem_mpi.deck.peridynamics import Crack
from pdfem_mpi.kernels.hex8 import gauss_positions
from pdfem_mpi.measure import foretelling as module
from pdfem_mpi.measure.foretelling import ROUNDED, Foretelling
from pdfem_mpi.parallel.comm import mpi
from pdfem_mpi.peridynamics.clusters import by_component
from support.adaptive import plate

CRACK = (Crack(polygon=((9.0, -1.0, -1.0), (9.0, 4.1, -1.0), (9.0, 4.1, 2.0), (9.0, -1.0, 2.0))),)
STRETCH, CUTOFF = 0.002, 2.5 * (1.0 + 1e-9)


def dense(x, u, mirrored):
    """Largest stretch of each cell's bonds over the critical one; positions and displacements (n, 8, 3)."""
    x, u = x.reshape(-1, 3), u.reshape(-1, 3)
    far, moved = [x], [u]
    for plane in (0.0, 1.0) if mirrored else ():
        far.append(x * [1, 1, -1] + [0, 0, 2 * plane])
        moved.append(u * [1, 1, -1])
    if mirrored:
        for shift in (-2.0, 2.0):
            far.append(x + np.array([0.0, 0.0, shift]))
            moved.append(u)
    far, moved = np.concatenate(far), np.concatenate(moved)
    found = np.zeros(len(x))
    for k in range(len(x)):
        xi, eta = far - x[k], moved - u[k]
        square = (xi**2).sum(axis=1)
        near = (square > 0.0) & (square <= CUTOFF**2)
        found[k] = max(0.0, ((xi * eta).sum(axis=1)[near] / square[near]).max())
    return found.reshape(-1, 8).max(axis=1) / STRETCH


@pytest.mark.parametrize("symmetry", [(), ("z-", "z+")])
def test_ratios_are_those_of_all_pairs(symmetry):
    """At random displacements, of bonds and elements, with images where there are mirror planes."""
    simulation = Simulation(plate(remove=(), symmetry=symmetry, cracks=CRACK), mpi().COMM_SELF)
    foretelling, share = simulation.region_watch.foretelling, simulation.share
    u = np.random.default_rng(3).normal(size=len(simulation.state.u)) * 1e-3
    u[simulation.model.rollers] = 0.0
    points = foretelling.place(u)
    x = gauss_positions(share.mesh.nodes[share.mesh.cells[foretelling.cells]])
    asked = ~share.found.is_turned[foretelling.cells]
    expected = dense(x, points, bool(symmetry)) * asked
    found = foretelling.ratios(u, 0.0)
    assert np.count_nonzero(asked) > 40
    np.testing.assert_allclose(found, expected, atol=ROUNDED)
    # what is not above the least does not matter, and is told as 0
    least = np.median(found[asked])
    some = foretelling.ratios(u, least)
    np.testing.assert_array_equal(some, np.where(found > least - ROUNDED, found, 0.0))
    assert foretelling.most_strained(u, asked) > least


def test_no_bond_is_foretold_across_a_notch():
    """Both flanks move apart as they are: nothing stretches."""
    simulation = Simulation(plate(), mpi().COMM_SELF)
    share, foretelling = simulation.share, simulation.region_watch.foretelling
    simulation.displace(lambda x: np.where(x[:, :1] > 9.0, [[1.0, 0.0, 0.0]], 0.0) * (x[:, 1:2] < 7.0))
    ratio = foretelling.ratios(simulation.state.u, 0.0)
    low = share.mesh.centroids[foretelling.cells][:, 1] < 1.5
    assert ratio[low].max() < 1e-6
    assert ratio.max() > 10.0


def test_what_is_beyond_damage_is_looked_at():
    """Two halves that part: no cell is strained, and bonds from one to the other are stretched without limit."""
    simulation = Simulation(plate(remove=(), cracks=CRACK), mpi().COMM_SELF)
    share, foretelling = simulation.share, simulation.region_watch.foretelling
    x = share.mesh.centroids[:, 0]
    torn = np.abs(x - 9.0) < 1.0
    simulation.displace(lambda place: np.where(place[:, :1] > 9.0, [[1.0, 0.0, 0.0]], 0.0))
    beside = ~share.found.is_turned[foretelling.cells] & (np.abs(x[foretelling.cells] - 9.0) < 1.0)
    found = foretelling.ratios(simulation.state.u, 1.0, torn)
    assert np.count_nonzero(beside) > 2
    assert (found[beside] > 100.0).all()


@pytest.mark.parametrize("symmetry", [(), ("z-", "z+")])
def test_what_opens_between_cells_is_looked_at(symmetry):
    """Bonds' cells that move by themselves: none is strained, and bonds from one to the next are stretched."""
    simulation = Simulation(plate(remove=(), symmetry=symmetry, cracks=CRACK), mpi().COMM_SELF)
    foretelling, share, model = simulation.region_watch.foretelling, simulation.share, simulation.model
    u = np.zeros(len(simulation.state.u))
    points = model.unknowns.of_points(u)  # a view
    moved = np.random.default_rng(5).normal(size=(len(points) // 24, 3)) * 1e-3
    if symmetry:
        moved[:, 2] = 0.0
    by_component(points).reshape(-1, 2, 3, 4)[:] = moved[:, None, :, None]
    assert (u != 0.0).any()
    asked = ~share.found.is_turned[foretelling.cells]
    x = gauss_positions(share.mesh.nodes[share.mesh.cells[foretelling.cells]])
    expected = dense(x, foretelling.place(u), bool(symmetry)) * asked
    least = 0.3 * expected.max()
    found = foretelling.ratios(u, least)
    assert np.count_nonzero(expected > 2.0 * least) > 5
    np.testing.assert_allclose(found, np.where(expected > least, expected, 0.0), atol=2.0 * ROUNDED)


def test_later_looks_tell_what_a_first_one_would(monkeypatch):
    """A notch that opens little by little, elsewhere torn, under a load that falls: fewer cells are searched."""
    simulation = Simulation(plate(), mpi().COMM_SELF)
    scene, share, model = simulation.scene, simulation.share, simulation.model
    later, searched, raise_ratios = simulation.region_watch.foretelling, [], module.raise_ratios

    def counted(*values):
        searched[-1] += len(values[5])
        raise_ratios(*values)

    x = share.mesh.centroids
    random, torn = np.random.default_rng(7), np.zeros(len(share.cell_owner), bool)
    next(simulation.follow())
    u = simulation.state.u.copy()
    monkeypatch.setattr(module, "raise_ratios", counted)
    of_later, of_first = 0, 0
    for k in range(12):
        u = u * (1.0 + 0.01 * np.sin(k)) + random.normal(size=len(u)) * 1e-6
        if k == 6:
            torn = share.found.is_turned & (np.abs(x[:, 0] - 9.0) < 1.0) & (x[:, 1] < 6.0)
        least = np.where(x[later.cells, 1] < 2.0 + k, 0.5, 0.8)
        searched.append(0)
        found = later.ratios(u, least, torn)
        of_later += searched[-1]
        searched.append(0)
        np.testing.assert_array_equal(found, Foretelling(scene, share, model).ratios(u, least, torn))
        of_first += searched[-1]
    assert (found > 0.0).any()
    assert 0 < 2 * of_later < of_first
