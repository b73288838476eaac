"""Kernels of softened bonds against loops in plain numpy: forces, tangent, stretches, teeth, slots of rows."""

import numpy as np
import pytest

from pdfem_mpi.kernels import softened_bonds as kernels
from pdfem_mpi.kernels.bond_response import SMALLEST_SQUARE
from pdfem_mpi.kernels.simd import W

QUANTUM = 2.0**-60
ROUNDED = 1e-12
DIFFERENCE = 1e-5  # of a difference quotient of the forces over a step of 1e-7

STIFFNESS = np.array([[1.0, 0.5, 0.2, 0.0], [1.0, 0.3, 0.0, 0.0]])
LIMIT = np.array([[0.01, 0.02, 0.05], [0.015, 0.04, np.inf]])
TEETH = np.array([3, 2])


class Bonds:
    """Bonds between random points, softened by random teeth."""

    def __init__(self, finite, n=40, clusters=6, seed=0):
        random = np.random.default_rng(seed)
        self.finite, self.n = finite, n
        self.x = random.random((clusters * W, 3))
        self.u = 0.02 * random.standard_normal((clusters * W, 3))
        pairs = np.array([(i, j) for i in range(clusters * W) for j in range(i)])
        self.pairs = np.ascontiguousarray(random.permutation(pairs)[:n])
        self.k = random.random(n).astype(np.float32)
        self.xi = self.x[self.pairs[:, 1]] - self.x[self.pairs[:, 0]]
        self.inverse = (1.0 / (self.xi**2).sum(axis=1)).astype(np.float32)
        self.strengths = np.ascontiguousarray(np.column_stack([self.k, self.inverse if finite else 0 * self.k]))
        self.law, self.tooth = random.integers(0, 2, n), random.integers(0, 2, n)

    @property
    def listed(self):
        return self.n, self.pairs, self.strengths, self.law, self.tooth, STIFFNESS

    def table(self, u, z):
        S = np.zeros((len(self.x) // W, 9, W))
        S[:, 0:3], S[:, 3:6] = (a.reshape(-1, W, 3).swapaxes(1, 2) for a in (u, z))
        return S

    def forces(self, u):
        """By the law itself, on each point."""
        share = STIFFNESS[self.law, self.tooth] * self.k
        eta = u[self.pairs[:, 1]] - u[self.pairs[:, 0]]
        if self.finite:  # 2 K phi y with phi = 1 - r0 / |y|
            y = self.xi + eta
            pull = 2.0 * share * (1.0 - 1.0 / np.sqrt(1.0 + self.e(u)))
            f = pull[:, None] * y
        else:
            f = (share * (eta * self.xi).sum(axis=1))[:, None] * self.xi
        total = np.zeros_like(self.x)
        np.add.at(total, self.pairs[:, 0], f)
        np.add.at(total, self.pairs[:, 1], -f)
        return total

    def e(self, u):
        eta = u[self.pairs[:, 1]] - u[self.pairs[:, 0]]
        return (eta * (2.0 * self.xi + eta)).sum(axis=1) * self.inverse

    def by_kernel(self, u):
        S = self.table(u, 2.0 * self.x + u if self.finite else self.x)
        SI = S.view(np.int64)
        peak = kernels.add_softened_forces(*self.listed, self.finite, S.reshape(-1), SI.reshape(-1), QUANTUM)
        return (SI[:, 6:9] * QUANTUM).swapaxes(1, 2).reshape(-1, 3), peak, S


@pytest.mark.parametrize("finite", [False, True])
def test_forces(finite):
    bonds = Bonds(finite)
    found, peak, _ = bonds.by_kernel(bonds.u)
    np.testing.assert_allclose(found, bonds.forces(bonds.u), rtol=1e-9, atol=ROUNDED)
    expected = bonds.e(bonds.u)
    if not finite:
        eta = bonds.u[bonds.pairs[:, 1]] - bonds.u[bonds.pairs[:, 0]]
        expected = STIFFNESS[bonds.law, bonds.tooth] * bonds.k * (eta * bonds.xi).sum(axis=1)
    assert peak == pytest.approx(np.abs(expected).max(), rel=1e-9)


@pytest.mark.parametrize("finite", [False, True])
def test_a_bond_is_the_same_from_either_end(finite):
    """In every bit: which rank computes it, and from which point, is open."""
    bonds = Bonds(finite)
    found, peak, S = bonds.by_kernel(bonds.u)
    measured = [np.empty(bonds.n) for _ in range(3)]
    kernels.measure_softened(*bonds.listed, finite, S.reshape(-1), *measured)
    bonds.pairs = np.ascontiguousarray(bonds.pairs[:, ::-1])
    bonds.xi = -bonds.xi
    turned, other, S = bonds.by_kernel(bonds.u)
    again = [np.empty(bonds.n) for _ in range(3)]
    kernels.measure_softened(*bonds.listed, finite, S.reshape(-1), *again)
    assert (found == turned).all() and peak == other
    assert all((a == b).all() for a, b in zip(measured, again, strict=True))


def test_tangent_is_the_derivative_of_the_forces():
    bonds = Bonds(True)
    v = np.random.default_rng(5).standard_normal(bonds.x.shape)
    S = bonds.table(v, bonds.x + bonds.u)
    SI = S.view(np.int64)
    kernels.add_softened_tangent(*bonds.listed, S.reshape(-1), SI.reshape(-1), QUANTUM)
    found = (SI[:, 6:9] * QUANTUM).swapaxes(1, 2).reshape(-1, 3)
    h = 1e-6
    expected = (bonds.forces(bonds.u + h * v) - bonds.forces(bonds.u - h * v)) / (2.0 * h)
    np.testing.assert_allclose(found, expected, atol=DIFFERENCE * np.abs(expected).max())


@pytest.mark.parametrize("finite", [False, True])
def test_stretches_lengths_and_energies(finite):
    bonds = Bonds(finite)
    _, _, S = bonds.by_kernel(bonds.u)
    stretch, square, energy = (np.empty(bonds.n) for _ in range(3))
    kernels.measure_softened(*bonds.listed, finite, S.reshape(-1), stretch, square, energy)
    r2 = (bonds.xi**2).sum(axis=1)
    eta = bonds.u[bonds.pairs[:, 1]] - bonds.u[bonds.pairs[:, 0]]
    s = np.sqrt(1.0 + bonds.e(bonds.u)) - 1.0 if finite else (eta * bonds.xi).sum(axis=1) / r2
    np.testing.assert_allclose(square, r2, rtol=1e-6)
    np.testing.assert_allclose(stretch, s, rtol=1e-6)
    unit = bonds.k * r2 if finite else 0.5 * bonds.k * r2**2
    np.testing.assert_allclose(energy, unit * s**2, rtol=1e-5)


def test_bonds_go_through_all_teeth_that_they_pass():
    """Those that have just left their rows at least through the first; never back; compression does nothing."""
    law = np.array([0, 0, 0, 1, 1, 0])
    tooth = np.array([1, 1, 2, 1, 0, 0])
    stretch = np.array([0.0199, 0.06, -1.0, 0.0397, 0.0149, 0.03])
    moved = kernels.advance_softened(6, law, tooth, LIMIT, TEETH, 4, stretch, 0.01)
    assert tooth.tolist() == [2, 3, 2, 2, 1, 2]
    assert moved == 5
    assert kernels.advance_softened(6, law, tooth, LIMIT, TEETH, 6, np.zeros(6), 0.01) == 0


def test_slots_are_those_that_the_bonds_had():
    """A row of a point against a cluster; both numbers of finite kinematics; other rows stay."""
    start, offset = np.array([0, 2, 3]), np.array([0, 9 * W, 9 * W, 0], np.uint32)
    pairs, values = np.array([[0, W + 2], [1, W + 1], [9, 0]]), np.array([[3, 4], [5, 6], [7, 8]], np.float32)
    data = np.zeros(4 * 2 * W, np.float32)
    kernels.write_slots(pairs, values, start, offset, data, True)
    expected = np.zeros((4, 2, W))
    expected[1, :, 2], expected[2, :, 1] = (3, 4), (5, 6)
    assert (data.reshape(4, 2, W) == expected).all()


@pytest.mark.parametrize("left", [1e-5, 0.0])
def test_a_bond_that_is_compressed_to_nothing_pushes_as_an_intact_one(left):
    """Both are held at a thousandth of their length: no force is without bounds, and none is no number."""
    bonds = Bonds(finite=True, n=1)
    i, j = bonds.pairs[0]
    bonds.u[:] = 0.0
    bonds.u[j] = (left - 1.0) * bonds.xi[0]
    found, peak, _ = bonds.by_kernel(bonds.u)
    share = STIFFNESS[bonds.law[0], bonds.tooth[0]] * bonds.k[0]
    phi = -1.0 / (SMALLEST_SQUARE + SMALLEST_SQUARE**0.5)
    np.testing.assert_allclose(found[i], 2.0 * share * phi * left * bonds.xi[0], rtol=1e-4, atol=ROUNDED)
    assert peak == pytest.approx(1.0, rel=1e-6)
