"""Forces of elements in linear kinematics, by both kernels."""

import numpy as np
import pytest
from unit.kernels.bodies_of_elements import box

from pdfem_mpi.kernels import element_tables as tables
from pdfem_mpi.kernels import hex8
from pdfem_mpi.kernels import linear_elements as fe

QUANTUM = 2.0**-50
YOUNG, NU = 2.5, 0.3
ROUND_OFF = 1e-13  # of the largest entry: sums of some hundred terms


def displacements(x):
    """Seeded displacements, multiples of 2^-30 below 2^-7."""
    return np.round(np.random.default_rng(4).uniform(-1.0, 1.0, x.shape) * 2**23) / 2**30


def shared_forces(u, cells, scale=None, quantum=QUANTUM):
    """Forces of unit cubes in quanta, and the largest displacement difference."""
    force, largest = np.zeros(u.shape, np.int64), np.zeros(1)
    k = tables.element_stiffness(0.5 * hex8.REFERENCE_NODES[None], np.array([YOUNG]), NU)[0]
    scale = np.ones(len(cells)) if scale is None else scale
    fe.add_shared_forces(force, u, cells, k, scale, quantum, largest)
    return force, largest[0]


def general_forces(u, cells, x, scale=None, quantum=QUANTUM):
    """Forces of elements of any shape in quanta, and the largest displacement difference."""
    force, largest = np.zeros(u.shape, np.int64), np.zeros(1)
    lam, mu = tables.lame_moduli(YOUNG * (np.ones(len(cells)) if scale is None else scale), NU)
    fe.add_general_forces(force, u, cells, tables.gradient_tables(x[cells]), lam, mu, quantum, largest)
    return force, largest[0]


def forces(kind, u, cells, x, scale=None, quantum=QUANTUM):
    """Both kernels in one call; ``x`` matters to the general one only."""
    if kind == "shared":
        return shared_forces(u, cells, scale, quantum)
    return general_forces(u, cells, x, scale, quantum)


both_kernels = pytest.mark.parametrize("kind", ["shared", "general"])
JITTER = {"shared": 0.0, "general": 0.15}


@pytest.fixture
def scale():
    """Modulus factors of the 12 elements of the box."""
    return np.random.default_rng(5).uniform(0.5, 2.0, 12)


@pytest.mark.nojit
@both_kernels
def test_forces_are_minus_k_u(kind, scale):
    """Eqs. 15-16 summed in floating point, with a modulus per element; 12 elements fill three groups."""
    x, cells = box(jitter=JITTER[kind])
    u = displacements(x)
    force, largest = forces(kind, u, cells, x, scale)
    stiffness = tables.element_stiffness(x[cells], YOUNG * scale, NU)
    expected = np.zeros_like(u)
    for nodes, k in zip(cells, stiffness, strict=True):
        expected[nodes] -= (k @ u[nodes].ravel()).reshape(8, 3)
    np.testing.assert_allclose(QUANTUM * force, expected, rtol=0, atol=1e-12 * abs(expected).max())
    assert largest == abs(u[cells] - u[cells[:, :1]]).max()


@pytest.mark.nojit
@both_kernels
@pytest.mark.parametrize("n", [0, 1, 2, 3, 5])
def test_short_last_groups(kind, n, scale):
    """The repeated last element of a short group counts once, with the bits that it has in a full group."""
    x, cells = box(jitter=JITTER[kind])
    u = displacements(x)
    part = np.zeros(u.shape, np.int64)
    for e in range(n):
        part += forces(kind, u, cells[[e] * 4], x, scale[[e] * 4])[0] // 4
    assert (forces(kind, u, cells[:n], x, scale[:n])[0] == part).all()


@both_kernels
@pytest.mark.parametrize("n_parts", [1, 2, 3, 4])
def test_order_and_parts_do_not_change_a_bit(kind, n_parts, scale):
    """Shuffled elements, summed in parts as ranks would, with other elements in the neighbouring lanes."""
    x, cells = box(jitter=JITTER[kind])
    u = displacements(x)
    order = np.random.default_rng(7).permutation(12)
    parts = [forces(kind, u, cells[p], x, scale[p])[0] for p in np.array_split(order, n_parts)]
    assert (sum(parts) == forces(kind, u, cells, x, scale)[0]).all()


