"""The whole body on its cells: nodes between elements and points, and the damage of cells."""

import numpy as np

from pdfem_mpi.measure.body_fields import cell_damage, cell_fields, corner_displacements
from pdfem_mpi.measure.fields import Fields
from pdfem_mpi.measure.geometry import gather_geometry
from support.bodies import local_share, make_scene

ROUND_OFF = 1e-14  # of displacements near 1: sums of eight products


def test_a_uniform_strain_is_found_at_every_corner():
    """A linear field is in the space of both descriptions, so that corners of both have its values."""
    body = gather_geometry(local_share(make_scene((6, 3, 2), 3)))
    gradient = np.array([[0.3, 0.1, 0.0], [-0.2, 0.5, 0.4], [0.0, 0.1, -0.1]])
    fields = Fields(body.point_positions @ gradient, body.node_positions @ gradient)
    found = corner_displacements(body, fields)
    assert found.shape == body.mesh.nodes.shape
    np.testing.assert_allclose(found, body.mesh.nodes @ gradient, rtol=0.0, atol=ROUND_OFF * np.abs(found).max())


def test_nodes_of_elements_keep_their_own_displacements():
    body = gather_geometry(local_share(make_scene((6, 3, 2), 3)))
    own = np.random.default_rng(5).random(body.node_positions.shape)
    found = corner_displacements(body, Fields(np.zeros_like(body.point_positions), own))
    np.testing.assert_array_equal(found[body.node_row >= 0], own)


def test_damage_of_a_cell_is_the_mean_of_its_points():
    body = gather_geometry(local_share(make_scene((6, 3, 2), 3)))
    damage = np.random.default_rng(6).random(len(body.point_positions))
    found = cell_damage(body, damage)
    assert (found[~body.has_points] == 0.0).all()
    np.testing.assert_allclose(found[body.has_points], damage.reshape(-1, 8).mean(axis=1))


def test_other_fields_are_means_over_the_points_of_a_cell():
    """Where a cell has elements and points, those of the points; NaN where a part does not have a field."""
    body = gather_geometry(local_share(make_scene((6, 3, 2), 3)))
    rng = np.random.default_rng(7)
    points, cells = rng.random((len(body.point_positions), 6)), rng.random((np.count_nonzero(body.has_nodes), 6))
    fields = Fields(None, None, {"stress": points, "only_points": points[:, 0]}, {"stress": cells})
    found = cell_fields(body, fields)
    np.testing.assert_allclose(found["stress"][body.has_points], points.reshape(-1, 8, 6).mean(axis=1))
    alone = body.has_nodes & ~body.has_points
    np.testing.assert_array_equal(found["stress"][alone], cells[~body.has_points[body.has_nodes]])
    assert np.isnan(found["only_points"][alone]).all()
