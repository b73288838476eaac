"""Bounds of the stiffness at each point: the largest eigenvalue of a 3x3 block in closed form, never from below."""

import numpy as np
import pytest

from pdfem_mpi.kernels.weighted_blocks import MARGIN, stiffness_bounds


def packed(matrices):
    """Entries xx, yy, zz, xy, yz, zx."""
    return np.ascontiguousarray(matrices.reshape(-1, 9)[:, [0, 4, 8, 1, 5, 6]])


def bounds(blocks, weighted, weight, slack=0.0):
    found = np.empty(len(weight))
    stiffness_bounds(packed(blocks), packed(weighted), weight, slack, found)
    return found


def sums_of_bonds(rng, n, directions):
    """Blocks ``sum k n n^T`` of some bonds a point."""
    unit = rng.normal(size=(n, directions, 3))
    unit /= np.linalg.norm(unit, axis=2)[:, :, None]
    return np.einsum("nb,nba,nbc->nac", rng.uniform(0.0, 10.0, (n, directions)), unit, unit)


@pytest.mark.nojit
@pytest.mark.parametrize("directions", [1, 2, 3, 40])
def test_bound_is_the_largest_eigenvalue_from_above(directions):
    """Of B + C / d, within the margin, for blocks of rank 1, 2 and 3."""
    rng = np.random.default_rng(directions)
    blocks, weighted = sums_of_bonds(rng, 50, directions), sums_of_bonds(rng, 50, directions)
    weight = rng.uniform(0.01, 1.0, 50)
    top = np.linalg.eigvalsh(blocks + weighted / weight[:, None, None])[:, -1]
    found = bounds(blocks, weighted, weight)
    assert (found >= top * (1.0 - 1e-14)).all()
    np.testing.assert_allclose(found, top, rtol=2.0 * (MARGIN - 1.0))


@pytest.mark.nojit
def test_equal_eigenvalues_keep_the_bound_above():
    """Where two or three eigenvalues meet, the closed form loses half of its digits, and the margin covers that."""
    rng = np.random.default_rng(7)
    turned = np.linalg.qr(rng.normal(size=(60, 3, 3)))[0]
    values = np.concatenate([np.tile(row, (20, 1)) for row in ([2.0, 2.0, 2.0], [2.0, 2.0, 0.5], [2.0, 0.5, 0.5])])
    blocks = np.einsum("nab,nb,ncb->nac", turned, values, turned)
    found = bounds(blocks, np.zeros_like(blocks), np.ones(60))
    assert (found >= 2.0).all()
    np.testing.assert_allclose(found, 2.0, rtol=2.0 * (MARGIN - 1.0))


@pytest.mark.nojit
def test_a_point_without_bonds_asks_for_nothing_and_rounding_is_added():
    blocks = np.array([np.zeros((3, 3)), np.eye(3)])
    found = bounds(blocks, blocks, np.array([1.0, 0.5]), slack=0.01)
    assert found[0] == 0.0
    assert found[1] == pytest.approx(3.0 + 3.0 * 0.01 * 3.0, rel=2.0 * (MARGIN - 1.0))
