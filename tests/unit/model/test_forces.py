"""Internal forces of a whole model against slow sums in numpy; quanta that follow the displacements."""

import numpy as np
import pytest

from pdfem_mpi.kernels.element_tables import element_stiffness
from pdfem_mpi.kernels.hex8 import SHAPE_AT_GAUSS, gauss_positions
from pdfem_mpi.peridynamics.clusters import cluster_layout, point_rows
from support import total_lagrangian
from support.bodies import build, make_scene

# Stored numbers of bonds are in single precision, 2**-24 each; a point's force is the small difference of large ones
SINGLE = 1e-6  # of the largest force
QUANTA = 1e-10  # of the largest force: sums are rounded to 2**-50 of bounds that may be 2**12 above what is met

SCENES = {
    "peridynamics": ((4, 2, 2), 0, {}),
    "elements": ((4, 2, 2), 4, {}),
    "reading B": ((5, 2, 2), 3, {}),
    "reading A, overlap 2": ((5, 2, 2), 3, {"coupling": "paper_a", "overlap": 2}),
}


def body_of(name, kinematics="linear"):
    cells, n_elements, options = SCENES[name]
    return build(make_scene(cells, n_elements, kinematics=kinematics, correction="none", **options))


def random_displacements(body, size=1e-3, seed=0):
    return size * np.random.default_rng(seed).uniform(-1.0, 1.0, body.model.n_unknowns)


def bond_forces(x, w, u, kinematics):
    """Eqs 2, 3 and 14 in model units, point by point: force on each point times its volume."""
    force = np.zeros_like(x)
    for i in range(len(x)):
        xi, eta = np.delete(x, i, axis=0) - x[i], np.delete(u, i, axis=0) - u[i]
        r = np.linalg.norm(xi, axis=1)
        strength = 6 / np.pi * np.exp(-(r**2)) * np.delete(w, i) * w[i] * (r <= 2.5 * (1 + 1e-6))
        if kinematics == "linear":
            stretch, direction = (eta * xi).sum(axis=1) / r**2, xi / r[:, None]
        else:
            y = xi + eta
            length = np.linalg.norm(y, axis=1)
            stretch, direction = length / r - 1, y / length[:, None]
        force[i] = ((strength * stretch)[:, None] * direction).sum(axis=0)
    return force


def expected_forces(body, u, kinematics):
    """All internal forces of a model on one rank, eqs 2-4, 14-16, 25 and 26, in model units.

    Lame's moduli of E = 1 and nu = 1/4 are both 0.4.
    """
    model, share = body.model, body.share
    n = 3 * model.unknowns.n_points
    mesh, nodes = share.mesh, share.nodes
    on_nodes, u_nodes = np.zeros_like(nodes), np.zeros_like(nodes)
    u_nodes[share.node_row >= 0] = u[n:].reshape(-1, 3)
    for cell in np.flatnonzero(share.has_stiffness):
        corners = mesh.cells[cell]
        stiffness = element_stiffness(nodes[corners][None], np.ones(1), 0.25)[0]
        force = (stiffness @ u_nodes[corners].ravel()).reshape(8, 3)
        if kinematics == "finite":
            force = total_lagrangian.element(nodes[corners], u_nodes[corners], 0.4, 0.4).force
        on_nodes[corners] -= force
    on_points = np.empty(0)
    if model.points:
        of_rank = share.subdomain
        cells = np.concatenate([of_rank.free, of_rank.overlap]).astype(int)
        x = gauss_positions(nodes[mesh.cells[cells]])
        moved = np.concatenate(
            [
                point_rows(u[:n]).reshape(-1, 8, 3),
                np.einsum("pa,nad->npd", SHAPE_AT_GAUSS, u_nodes[mesh.cells[of_rank.overlap]]),
            ]
        )
        force = bond_forces(x.reshape(-1, 3), model.points.volume, moved.reshape(-1, 3), kinematics)
        force = force.reshape(-1, 8, 3)
        on_points = cluster_layout(force[: len(of_rank.free)])
        for cell, of_points in zip(of_rank.overlap, force[len(of_rank.free) :], strict=True):
            on_nodes[mesh.cells[cell]] += SHAPE_AT_GAUSS.T @ of_points
    return np.concatenate([on_points, on_nodes[share.node_row >= 0].reshape(-1)])


@pytest.mark.parametrize("kinematics", ["linear", "finite"])
@pytest.mark.parametrize("name", SCENES)
def test_forces_are_those_of_the_equations(name, kinematics):
    body = body_of(name, kinematics)
    u = random_displacements(body)
    expected = expected_forces(body, u, kinematics)
    np.testing.assert_allclose(body.internal(u), expected, rtol=0, atol=SINGLE * np.abs(expected).max())


