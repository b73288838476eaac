"""Tables of elements: stiffness against an independent assembly, masses, geometry."""

import numpy as np
import pytest
from skfem import Basis, BilinearForm, ElementHex1, ElementVector, MeshHex
from skfem.helpers import ddot, eye, sym_grad, trace
from unit.kernels.bodies_of_elements import box, turn

from pdfem_mpi.kernels import element_tables as tables
from pdfem_mpi.kernels import hex8

YOUNG, NU = 2.5, 0.3
ROUND_OFF = 1e-13  # of the largest entry: sums of some hundred terms


def scikit_fem_stiffness(x):
    """Stiffness of one cell by scikit-fem with the 2x2x2 rule, rows 3 node + component."""
    element = ElementHex1()
    order = [int(np.flatnonzero((2 * p - 1 == hex8.REFERENCE_NODES).all(axis=1))[0]) for p in element.doflocs]
    rule = (hex8.GAUSS_POINTS.T + 1) / 2, np.full(8, 1 / 8)
    basis = Basis(MeshHex(x[order].T, np.arange(8)[:, None]), ElementVector(element), quadrature=rule)
    lam, mu = YOUNG * NU / ((1 + NU) * (1 - 2 * NU)), YOUNG / (2 * (1 + NU))

    @BilinearForm
    def elasticity(u, v, w):
        e = sym_grad(u)
        return ddot(lam * eye(trace(e), 3) + 2 * mu * e, sym_grad(v))

    dofs = np.empty((8, 3), int)
    dofs[order] = basis.nodal_dofs.T
    return elasticity.assemble(basis).toarray()[np.ix_(dofs.ravel(), dofs.ravel())]


def test_stiffness_equals_scikit_fem():
    """Ten distorted cells against an independent assembly with the same quadrature."""
    cells = hex8.REFERENCE_NODES + 0.3 * np.random.default_rng(6).uniform(-1.0, 1.0, (10, 8, 3))
    stiffness = tables.element_stiffness(cells, np.full(10, YOUNG), NU)
    for x, k in zip(cells, stiffness, strict=True):
        oracle = scikit_fem_stiffness(x)
        np.testing.assert_allclose(k, oracle, rtol=0, atol=1e-12 * abs(oracle).max())


def test_stiffness_is_symmetric_with_six_rigid_modes():
    """Symmetric to the bit, no negative eigenvalue, and exactly the rigid motions give no force."""
    x, cells = box(jitter=0.15)
    for nodes, k in zip(x[cells], tables.element_stiffness(x[cells], np.full(12, YOUNG), NU), strict=True):
        assert (k == k.T).all()
        translations = np.tile(np.eye(3), (8, 1))
        rotations = np.stack([np.cross(axis, nodes).ravel() for axis in np.eye(3)], axis=1)
        assert abs(k @ np.hstack([translations, rotations])).max() < ROUND_OFF * abs(k).max()
        eigenvalues = np.linalg.eigvalsh(k)
        assert eigenvalues[0] > -ROUND_OFF * eigenvalues[-1]
        assert eigenvalues[6] > 1e-3 * eigenvalues[-1]


def test_stiffness_has_the_same_bits_in_any_batch():
    """Ranks compute other batches and must find the same numbers."""
    x, cells = box(jitter=0.15)
    young = np.linspace(1.0, 2.0, 12)
    together = tables.element_stiffness(x[cells], young, NU)
    for e in range(12):
        assert (tables.element_stiffness(x[cells[e : e + 1]], young[e : e + 1], NU)[0] == together[e]).all()


def test_masses_are_a_quarter_of_the_row_sums_and_stable():
    """Eq. 22 with the 1/4 of eq. 19: the largest eigenvalue of M^-1 K of the assembled mesh is below 4."""
    x, cells = box(jitter=0.15)
    stiffness = tables.element_stiffness(x[cells], np.full(12, YOUNG), NU)
    masses = tables.element_masses(stiffness)
    np.testing.assert_allclose(masses, abs(stiffness).sum(axis=2) / 4, rtol=ROUND_OFF)
    dofs = (3 * cells[:, :, None] + np.arange(3)).reshape(12, 24)
    k, m = np.zeros((x.size, x.size)), np.zeros(x.size)
    for e in range(12):
        k[np.ix_(dofs[e], dofs[e])] += stiffness[e]
        m[dofs[e]] += masses[e]
    largest = np.linalg.eigvalsh(k / np.sqrt(m[:, None] * m))[-1]
    assert 1.0 < largest < 4.0  # above 1: masses four times as large, without the 1/4, would waste iterations


@pytest.mark.parametrize("edges", [(1, 1, 1), (1, 1, 4), (4, 4, 1)])
def test_masses_of_turning_elements_bound_their_stiffness_at_any_angle(edges):
    """Those of (22) do not where edges differ: the largest eigenvalue of M^-1 K was 7.4 and 9.7 when turned."""
    x, cells = box()
    stiffness = tables.element_stiffness(x[cells] * np.array(edges), np.full(12, YOUNG), NU)[0]
    masses, printed = tables.turning_masses(stiffness[None])[0], tables.element_masses(stiffness[None])[0]
    if edges == (1, 1, 1):
        np.testing.assert_allclose(masses, printed, rtol=ROUND_OFF)
    about = np.kron(np.eye(8), turn(90.0, (1.0, 1.0, 0.0)) @ turn(30.0))
    for matrix in (stiffness, about @ stiffness @ about.T):
        assert np.linalg.eigvalsh(matrix / np.sqrt(masses[:, None] * masses))[-1] <= 4.0


def test_tables_of_nothing_are_empty():
    """A rank without general elements."""
    assert tables.gradient_tables(np.zeros((0, 8, 3))).shape == (0, 8, 10, 4)
