"""Displacements at points, and the numbers of a bar, from fields that are known in closed form."""

import numpy as np
import pytest

from pdfem_mpi.deck.materials import Material
from pdfem_mpi.deck.outputs import BarProbe, LineProbe
from pdfem_mpi.deck.regions import Region
from pdfem_mpi.measure.bar import bar_results, measure_bar
from pdfem_mpi.measure.displacement import displacement_at
from pdfem_mpi.measure.fields import Fields
from pdfem_mpi.measure.line import measure_line
from support.bodies import fields_of_positions, geometry_of, make_scene

ROUND_OFF = 1e-13  # of Newton's method, which ends at steps of 1e-13, and of eight products
FIT = 1e-10  # relative, of straight lines through some hundred points

CELLS = 12, 2, 2
GRADIENT = np.array([[1.0, 0.5, -0.25], [0.125, -0.5, 2.0], [-1.0, 0.75, 0.25]]) * 1e-3
SHIFT = np.array([0.01, -0.02, 0.03])

POINTS = {
    "inside a cell of elements": (0.3, 0.6, 1.9),
    "inside the overlap": (5.4, 0.3, 0.7),
    "inside a peridynamic cell": (9.21, 1.55, 0.4),
    "node": (2.0, 1.0, 1.0),
    "interface": (6.0, 0.7, 0.7),
    "corner of the body, elements": (0.0, 0.0, 0.0),
    "corner of the body, peridynamics": (12.0, 2.0, 2.0),
    "edge of peridynamic cells": (9.0, 1.0, 1.5),
}


def linear(x):
    return x @ GRADIENT.T + SHIFT


@pytest.fixture(scope="module", params=[0, 6, 12], ids=["peridynamics", "coupled", "elements"])
def body(request):
    return geometry_of(make_scene(CELLS, request.param, loads=()))


@pytest.mark.parametrize("where", POINTS)
def test_displacement_of_a_linear_field_is_exact(body, where):
    """Shape functions in elements, the trilinear function through eight points in peridynamic cells."""
    found = displacement_at(body, fields_of_positions(body, linear), POINTS[where])
    np.testing.assert_allclose(found, linear(np.array(POINTS[where])), rtol=0, atol=ROUND_OFF)


def test_displacement_of_a_trilinear_field_is_exact(body):
    """x y z is in the space of both interpolations, cell by cell."""

    def product(x):
        return np.stack([x.prod(axis=1), x[:, 0] * x[:, 1], x[:, 2]], axis=1)

    for point in POINTS.values():
        found = displacement_at(body, fields_of_positions(body, product), point)
        np.testing.assert_allclose(found, product(np.array([point]))[0], rtol=0, atol=100 * ROUND_OFF)


@pytest.mark.parametrize(
    ("point", "nearest"),
    [
        ((12.2, 1.7, 1.3), (12.0, 1.7, 1.3)),
        ((12.8, 1.0, 1.3), (12.0, 1.0, 1.3)),
        ((13.0, 2.5, 1.3), (12.0, 2.0, 1.3)),
        ((-5.0, 0.5, 1.5), (0.0, 0.5, 1.5)),
    ],
)
def test_point_outside_takes_the_nearest_of_the_body(body, point, nearest):
    """The nearest cell is evaluated at its nearest point."""
    found = displacement_at(body, fields_of_positions(body, linear), point)
    np.testing.assert_allclose(found, linear(np.array(nearest)), rtol=0, atol=ROUND_OFF)


STRESS, FACTOR = 2.0, 0.5  # eps = 1e-3 with E = 1000
PROBE = BarProbe(kind="bar", axis="x", stress=STRESS)
LENGTH, STRAIN = 40, FACTOR * STRESS / 1000.0


def measured(n_elements, displacement, cells=(LENGTH, 2, 2), probe=PROBE, regions=None):
    """Results of a bar whose nodes and points move by a function of positions."""
    scene = make_scene(cells, n_elements, loads=(), regions=regions)
    body = geometry_of(scene)
    bar = measure_bar(scene, body, fields_of_positions(body, displacement), probe, FACTOR)
    return bar, bar_results(scene, body, bar, probe, FACTOR)


def tension(scale=1.0, nu=0.25, axis=0):
    """Uniform tension, ``scale`` times the exact strain, and a rigid translation."""
    factors = np.full(3, -nu)
    factors[axis] = 1.0
    return lambda x: scale * STRAIN * x * factors + SHIFT


@pytest.mark.parametrize("n_elements", [0, LENGTH], ids=["peridynamics", "elements"])
def test_bar_of_one_model(n_elements):
    """5 % too long: end error of the outermost layer, over the displacement of the end face; E / E0; nu."""
    bar, results = measured(n_elements, tension(1.05, 0.3))
    name = "elements" if n_elements else "peridynamics"
    name = "finite_elements" if n_elements else name
    last = 0.5 * LENGTH - 0.5
    assert results["end_displacement"] == pytest.approx(1.05 * STRAIN * last, rel=FIT)
    assert results["end_error_percent"] == pytest.approx(5.0 * last / (0.5 * LENGTH), rel=FIT)
    assert results[f"modulus_ratio_{name}"] == pytest.approx(1 / 1.05, rel=FIT)
    assert results[f"poissons_ratio_{name}"] == pytest.approx(0.3, rel=FIT)
    assert "interface_jump" not in results
    assert bar.interface is None
    np.testing.assert_allclose(bar.displacement, 1.05 * bar.exact, rtol=0, atol=FIT * STRAIN)


