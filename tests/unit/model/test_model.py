"""A model's constants: layouts, element shapes, masses."""

import numpy as np
import pytest

from pdfem_mpi.finite_elements import elements as elements_module
from pdfem_mpi.kernels.element_tables import element_stiffness
from pdfem_mpi.peridynamics.clusters import cluster_layout, point_rows
from support.bodies import build, make_scene

ROUND_OFF = 1e-12  # of sums of some hundred terms of one sign
SINGLE = 1e-7  # relative: stored numbers of bonds are in single precision


def test_cluster_layout_is_inverted_by_point_rows():
    """Every number comes back to its place, whatever the number of cells."""
    for n_cells in (0, 1, 3):
        rows = np.arange(n_cells * 24.0).reshape(n_cells, 8, 3)
        flat = cluster_layout(rows)
        assert flat.shape == (24 * n_cells,)
        assert flat.flags.c_contiguous
        np.testing.assert_array_equal(point_rows(flat), rows.reshape(-1, 3))


def test_cluster_layout_is_cluster_component_lane():
    """Point 5 of the second cell: cluster 3, lane 1; its y stands at 12 cluster + 4 component + lane."""
    rows = np.zeros((2, 8, 3))
    rows[1, 5, 1] = 7.0
    assert np.flatnonzero(cluster_layout(rows)).tolist() == [12 * 3 + 4 * 1 + 1]


def test_unknowns_are_free_points_then_owned_nodes():
    model = build(make_scene((5, 2, 2), 3), loaded=False).model
    assert 3 * model.unknowns.n_points == 2 * 4 * 24
    assert model.n_unknowns == 3 * model.unknowns.n_points + 3 * 4 * 9
    assert (model.points.n_free, model.points.n_owned) == (8, 12)


@pytest.mark.parametrize("coupling", ["paper", "paper_a"])
def test_general_elements_give_the_forces_of_elements_of_one_shape(monkeypatch, coupling):
    """More shapes than MOST_SHAPES: geometry tables instead of a shared stiffness, to round-off."""
    scene = make_scene((5, 2, 2), 3, coupling=coupling)
    shared = build(scene)
    monkeypatch.setattr(elements_module, "MOST_SHAPES", 0)
    general = build(scene)
    assert shared.model.elements.general is None
    assert not general.model.elements.shared
    u = np.random.default_rng(0).uniform(-1e-3, 1e-3, shared.model.n_unknowns)
    expected = shared.internal(u)
    np.testing.assert_allclose(general.internal(u), expected, rtol=0, atol=ROUND_OFF * np.abs(expected).max())
    np.testing.assert_allclose(general.model.mass, shared.model.mass, rtol=ROUND_OFF)


def test_cells_of_a_box_share_one_stiffness():
    """Rounded coordinates of equal cells (0.1 + 0.1 + ...) do not make them other shapes."""
    scene = make_scene((7, 3, 3), 7, loads=())
    mesh = scene.mesh.model_copy(update={"lower": (0.1, 0.2, 0.3), "upper": (0.8, 0.5, 0.6), "spacing": 0.1})
    elements = build(scene.model_copy(update={"mesh": mesh})).model.elements
    assert [len(part.connectivity) for part in elements.shared] == [63]


def test_masses_of_elements():
    """Eq. 22 with 24 terms and the 1/4 of eq. 19, summed over the elements of a node."""
    model = build(make_scene((2, 1, 1), 2)).model
    corners = np.array([(r, s, t) for t in (0, 1) for s in (0, 1) for r in (0, 1)], float)
    vtk = corners[[0, 1, 3, 2, 4, 5, 7, 6]]
    single = 0.25 * np.abs(element_stiffness(vtk[None], np.ones(1), 0.25)[0]).sum(axis=1).reshape(8, 3)
    mass = model.mass.reshape(2, 2, 3, 3)  # z, y, x, component
    np.testing.assert_allclose(mass[:, :, 1], 2 * mass[:, :, 0], rtol=ROUND_OFF)
    np.testing.assert_allclose(mass[0, 0, 0], single[0], rtol=ROUND_OFF)


@pytest.mark.parametrize("kinematics", ["linear", "finite"])
def test_masses_of_points(kinematics):
    """Eq. 11: 1/4 max_d sum_j w_j (18 k / pi l^4) exp(-r^2 / l^2) |n_d| / r, times w_i, in model units."""
    model = build(make_scene((3, 2, 2), kinematics=kinematics, correction="none")).model
    x, w = point_rows(model.points.x), model.points.volume
    expected = np.zeros(len(x))
    for i in range(len(x)):
        xi = np.delete(x, i, axis=0) - x[i]
        r = np.linalg.norm(xi, axis=1)
        near = r <= 2.5 * (1 + 1e-6)
        strength = np.delete(w, i) * 18 * (2 / 3) / np.pi * np.exp(-(r**2)) * near / r
        expected[i] = 0.25 * w[i] * (strength[:, None] * np.abs(xi) / r[:, None]).sum(axis=0).max()
    found = model.mass.reshape(-1, 3, 4)
    np.testing.assert_allclose(found.swapaxes(1, 2), np.repeat(expected.reshape(-1, 4, 1), 3, axis=2), rtol=SINGLE)


def test_masses_of_overlap_nodes_are_lumped_densities():
    """Reading B: a node inside the overlap only carries its points' densities; their sum is kept."""
    coupled = build(make_scene((4, 2, 2), 2)).model
    every = build(make_scene((4, 2, 2), 2, coupling="paper_a")).model
    elements = build(make_scene((4, 2, 2), 4)).model
    n = 3 * coupled.unknowns.n_points
    of_b, of_a = (model.mass[n:].reshape(3, 3, 3, 3) for model in (coupled, every))  # z, y, x, component
    whole = elements.mass.reshape(3, 3, 5, 3)
    # the last plane of nodes belongs to overlap elements only; reading A adds what their elements have there
    np.testing.assert_allclose(of_a[:, :, 2] - of_b[:, :, 2], whole[:, :, 0], rtol=1e-9)
    np.testing.assert_allclose(of_b[:, :, 0], whole[:, :, 0], rtol=ROUND_OFF)


def test_bar_without_correction_has_nothing_remaining():
    assert build(make_scene((3, 2, 2), correction="none")).model.correction_remaining == 0.0
