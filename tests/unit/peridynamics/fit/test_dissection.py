"""Factors by nested dissection, and the free motions that are kept out of their solve."""

import numpy as np
import pytest

from pdfem_mpi.kernels.monomials import MONOMIALS, MULTIPLICITY
from pdfem_mpi.mesh.background_grid import cell_nodes
from pdfem_mpi.peridynamics.fit.dissection import BlockMatrix, count_entries, dissect, factorise
from pdfem_mpi.peridynamics.fit.killing import free_motions

SIZE = 2
SINGLE = 2e-6  # entries in single precision, times the condition of the matrix below


def grid_of(counts, missing=()):
    """A random symmetric positive block matrix over the nodes of some elements, the numbers, and itself, dense."""
    cells = np.delete(cell_nodes(counts, 2), missing, axis=0)
    number = np.full(int(np.prod(2 * counts + 1)), -1)
    used = np.unique(cells)
    number[used] = np.arange(len(used))
    coupled = np.zeros((len(used), len(used)), bool)
    for nodes in number[cells]:
        coupled[np.ix_(nodes, nodes)] = True
    rng = np.random.default_rng(5)
    values = rng.uniform(-1.0, 1.0, (len(used), len(used), 2))
    tables = rng.uniform(-1.0, 1.0, (2, SIZE, SIZE))
    # as of grad v : M : grad v: a transposed block goes with the transposed pair of axes
    values[..., 1] = values[..., 0].T
    tables[1] = tables[0].T
    values[~coupled] = 0.0
    dense = np.einsum("ijk,kab->iajb", values, tables).reshape(SIZE * len(used), -1)
    raised = np.abs(dense).sum(axis=1)
    row, column = np.nonzero(coupled)
    start = np.searchsorted(row, np.arange(len(used) + 1))
    return BlockMatrix(start, column, values[row, column], tables, raised), number, dense + np.diag(raised)


@pytest.mark.parametrize(("counts", "missing"), [((3, 2, 1), ()), ((1, 1, 1), ()), ((4, 3, 2), (5, 6, 13))])
def test_solve_is_that_of_the_dense_matrix(counts, missing):
    """Also with a hole, where nodes are missing in the middle of a dividing plane."""
    counts = np.array(counts)
    matrix, number, dense = grid_of(counts, missing)
    np.testing.assert_allclose(dense, dense.T, rtol=1e-13)
    fronts = dissect(counts, number)
    assert sorted(np.concatenate([front.nodes for front in fronts])) == list(range(number.max() + 1))
    factor = factorise(matrix, fronts)
    right = np.random.default_rng(6).standard_normal(len(dense))
    exact = np.linalg.solve(dense, right)
    assert np.abs(factor.solve(right) - exact).max() < SINGLE * np.abs(exact).max()
    if not missing:
        # the count is of pairs of nodes, blocks on the diagonal are half full
        assert len(factor.entries) == pytest.approx(count_entries(counts, SIZE), rel=0.05)


def test_factors_grow_slowly_with_a_plate():
    """Twice the plate, less than three times the entries: what nested dissection is for; a band would take four."""
    small, large = (count_entries(np.array([n, n, 1]), 10) for n in (10, 14))
    assert 2.0 < large / small < 3.0


def test_fifty_motions_lengthen_no_bond():
    """``(v_i - v_j) . (n n n)`` vanishes for all of them and any two positions."""
    x = np.random.default_rng(7).uniform(-1.0, 3.0, (40, 3))
    basis = free_motions(x)
    assert basis.shape == (50, 400)
    v = basis.T.reshape(40, 10, 50)
    bond = x[1:] - x[:-1]
    t = np.sqrt(MULTIPLICITY) * np.prod(bond[:, None, :] ** MONOMIALS, axis=2)
    assert np.abs(np.einsum("ial,ia->il", v[1:] - v[:-1], t)).max() < 1e-12
