"""The whole body on its cells: nodes between elements and points, and the damage of cells."""

import numpy as np

from pdfem_mpi.body.discretization import discretize
from pdfem_mpi.measure.body_fields import cell_damage, corner_displacements
from pdfem_mpi.measure.fields import Fields, node_positions, point_positions
from support.bodies import make_scene

ROUND_OFF = 1e-14  # of displacements near 1: sums of eight products


def test_a_uniform_strain_is_found_at_every_corner():
    """A linear field is in the space of both descriptions, so that corners of both have its values."""
    body = discretize(make_scene((6, 3, 2), 3))
    gradient = np.array([[0.3, 0.1, 0.0], [-0.2, 0.5, 0.4], [0.0, 0.1, -0.1]])
    fields = Fields(point_positions(body) @ gradient, node_positions(body) @ gradient)
    found = corner_displacements(body, fields)
    assert found.shape == body.mesh.nodes.shape
    np.testing.assert_allclose(found, body.mesh.nodes @ gradient, rtol=0.0, atol=ROUND_OFF * np.abs(found).max())


def test_nodes_of_elements_keep_their_own_displacements():
    body = discretize(make_scene((6, 3, 2), 3))
    own = np.random.default_rng(5).random(node_positions(body).shape)
    found = corner_displacements(body, Fields(np.zeros_like(point_positions(body)), own))
    np.testing.assert_array_equal(found[body.node_number >= 0], own)


def test_damage_of_a_cell_is_the_mean_of_its_points():
    body = discretize(make_scene((6, 3, 2), 3))
    damage = np.random.default_rng(6).random(8 * body.n_point_cells)
    found = cell_damage(body, damage)
    assert (found[~body.has_points] == 0.0).all()
    np.testing.assert_allclose(found[body.has_points], damage.reshape(-1, 8).mean(axis=1))
