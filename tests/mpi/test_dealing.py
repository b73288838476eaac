"""What ranks deal out together: cells as `bisect` deals out all of them, numbers by a directory, the median of all."""

import numpy as np
import pytest

from pdfem_mpi.mesh.generators import box, plate_with_hole
from pdfem_mpi.parallel.bisection import bisect
from pdfem_mpi.parallel.comm import world
from pdfem_mpi.parallel.dealing import deal, median
from pdfem_mpi.parallel.directory import Directory
from support.helpers import assert_all

pytestmark = pytest.mark.mpi

MESHES = {
    "box": lambda: box((-1.0, 0.0, 0.0), (11.0, 5.0, 4.0), (24, 10, 8)),
    "plate": lambda: plate_with_hole((-2.0, -1.0, -0.1), (2.0, 1.0, 0.1), 0.4, 0.1),
    "few cells": lambda: box((0.0, 0.0, 0.0), (3.0, 3.0, 3.0), (3, 3, 3)),
}


def weights_of(mesh, kind, rng):
    n = len(mesh.cells)
    if kind == "equal":
        return np.ones(n, np.int64)
    # elements in one part, bonds in the other
    return np.where(mesh.centroids[:, 0] > 0.3, rng.integers(2000, 3300, n), 60)


@pytest.mark.parametrize("mesh", MESHES)
@pytest.mark.parametrize("kind", ["equal", "random"])
def test_owners_are_those_of_bisection(mesh, kind):
    """Wherever the cells are held before: here in blocks, and scattered."""
    comm, rng = world(), np.random.default_rng(5)
    mesh = MESHES[mesh]()
    n, weights = len(mesh.cells), weights_of(mesh, kind, rng)
    expected = bisect(mesh.centroids, weights, comm.size)
    for held in (np.arange(n) * comm.size // n, rng.integers(0, comm.size, n)):
        here = np.flatnonzero(held == comm.rank)
        ids, places = deal(comm, here, mesh.centroids[here], weights[here])
        assert_all(comm, np.array_equal(ids, np.flatnonzero(expected == comm.rank)), f"{len(ids)} cells")
        assert_all(comm, np.array_equal(places, mesh.centroids[ids]))


def test_equal_coordinates_are_taken_by_number():
    """All cells at three places: planes step inside of a layer."""
    comm, n = world(), 60
    places = np.repeat([[-0.0, 0.0, -1.0], [0.0, 0.0, -1.0], [-2.5, 0.0, 3.0]], n // 3, axis=0)
    weights = np.random.default_rng(1).integers(1, 5, n)
    here = np.arange(comm.rank, n, comm.size)
    ids, _ = deal(comm, here, places[here], weights[here])
    expected = bisect(places, weights, comm.size)
    assert_all(comm, np.array_equal(ids, np.flatnonzero(expected == comm.rank)), f"{ids}")


def test_what_is_no_weight_or_place_is_refused():
    comm = world()
    for place, weight in ((0.0, 0), (np.inf, 1)):
        with pytest.raises(ValueError, match="places must be finite and weights positive"):
            deal(comm, np.array([comm.rank]), np.full((1, 3), place), np.array([weight]))


def test_a_directory_knows_what_ranks_told_it():
    """Values of ids in any order, and -1 of what nobody told."""
    comm, n = world(), 50
    told = np.arange(comm.rank, n, 2 * comm.size)
    directory = Directory.of(comm, told, 100 * told + comm.rank, n)
    asked = np.random.default_rng(comm.rank).integers(0, n, 30)
    known = asked % (2 * comm.size) < comm.size
    expected = np.where(known, 100 * asked + asked % (2 * comm.size), -1)
    assert_all(comm, np.array_equal(directory.ask(asked), expected))
    assert_all(comm, not len(directory.ask(asked[:0])))


def test_places_count_what_ranks_have_in_rising_order():
    """Also where several ranks have the same."""
    comm, n = world(), 40
    everything = np.arange(0, n, 3)
    mine = np.union1d(everything[comm.rank :: comm.size], everything[:2])
    found = Directory.of_places(comm, mine[::-1], n)
    assert_all(comm, np.array_equal(found.ask(np.arange(n)), np.where(np.arange(n) % 3 == 0, np.arange(n) // 3, -1)))


@pytest.mark.parametrize("n", [7, 8])
def test_the_median_is_that_of_all(n):
    comm = world()
    values = np.random.default_rng(n).normal(size=n)
    assert_all(comm, median(comm, values[comm.rank :: comm.size]) == np.median(values))