@pytest.mark.parametrize("axis", "yz")
def test_bar_along_another_axis(axis):
    d = "xyz".index(axis)
    cells = tuple(16 if k == d else 2 for k in range(3))
    _, results = measured(0, tension(0.98, axis=d), cells, BarProbe(kind="bar", axis=axis, stress=STRESS))
    assert results["modulus_ratio_peridynamics"] == pytest.approx(1 / 0.98, rel=FIT)


@pytest.mark.parametrize("mirrored", [False, True], ids=["peridynamics right", "peridynamics left"])
def test_coupled_bar(mirrored):
    """Slopes of the halves, and the peridynamic line minus the other at the interface in eps Delta."""
    middle = LENGTH // 2
    regions = None
    if mirrored:
        regions = (
            Region(name="bonds", model="peridynamics", upper=(float(middle), 2.0, 2.0)),
            Region(name="elements", model="finite_elements", lower=(float(middle), 0.0, 0.0)),
        )

    def broken(x):
        far = (x[:, 0] < middle) if mirrored else (x[:, 0] > middle)
        along = (x[:, 0] - middle) * np.where(far, 1.05, 1.0) + 0.3 * far
        return STRAIN * np.stack([along, -0.25 * x[:, 1], -0.25 * x[:, 2]], axis=1)

    bar, results = measured(middle, broken, regions=regions)
    assert bar.interface == middle
    assert bar.overlap == ((middle, middle + 1) if mirrored else (middle - 1, middle))
    assert np.count_nonzero(bar.has_points) == middle
    assert results["modulus_ratio_finite_elements"] == pytest.approx(1.0, rel=FIT)
    assert results["modulus_ratio_peridynamics"] == pytest.approx(1 / 1.05, rel=FIT)
    assert results["interface_jump"] == pytest.approx(0.3, rel=FIT)


def test_disturbed_ends_and_interface_are_left_out_of_the_lines():
    """What happens within two cutoff radii (5 cells) of the ends and of the interface does not move the slopes."""
    middle = LENGTH // 2

    def disturbed(x):
        near = np.minimum(np.minimum(x[:, 0], LENGTH - x[:, 0]), np.abs(x[:, 0] - middle)) < 5.0
        return tension()(x) + 0.1 * STRAIN * near[:, None]

    _, results = measured(middle, disturbed)
    assert results["modulus_ratio_finite_elements"] == pytest.approx(1.0, rel=FIT)
    assert results["modulus_ratio_peridynamics"] == pytest.approx(1.0, rel=FIT)


def test_peridynamic_middle_between_elements_has_one_line_each():
    """Two interfaces: the interface told is one of them, between peridynamic cells and the overlap."""
    regions = (
        Region(name="left", model="finite_elements", upper=(14.0, 2.0, 2.0)),
        Region(name="bonds", model="peridynamics", lower=(14.0, 0.0, 0.0), upper=(26.0, 2.0, 2.0)),
        Region(name="right", model="finite_elements", lower=(26.0, 0.0, 0.0)),
    )
    bar, _ = measured(0, tension(), regions=regions)
    assert bar.interface in (14.0, 26.0)


def test_fields_of_the_overlap_are_not_taken_for_peridynamics():
    """Layers of the overlap are measured at their nodes; their points may hold anything."""
    scene = make_scene(CELLS, 6, loads=())
    body = geometry_of(scene)
    fields = fields_of_positions(body, tension())
    u_points = fields.u_points.reshape(-1, 8, 3).copy()
    u_points[body.point_row[body.is_overlap]] = np.nan
    bar = measure_bar(scene, body, Fields(u_points.reshape(-1, 3), fields.u_nodes), PROBE, FACTOR)
    assert np.isfinite(bar.displacement).all()
    assert np.isfinite(displacement_at(body, Fields(u_points.reshape(-1, 3), fields.u_nodes), (5.5, 1.0, 1.0))).all()


@pytest.mark.parametrize("n_elements", [0, 15], ids=["bonds alone", "behind elements"])
def test_joints_of_fitted_bodies_are_peridynamics(n_elements):
    """Two layers along a bar, cells of both at their nodes: what is no region of elements is not called so."""
    z, length = 2.0, float(LENGTH)
    regions = (
        Region(name="lower", model="peridynamics", lower=(float(n_elements), 0.0, 0.0), upper=(length, 2.0, z)),
        Region(name="upper", model="peridynamics", material="soft", lower=(float(n_elements), 0.0, z)),
    )
    if n_elements:
        regions += (Region(name="elements", model="finite_elements", upper=(float(n_elements), 2.0, 2.0 * z)),)
    scene = make_scene(
        (LENGTH, 2, 4), loads=(), regions=regions, materials={"soft": Material(youngs_modulus=500.0)},
        correction="fitted", coupling="exact",
    )  # fmt: skip
    body = geometry_of(scene)
    assert (body.is_overlap & body.is_peridynamic).any()
    fields = fields_of_positions(body, tension())
    bar = measure_bar(scene, body, fields, PROBE, FACTOR)
    results = bar_results(scene, body, bar, PROBE, FACTOR)
    np.testing.assert_array_equal(bar.has_points, np.arange(LENGTH) >= n_elements)
    assert ("modulus_ratio_finite_elements" in results) == bool(n_elements)
    assert bar.interfaces == ((float(n_elements),) if n_elements else ())
    assert bar.overlap == ((n_elements - 1.0, n_elements) if n_elements else None)
    line = LineProbe(kind="line", name="a", start=(0.5, 1.0, 1.5), stop=(length - 0.5, 1.0, 1.5), n=LENGTH)
    kind = measure_line(body, fields, line).kind
    assert set(kind[:n_elements]) <= {"finite elements"} and set(kind[n_elements:]) == {"peridynamics"}