@both_kernels
def test_forces_are_added_and_the_maximum_raised(kind):
    """Outputs are not overwritten."""
    x, cells = box()
    u = displacements(x)
    once, largest = forces(kind, u, cells, x)
    force, raised = np.full(u.shape, 3, np.int64), np.array([10.0])
    if kind == "shared":
        k = tables.element_stiffness(x[cells[:1]], np.array([YOUNG]), NU)[0]
        fe.add_shared_forces(force, u, cells, k, np.ones(12), QUANTUM, raised)
    else:
        lam, mu = tables.lame_moduli(np.full(12, YOUNG), NU)
        fe.add_general_forces(force, u, cells, tables.gradient_tables(x[cells]), lam, mu, QUANTUM, raised)
    assert (force == once + 3).all()
    assert largest < raised[0] == 10.0


@both_kernels
def test_translation_does_not_change_a_bit(kind):
    """Only differences to node 0 enter; they are exact here."""
    x, cells = box(jitter=JITTER[kind])
    u = displacements(x)
    moved = forces(kind, u + np.array([1024.0, -3.0, 0.125]), cells, x)
    assert (moved[0] == forces(kind, u, cells, x)[0]).all()
    assert not forces(kind, np.full_like(u, 1e9), cells, x)[0].any()


@both_kernels
def test_every_element_is_in_exact_equilibrium(kind):
    """The integer forces of one element sum to zero; their moment is zero up to the rounding to quanta."""
    x, cells = box(jitter=JITTER[kind])
    force = forces(kind, displacements(x), cells[:1], x)[0]
    assert (force.sum(axis=0) == 0).all()
    moment = np.cross(x, QUANTUM * force).sum(axis=0)
    assert abs(moment).max() < ROUND_OFF * abs(QUANTUM * force).sum()


@both_kernels
def test_rotation_gives_no_force(kind):
    """Infinitesimal rotations, up to round-off."""
    x, cells = box(jitter=JITTER[kind])
    for axis in np.eye(3):
        force = QUANTUM * forces(kind, np.cross(axis, x) / 64, cells, x)[0]
        assert abs(force).max() < ROUND_OFF * YOUNG / 64


@both_kernels
@pytest.mark.parametrize("strain", range(6))
def test_patch_of_uniform_strain(kind, strain):
    """Inner nodes of a (distorted) patch are in equilibrium under each of the six uniform strains."""
    x, cells = box(4, 3, 3, jitter=JITTER[kind])
    gradient = np.zeros((3, 3))
    i, j = [(0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (2, 0)][strain]
    gradient[i, j] = gradient[j, i] = 1 / 64
    force = QUANTUM * forces(kind, x @ gradient, cells, x)[0]
    inner = np.bincount(cells.ravel()) == 8
    assert inner.sum() == 12
    assert abs(force[inner]).max() < ROUND_OFF * YOUNG / 64
    assert abs(force[~inner]).max() > 1e-3 * YOUNG / 64


def test_shared_and_general_agree_on_cubes(scale):
    """Two ways to the same forces."""
    x, cells = box()
    u = displacements(x)
    shared, general = shared_forces(u, cells, scale), general_forces(u, cells, x, scale)
    assert abs(shared[0] - general[0]).max() < ROUND_OFF * abs(shared[0]).max()
    assert shared[1] == general[1]


@both_kernels
def test_force_bound_holds_and_is_nearly_reached(kind, scale):
    """The worst displacements of the worst row reach the bound, and then stay below 2^51 quanta."""
    x, cells = box(jitter=JITTER[kind])
    stiffness = tables.element_stiffness(x[cells], YOUNG * scale, NU)
    bound = tables.force_bound(stiffness)
    e, row = np.unravel_index(abs(stiffness[:, 3:, 3:]).sum(axis=2).argmax(), (12, 21))
    u = np.zeros_like(x)
    u[cells[e, 1:]] = np.sign(stiffness[e, row + 3, 3:]).reshape(7, 3)
    quantum = 2.0 ** (np.ceil(np.log2(bound)) - 51)
    force, largest = forces(kind, u, cells[e : e + 1], x, scale[e : e + 1], quantum)
    worst = -force[cells[e, 1:]].ravel()[row]
    assert largest == 1.0
    assert worst < 2**51
    np.testing.assert_allclose(quantum * worst, bound, rtol=1e-8)  # margin 2^-30


def test_force_bound_of_nothing_is_zero():
    """A rank without elements takes part in the global maximum."""
    assert tables.force_bound(np.zeros((0, 24, 24))) == 0.0
