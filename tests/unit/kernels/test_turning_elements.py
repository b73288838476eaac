"""Elements in finite kinematics: forces, tangent, energy and deformation, against an independent element."""

import numpy as np
import pytest
from unit.kernels.bodies_of_elements import box, turn

from pdfem_mpi.kernels import element_tables as tables
from pdfem_mpi.kernels import linear_elements as fe
from pdfem_mpi.kernels import turning_elements as te
from support import total_lagrangian

QUANTUM = 2.0**-50
LAM, MU = 1.3, 0.7
#: Of the largest force: sums of some hundred terms, each rounded.
ROUND_OFF = 1e-13
#: Where displacements of the size of the body are subtracted from each other.
TURNED = 1e-14
#: Of central differences over steps of 1e-5 of forces that are cubic polynomials.
CUBIC = 1e-9


def large(x, size=0.15, seed=4):
    """Seeded displacements, multiples of 2^-30: strains of several times ten per cent."""
    return np.round(np.random.default_rng(seed).uniform(-size, size, x.shape) * 2**30) / 2**30


def arguments(x, cells, scale=1.0):
    scale = scale * np.ones(len(cells))
    return cells, tables.gradient_tables(x[cells]), LAM * scale, MU * scale


def forces(u, x, cells, scale=1.0, quantum=QUANTUM):
    """Forces in quanta, and what was met."""
    force, met = np.zeros(u.shape, np.int64), np.zeros(2)
    te.add_forces(force, u, *arguments(x, cells, scale), quantum, met)
    return force, met


def tangent(v, u, x, cells, scale=1.0, quantum=QUANTUM):
    force, met = np.zeros(u.shape, np.int64), np.zeros(2)
    te.add_tangent(force, v, u, *arguments(x, cells, scale), quantum, met)
    return force, met


def measured(u, x, cells, scale=1.0):
    """Energy, smallest det F and largest strain of each element."""
    result = np.empty((3, len(cells)))
    te.measure(u, *arguments(x, cells, scale), *result)
    return result


def expected(u, x, cells, scale):
    """Independent elements: energies, assembled forces, and tangents."""
    elements = [
        total_lagrangian.element(x[nodes], u[nodes], LAM * s, MU * s) for nodes, s in zip(cells, scale, strict=True)
    ]
    total = np.zeros_like(u)
    for nodes, element in zip(cells, elements, strict=True):
        total[nodes] -= element.force
    return np.array([element.energy for element in elements]), total, [element.tangent for element in elements]


@pytest.fixture
def scale():
    """Modulus factors of the 12 elements of the box."""
    return np.random.default_rng(5).uniform(0.5, 2.0, 12)


@pytest.mark.nojit
def test_forces_energy_and_tangent_are_those_of_an_independent_element(scale):
    """Distorted elements, displaced by as much as they are distorted."""
    x, cells = box(jitter=0.15)
    u, v = large(x), large(x, seed=5)
    energies, total, tangents = expected(u, x, cells, scale)
    force, met = forces(u, x, cells, scale)
    np.testing.assert_allclose(QUANTUM * force, total, rtol=0, atol=ROUND_OFF * abs(total).max())
    assert met[1] == abs(u[cells] - u[cells[:, :1]]).max()
    np.testing.assert_allclose(measured(u, x, cells, scale)[0], energies, rtol=ROUND_OFF)
    change = np.zeros_like(u)
    for nodes, k in zip(cells, tangents, strict=True):
        change[nodes] -= (k @ v[nodes].ravel()).reshape(8, 3)
    np.testing.assert_allclose(
        QUANTUM * tangent(v, u, x, cells, scale)[0], change, rtol=0, atol=ROUND_OFF * abs(change).max()
    )


def test_tangent_and_forces_are_derivatives_of_forces_and_energy(scale):
    """Central differences, in a random direction; the tangent is symmetric."""
    x, cells = box(jitter=0.15)
    u, v, w = large(x), large(x, 1.0, 6), large(x, 1.0, 7)
    h = 1e-5
    change = QUANTUM * (forces(u + h * v, x, cells, scale)[0] - forces(u - h * v, x, cells, scale)[0]) / (2 * h)
    of_v, of_w = (QUANTUM * tangent(direction, u, x, cells, scale)[0] for direction in (v, w))
    np.testing.assert_allclose(of_v, change, rtol=0, atol=CUBIC * abs(change).max())
    assert (of_v * w).sum() == pytest.approx((of_w * v).sum(), rel=1e-12)
    energies = [measured(u + s * h * v, x, cells, scale)[0].sum() for s in (1, -1)]
    work = -QUANTUM * forces(u, x, cells, scale)[0] * v
    assert (energies[0] - energies[1]) / (2 * h) == pytest.approx(work.sum(), abs=CUBIC * abs(work).sum())


@pytest.mark.nojit
@pytest.mark.parametrize("n", [0, 1, 2, 3, 5])
def test_short_last_groups(n, scale):
    """The repeated last element of a short group counts once, with the bits that it has in a full group."""
    x, cells = box(jitter=0.15)
    u, v = large(x), large(x, seed=5)
    part, of_tangent = np.zeros(u.shape, np.int64), np.zeros(u.shape, np.int64)
    for e in range(n):
        part += forces(u, x, cells[[e] * 4], scale[[e] * 4])[0] // 4
        of_tangent += tangent(v, u, x, cells[[e] * 4], scale[[e] * 4])[0] // 4
    assert (forces(u, x, cells[:n], scale[:n])[0] == part).all()
    assert (tangent(v, u, x, cells[:n], scale[:n])[0] == of_tangent).all()
    assert (measured(u, x, cells[:n], scale[:n]) == measured(u, x, cells, scale)[:, :n]).all()