@pytest.mark.parametrize("size", [1e-6, 0.02, 0.2])
def test_finite_stretch_of_any_size(size):
    """The series for small stretches and the closed form for large ones: both are eq. 3."""
    body = body_of("peridynamics", "finite")
    u = random_displacements(body, size)
    expected = expected_forces(body, u, "finite")
    # differences of lengths in numpy lose what the small stretch has not
    np.testing.assert_allclose(
        body.internal(u), expected, rtol=0, atol=(SINGLE + 1e-14 / size) * np.abs(expected).max()
    )


def test_external_forces_are_added():
    body = body_of("reading B")
    u, external = random_displacements(body), random_displacements(body, 1.0, 1)
    force = np.empty_like(u)
    body.forces.evaluate_surely(u, external, force)
    np.testing.assert_allclose(force, body.internal(u) + external, rtol=0, atol=QUANTA)


@pytest.mark.parametrize("name", SCENES)
def test_linear_forces_scale_with_the_displacements(name):
    """Quanta follow the displacements over 40 orders of magnitude; a factor of 2**n changes no digit that counts."""
    body = body_of(name)
    u = random_displacements(body)
    expected = body.internal(u)
    for factor in (2.0**-80, 2.0**40, 2.0**-10, 1.0):
        body.internal(factor * u)  # a bound far above what is met is lowered for the next evaluation
        found = body.internal(factor * u) / factor
        np.testing.assert_allclose(found, expected, rtol=0, atol=QUANTA * np.abs(expected).max())


@pytest.mark.parametrize("kinematics", ["linear", "finite"])
@pytest.mark.parametrize("name", SCENES)
def test_forces_do_not_depend_on_what_was_evaluated_before(name, kinematics):
    """At rest, far out, and back: only quanta may differ, and they are far below the forces."""
    body = body_of(name, kinematics)
    u = random_displacements(body)
    expected = body_of(name, kinematics).internal(u)
    for before in (np.zeros_like(u), 100 * u, 1e-12 * u):
        body.internal(before)
        np.testing.assert_allclose(body.internal(u), expected, rtol=0, atol=QUANTA * np.abs(expected).max())


@pytest.mark.parametrize("name", ["reading B", "reading A, overlap 2"])
@pytest.mark.parametrize("at_rest", ["points", "nodes"])
def test_one_description_at_rest(name, at_rest):
    """Forces of the other one are exact however small the differences of displacements are in the first."""
    body = body_of(name)
    n = 3 * body.model.unknowns.n_points
    u = random_displacements(body)
    u[slice(0, n) if at_rest == "points" else slice(n, None)] = 0.0
    expected = expected_forces(body, u, "linear")
    for _ in range(3):  # bounds are fitted from one evaluation to the next
        np.testing.assert_allclose(body.internal(u), expected, rtol=0, atol=SINGLE * np.abs(expected).max())


def test_a_body_at_rest_has_no_force():
    for name in SCENES:
        body = body_of(name)
        assert not body.internal(np.zeros(body.model.n_unknowns)).any()


def test_point_displacements_include_the_overlap():
    """Eq. 25: a linear field of the nodes is the same linear field at the overlap's points."""
    body = body_of("reading A, overlap 2")
    body.internal(body.of_positions(lambda x: 1e-3 * x))
    x = point_rows(body.model.points.x)
    found = body.forces.point_displacements()
    assert len(found) == 8 * body.model.points.n_owned == 8 * 4 * 4
    np.testing.assert_allclose(found, 1e-3 * x, rtol=0, atol=1e-17)


def test_every_evaluation_is_counted():
    body = body_of("peridynamics")
    u = random_displacements(body)
    body.internal(u)  # fits the bounds
    before = body.forces.evaluations
    body.internal(u)
    body.internal(u)
    assert body.forces.evaluations == before + 2


@pytest.mark.parametrize("largest_e", [0.0, 1.0], ids=["series", "closed form"])
@pytest.mark.parametrize("name", SCENES)
def test_tangent_is_the_derivative_of_the_finite_forces(name, largest_e):
    """Central differences of the finite forces of bonds and elements against the tangent sweep, at strains of several
    per cent and, for the series, a fifth of that."""
    body = body_of(name, "finite")
    gradient = np.array([[0.06, 0.02, 0.0], [0.0, -0.03, 0.04], [0.01, 0.0, -0.05]]) * (1.0 if largest_e else 0.2)
    u = body.of_positions(lambda x: x @ gradient)
    v = random_displacements(body, 1.0, seed=3)
    h = 1e-4
    difference = (body.internal(u + h * v) - body.internal(u - h * v)) / (2 * h)
    tangent = type(body.forces)(body.model, tangent=True)
    tangent.linearise(u, largest_e)
    force = np.empty_like(u)
    tangent.evaluate_surely(v, np.zeros_like(u), force)
    second_order = 10 * h**2  # relative: truncation of central differences over bonds half a unit long
    assert np.abs(force - difference).max() <= (second_order + SINGLE) * np.abs(force).max()
