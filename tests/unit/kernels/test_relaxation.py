"""Sums of eqs (31), (32) against math.fsum, their guards, and the steps (33)-(35)."""

import math

import numpy as np
import pytest

from pdfem_mpi.kernels import relaxation
from pdfem_mpi.kernels.exact_sums import BLOCK, SIZE, carry, value

pytestmark = pytest.mark.filterwarnings("ignore:overflow", "ignore:invalid")  # meant to happen

ROUND_OFF = 4 * 2.0**-53  # of a step: four operations
sizes = pytest.mark.parametrize("n", [0, 1, 7, BLOCK, BLOCK + 1, 1700])


def vectors(n, seed=1):
    """u, v, force, previous force, and inverse mass (some fixed) of mixed size."""
    rng = np.random.default_rng(seed)
    result = rng.normal(size=(5, n)) * 10.0 ** rng.integers(-6, 3, (5, n))
    result[4] = abs(result[4]) * (rng.random(n) > 0.2)
    return result


def sums(arrays):
    """The four sums of one rank, carried."""
    digits = np.zeros((4, SIZE), np.int64)
    relaxation.add_damping_sums(*arrays, digits)
    for row in digits:
        carry(row)
    return digits


def values(arrays):
    return [value(row) for row in sums(arrays)]


def local_stiffness(v, force, previous, inverse_mass):
    """Eq. 32 of the moving unknowns, 0 of the others."""
    with np.errstate(all="ignore"):
        ratio = -(force - previous) * inverse_mass / v
    return np.where((v == 0.0) | ~np.isfinite(ratio), 0.0, ratio)


@pytest.mark.nojit
@sizes
def test_sums(n):
    """Each is the correctly rounded sum of its terms."""
    u, v, force, previous, inverse_mass = arrays = vectors(n)
    free = inverse_mass > 0.0
    expected = [
        u**2 * local_stiffness(v, force, previous, inverse_mass),
        (u**2)[free],
        (force**2)[free],
        (force**2)[~free],
    ]
    assert values(arrays) == [math.fsum(terms.tolist()) for terms in expected]


def test_sums_do_not_depend_on_order_or_ranks():
    """Unknowns shuffled and dealt to three ranks."""
    arrays = vectors(1700)
    order = np.random.default_rng(3).permutation(1700)
    joined = sum(sums(np.ascontiguousarray(piece)) for piece in np.array_split(arrays[:, order], 3, axis=1))
    assert [value(row) for row in joined] == values(arrays)


def test_sums_are_added_to():
    """A second call adds; inputs stay."""
    arrays = vectors(600)
    before = arrays.copy()
    digits = np.zeros((4, SIZE), np.int64)
    for _ in range(2):
        relaxation.add_damping_sums(*arrays, digits)
    assert [value(row) for row in digits] == [2 * each for each in values(arrays)]
    assert (arrays == before).all()


@pytest.mark.nojit
def test_stiffness_of_a_spring():
    """-dF / (m v) is k / m for a spring moved by v: its sign and its mass."""
    u, v, k, m = np.array([[0.5, -2.0, 3.0], [0.25, 0.5, -1.0], [8.0, 4.0, 2.0], [2.0, 4.0, 0.5]])
    previous = np.array([1.0, -1.0, 0.5])
    arrays = (u, v, previous - k * v, previous, 1.0 / m)
    assert values(arrays)[:2] == [(u**2 * k / m).sum(), (u**2).sum()]


@pytest.mark.nojit
@pytest.mark.parametrize(
    ("v", "change"),
    [(0.0, 1.0), (-0.0, 1.0), (0.0, 0.0), (1e-320, 1.0), (-1e-320, 1e200), (1.0, math.nan), (math.nan, 1.0)],
)
def test_a_ratio_that_is_not_finite_counts_as_zero(v, change):
    """Eq. 32 divides by the velocity: at rest, and where the ratio overflows, K_ii = 0."""
    u, velocity = np.array([2.0, 1.0]), np.array([v, 1.0])
    force = np.array([change, -3.0])
    assert values((u, velocity, force, np.zeros(2), np.ones(2)))[:2] == [3.0, 5.0]


@pytest.mark.nojit
def test_a_displacement_that_is_not_finite_is_seen():
    """The solver stops on NaN sums of U^T U or of the residual."""
    for place in (0, 2):
        for bad in (math.nan, math.inf):
            arrays = vectors(5, seed=4)
            arrays[4] = 1.0
            arrays[place, 3] = bad
            result = values(arrays)
            assert math.isnan(result[1 if place == 0 else 2])


@pytest.mark.nojit
@sizes
@pytest.mark.parametrize("damping", [0.0, 0.37, 1.9])
def test_advance(n, damping):
    """(33) v' = ((2 - c) v + 2 F / m) / (2 + c) and (34) u' = u + v' for a time step of 1."""
    u, v, force, previous, inverse_mass = vectors(n)
    u0, v0 = u.copy(), v.copy()
    relaxation.advance(u, v, force, previous, inverse_mass, damping, False)
    parts = np.array([(2 - damping) * v0, 2 * force * inverse_mass]) / (2 + damping)
    assert (abs(v - parts.sum(axis=0)) <= ROUND_OFF * abs(parts).sum(axis=0)).all()
    assert (u == u0 + v).all()
    assert (previous == force).all()
    assert (force == vectors(n)[2]).all()


@pytest.mark.nojit
def test_the_first_step():
    """(35) v = F / 2 m from rest, whatever v and the damping are."""
    u, v, force, previous, inverse_mass = vectors(40)
    u0 = u.copy()
    relaxation.advance(u, v, force, previous, inverse_mass, 1.3, True)
    assert (v == 0.5 * inverse_mass * force).all()
    assert (u == u0 + v).all()
    assert (previous == force).all()


@pytest.mark.nojit
def test_fixed_unknowns_stay():
    """1 / m = 0: no force moves them from rest."""
    u, v, force, previous, inverse_mass = vectors(40)
    v[:], u0, fixed = 0.0, u.copy(), inverse_mass == 0.0
    relaxation.advance(u, v, force, previous, inverse_mass, 0.0, True)
    relaxation.advance(u, v, force, previous, inverse_mass, 0.5, False)
    assert fixed.any()
    assert (u[fixed] == u0[fixed]).all()
    assert (u[~fixed] != u0[~fixed]).all()


def test_a_damped_spring_comes_to_rest():
    """(31)-(35) together: one spring under constant force settles where k u = F."""
    k, load, inverse_mass = 0.2, 3.0, np.ones(1)
    u, v, previous = np.zeros(1), np.zeros(1), np.zeros(1)
    for n in range(200):
        force = load - k * u
        work, square, *_ = values((u, v, force, previous, inverse_mass))
        c = 2 * math.sqrt(work / square) if work > 0 else 0.0
        if n > 1:
            assert abs(c - 2 * math.sqrt(k)) < 1e-3 or abs(v[0]) < 1e-9  # the exact coefficient of one spring
        relaxation.advance(u, v, force, previous, inverse_mass, c, n == 0)
    assert abs(u[0] - load / k) < 1e-10
