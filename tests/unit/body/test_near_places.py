"""Nearest places and numbers of near ones, against all pairs."""

import numpy as np
import pytest

from pdfem_mpi.body.near_places import NearPlaces, nearest_distances

REACH = 0.7


def apart(places, x):
    """Distances of all pairs, the squares summed along x, y, z; shape (n, n_places)."""
    square = (x[:, None, 0] - places[:, 0]) ** 2
    for axis in (1, 2):
        square = square + (x[:, None, axis] - places[:, axis]) ** 2
    return np.sqrt(square)


def scattered(n, seed, size=4.0):
    return np.random.default_rng(seed).uniform(-size, size, size=(n, 3)) + 10.0


@pytest.mark.parametrize("n", [1, 3, 400])
def test_the_nearest_and_the_number_within_the_reach_are_those_of_all_pairs(n):
    """Also of places far from all others, in every bit."""
    places, x = scattered(n, 1), np.concatenate([scattered(200, 2, size=6.0), np.full((2, 3), [[1e12], [-1e12]])])
    every = apart(places, x)
    nearest = every.min(axis=1)
    near = NearPlaces(places, REACH)
    np.testing.assert_array_equal(near.distances(x), np.where(nearest <= REACH, nearest, np.inf))
    np.testing.assert_array_equal(near.counts(x), (every <= REACH).sum(axis=1))
    np.testing.assert_array_equal(nearest_distances(places, x, REACH), nearest)


def test_on_a_lattice_places_as_far_as_the_reach_are_near():
    """A reach of whole edges lies on the borders of bins."""
    lattice = np.stack(np.meshgrid(*[np.arange(7.0)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    every = apart(lattice, lattice)
    for edge in (1.0, 0.25):
        counts = NearPlaces(edge * lattice, 2.0 * edge).counts(edge * lattice)
        np.testing.assert_array_equal(counts, (every <= 2.0).sum(axis=1))


def test_few_places_far_apart_take_few_bins():
    places = np.array([[0.0, 0.0, 0.0], [1e6, 1e6, 1e6]])
    near = NearPlaces(places, 1.0)
    assert len(near._bins[4]) < 100
    np.testing.assert_array_equal(near.distances(places + 0.5), [np.sqrt(0.75)] * 2)


def test_without_places_none_is_near():
    near = NearPlaces(np.empty((0, 3)), REACH)
    assert np.isinf(near.distances(np.zeros((2, 3)))).all() and not near.counts(np.zeros((2, 3))).any()
