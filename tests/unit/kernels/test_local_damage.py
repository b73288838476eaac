"""Sums of eq. (5) over the bonds of small bodies."""

import numpy as np
import pytest
from unit.kernels.bodies import W, body, near_pairs, part, parts

from pdfem_mpi.kernels.local_damage import add_bond_weights, add_listed_weights

QUANTUM = 2.0**-40


def sums_of(share):
    """Sums of the local points of a part, in quanta, by the kernel."""
    sums = np.zeros(len(share.point), np.int64)
    stride = (2 if share.bonds.finite else 1) * W
    for rows in share.bonds.rows:
        points = share.points
        add_bond_weights(*rows.arrays, stride, points.cell_number, points.x, points.volume, QUANTUM, sums)
    return sums


def expected(whole, pairs):
    """``sum_j exp(-r^2) w_j`` by numpy."""
    i, j = pairs.T
    weight = np.exp(-((whole.x[j] - whole.x[i]) ** 2).sum(axis=1))
    total = np.zeros(len(whole.x))
    np.add.at(total, i, weight * whole.volume[j])
    np.add.at(total, j, weight * whole.volume[i])
    return total


@pytest.mark.nojit
@pytest.mark.parametrize("finite", [True, False], ids=["finite", "linear"])
@pytest.mark.parametrize("kind", ["box", "jittered", "graded"])
def test_sums_are_those_of_the_pairs(kind, finite):
    """Weights of the other point, which differ where cells do."""
    whole = body((3, 2, 1), kind)
    share = part(whole, finite=finite)
    # each of a point's bonds is rounded by half a quantum
    rounding = len(whole.x) * QUANTUM
    sums = expected(whole, near_pairs(whole.x))[share.point]
    np.testing.assert_allclose(sums_of(share) * QUANTUM, sums, rtol=1e-14, atol=rounding)


@pytest.mark.nojit
def test_listed_bonds_have_the_weights_of_those_in_rows():
    """Every bond once, in either order."""
    whole = body((3, 2, 1), "graded")
    share = part(whole)
    local = np.argsort(share.point)  # of one part all points are own ones
    pairs = local[near_pairs(whole.x)]
    pairs[::2] = pairs[::2, ::-1]
    listed, points = np.zeros(len(share.point), np.int64), share.points
    add_listed_weights(pairs, points.cell_number, points.x, points.volume, QUANTUM, listed)
    assert (listed == sums_of(share)).all() and listed.all()


def test_broken_bonds_have_no_part():
    whole = body((3, 2, 2), "graded")
    share = part(whole)
    rows = share.bonds.interior
    rows.data.reshape(-1, 2, W)[: len(rows.offset) // 2] = 0.0
    assert 0 < sums_of(share).sum() < sums_of(part(whole)).sum()


@pytest.mark.parametrize("n_parts", [2, 3])
def test_sums_do_not_depend_on_ranks(n_parts):
    """Cells dealt to ranks in any order: the same integers."""
    whole = body((4, 3, 2), "graded")
    alone = np.zeros(len(whole.x), np.int64)
    alone[part(whole).point] = sums_of(part(whole))
    together = np.zeros_like(alone)
    for share in parts(whole, n_parts):
        np.add.at(together, share.point, sums_of(share))
    assert (together == alone).all()
