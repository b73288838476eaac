"""Which cells may be turned into bonds, and what surrounds them."""

import numpy as np
import pytest

from pdfem_mpi.body.discretization import discretize
from pdfem_mpi.body.found_region import Turning, turn
from pdfem_mpi.body.near_cracks import distance_to_polygon
from pdfem_mpi.deck.table import SceneError
from support.adaptive import plate

SCENE = plate(remove=())
NONE = np.empty(0, np.int64)


def turned(scene=SCENE, **keys):
    elements = discretize(scene)
    return elements, turn(scene, elements, Turning(NONE, **{"near_cells": NONE} | keys))


def test_cells_are_elements_until_they_are_turned():
    elements, region = turned()
    assert not region.whole.has_points.any()
    assert region.whole.has_stiffness.all()
    assert elements.units.length == 1.0


def test_held_cells_stay_elements_with_room_for_band_and_overlap():
    """Supports hold the first and last layer; overlap and band take one layer each."""
    elements, region = turned()
    x = elements.mesh.centroids[:, 0]
    np.testing.assert_array_equal(region.rows.can_turn, (x > 3.0) & (x < 15.0))


def test_bonds_that_may_fail_are_surrounded():
    elements, _ = turned()
    seed = np.flatnonzero(np.linalg.norm(elements.mesh.centroids - [8.5, 5.5, 0.5], axis=1) < 0.1)
    _, region = turned(near_cells=seed, radius=2.0)
    mesh, rows = elements.mesh, region.rows
    assert np.count_nonzero(rows.is_turned) == 13
    np.testing.assert_array_equal(rows.is_held, mesh.neighbours(rows.is_turned) & ~rows.is_turned)
    np.testing.assert_array_equal(region.whole.is_peridynamic, rows.is_turned | rows.is_held)
    # all but the middle have a cell within 1.5 that is not turned
    np.testing.assert_array_equal(np.flatnonzero(rows.is_turned & ~rows.too_near), seed)
    again = turn(SCENE, elements, Turning(rows.turned, NONE))
    np.testing.assert_array_equal(again.whole.has_points, region.whole.has_points)


def test_a_body_that_is_held_everywhere_has_no_cell_to_turn():
    scene = plate(remove=(), adaptive={"buffer_layers": 9})
    with pytest.raises(SceneError, match="no cell that could be turned"):
        turned(scene)


def test_distance_to_a_polygon():
    square = np.array([[0.0, 0, 0], [2, 0, 0], [2, 2, 0], [0, 2, 0]])
    x = np.array([[1.0, 1, 3], [3, 1, 0], [3, 3, 0], [1, 1, 0], [-1, 1, 1]])
    np.testing.assert_allclose(distance_to_polygon(x, square), [3, 1, 2**0.5, 0, 2**0.5])


def test_distance_to_a_polygon_that_is_tilted():
    """Above the inside it is the height, whatever axis the normal is nearest to."""
    side = 4.0 / np.sqrt(2.0)
    square = np.array([(0.0, 0.0, 0.0), (side, 0.0, side), (side, 4.0, side), (0.0, 4.0, 0.0)])
    middle = square.mean(axis=0)
    normal = np.array([-1.0, 0.0, 1.0]) / np.sqrt(2.0)
    assert distance_to_polygon((middle + 2.5 * normal)[None], square) == pytest.approx(2.5)
    beyond = np.array([[side + 1.0, 2.0, side + 1.0]])
    assert distance_to_polygon(beyond, square) == pytest.approx(np.sqrt(2.0))