@pytest.mark.parametrize("n_parts", [1, 2, 3, 4])
def test_order_and_parts_do_not_change_a_bit(n_parts, scale):
    """Shuffled elements, summed in parts as ranks would, with other elements in the neighbouring lanes."""
    x, cells = box(jitter=0.15)
    u, v = large(x), large(x, seed=5)
    parts = np.array_split(np.random.default_rng(7).permutation(12), n_parts)
    assert (sum(forces(u, x, cells[p], scale[p])[0] for p in parts) == forces(u, x, cells, scale)[0]).all()
    together = tangent(v, u, x, cells, scale)[0]
    assert (sum(tangent(v, u, x, cells[p], scale[p])[0] for p in parts) == together).all()


def test_one_table_serves_all_elements_of_a_shape(scale):
    x, cells = box()
    u, met = large(x), np.zeros(2)
    force = np.zeros(u.shape, np.int64)
    te.add_forces(force, u, cells, tables.gradient_tables(x[cells[:1]]), LAM * scale, MU * scale, QUANTUM, met)
    assert (force == forces(u, x, cells, scale)[0]).all()


def test_forces_and_moments_of_an_element_vanish():
    """The integer forces of one element sum to zero, and turn it about no axis where it is now."""
    x, cells = box(jitter=0.15)
    u = large(x)
    force = forces(u, x, cells[:1])[0]
    assert (force.sum(axis=0) == 0).all()
    moment = np.cross(x + u, QUANTUM * force).sum(axis=0)
    assert abs(moment).max() < ROUND_OFF * abs(QUANTUM * force).sum()


@pytest.mark.parametrize("degrees", [10.0, 90.0, 180.0])
def test_rotations_give_no_force_and_no_strain(degrees):
    """About any axis; a shift of the whole does not change a bit."""
    x, cells = box(jitter=0.15)
    u = x @ turn(degrees).T - x
    force, met = forces(u, x, cells, quantum=2.0**-60)
    assert met[0] < TURNED
    assert abs(2.0**-60 * force).max() < 8 * TURNED
    energy, ratio, strain = measured(u, x, cells)
    assert energy.max() < TURNED**2
    np.testing.assert_allclose(ratio, 1.0, rtol=0, atol=TURNED)
    assert strain.max() < TURNED
    u = large(x)
    assert (forces(u + np.array([1024.0, -3.0, 0.125]), x, cells)[0] == forces(u, x, cells)[0]).all()


@pytest.mark.parametrize("size", [1e-3, 1e-6, 1e-9])
def test_small_displacements_give_the_linear_forces(size):
    """The difference is of second order, down to strains whose squares are lost in round-off."""
    x, cells = box(jitter=0.15)
    u, linear, largest = size * large(x, 1.0), np.zeros(x.shape, np.int64), np.zeros(1)
    quantum = 2.0**-50 * size
    cells, tables, lam, mu = arguments(x, cells)
    fe.add_general_forces(linear, u, cells, tables, lam, mu, quantum, largest)
    force, _ = forces(u, x, cells, quantum=quantum)
    at_rest, _ = tangent(u, np.zeros_like(u), x, cells, quantum=quantum)
    assert abs(force - linear).max() <= (10 * size + ROUND_OFF) * abs(linear).max()
    assert abs(at_rest - linear).max() <= ROUND_OFF * abs(linear).max()


def test_what_is_met_bounds_the_forces(scale):
    """Of nodes 1 to 7; a quantum that suits it holds every value below 2^51 quanta."""
    x, cells = box(jitter=0.15)
    u, v = large(x), large(x, seed=5)
    for force, met in (forces(u, x, cells[:1]), tangent(v, u, x, cells[:1])):
        of_nodes = abs(QUANTUM * force[cells[0, 1:]]).max()
        assert met[0] == pytest.approx(of_nodes, rel=1e-12)


def test_elements_turned_inside_out_are_found():
    """One node pushed through its cell; an element in its mirror image has the volume -1."""
    x, cells = box()
    u = np.zeros_like(x)
    u[:, 0] = -2.0 * x[:, 0]
    energy, ratio, strain = measured(u, x, cells)
    np.testing.assert_allclose(ratio, -1.0)
    np.testing.assert_allclose((energy, strain), 0.0, atol=TURNED)  # nothing but the volume tells
    u[:] = 0.0
    u[cells[0, 6]] = -1.1
    ratio = measured(u, x, cells)[1]
    assert (ratio <= 0.0).sum() == 1


def test_uniform_strain_is_measured():
    """A stretch by a tenth is a Green strain of 0.105."""
    x, cells = box()
    _, ratio, strain = measured(x * np.array([0.1, 0.0, 0.0]), x, cells)
    np.testing.assert_allclose(ratio, 1.1)
    np.testing.assert_allclose(strain, 0.105)
