"""Rows of the half list: each pair within the cutoff once, on one rank, with the stored numbers of eq. 2."""

import numpy as np
import pytest
from unit.kernels.bodies import (
    CUTOFF,
    LONG,
    NO_FACTOR,
    Part,
    W,
    body,
    layout,
    near_pairs,
    part,
    parts,
    slots,
    stored_bonds,
    strengths,
)  # fmt: skip

from pdfem_mpi.kernels import families
from pdfem_mpi.peridynamics.bonds import RESPONSE_CONSTANT

kinds = pytest.mark.parametrize("kind", ["box", "jittered", "graded"])
SINGLE = 1.0001 * 2.0**-24  # rounding to float32, and of the double before it
ROUND_OFF = 1e-14  # of float64 expressions of some ten operations


@pytest.mark.nojit
@kinds
def test_rows_hold_each_pair_once(kind):
    """On one rank: the pairs of a k-d tree, and no row without one."""
    whole = body((3, 2, 1), kind)
    share = part(whole)
    pairs, _ = stored_bonds([share])
    expected = near_pairs(whole.x)
    assert len(expected) < len(whole.x) * (len(whole.x) - 1) // 2  # some pairs are too far apart
    assert (pairs == expected).all()
    assert share.bonds.count == len(expected)
    stored = share.bonds.interior.data.reshape(-1, 2, W)[:-1, 0]
    assert (stored != 0.0).any(axis=1).all()


@kinds
def test_rows_of_a_larger_body(kind):
    """Bins and cluster balls leave out no pair."""
    whole = body((6, 4, 4), kind)
    assert (stored_bonds([part(whole)])[0] == near_pairs(whole.x)).all()


def test_points_in_random_order():
    """Clusters as large as the body: only the work grows."""
    whole = body((3, 3, 2))
    whole = whole.renumbered(np.random.default_rng(3).permutation(len(whole.x)))
    assert (stored_bonds([part(whole)])[0] == near_pairs(whole.x)).all()


@pytest.mark.parametrize("cutoff", [0.3, 0.6, 1.01, 100.0])
def test_short_and_long_cutoffs(cutoff):
    """From no bond at all to every pair."""
    whole = body((3, 2, 2), "jittered")
    pairs = stored_bonds([part(whole, cutoff=cutoff)])[0]
    assert (pairs == near_pairs(whole.x, cutoff).reshape(-1, 2)).all()


@kinds
@pytest.mark.parametrize("n_parts", [2, 3, 4, 5, 7])
def test_pretend_ranks_hold_each_pair_once(kind, n_parts):
    """Cells dealt at random to ranks of unequal size, with shuffled cell numbers."""
    whole = body((4, 3, 2), kind)
    number = 3 * np.random.default_rng(n_parts).permutation(whole.n_cells) + 1
    shares = parts(whole, n_parts, number=number)
    pairs, stored = stored_bonds(shares)
    assert (pairs == near_pairs(whole.x)).all()
    assert sum(share.bonds.count for share in shares) == len(pairs)
    assert (stored == stored_bonds([part(whole)])[1]).all()


@pytest.mark.nojit
def test_two_cells_on_two_ranks():
    """Tiny: the bonds between the cells are all on the rank the rule names."""
    whole = body((2, 1, 1))
    for number, owner in (([4, 6], 0), ([6, 4], 1), ([4, 7], 1), ([7, 4], 0)):
        shares = [part(whole, [rank], number=np.array(number)) for rank in (0, 1)]
        between = [len(share.bonds.boundary.offset) > 1 for share in shares]
        assert between == [owner == 0, owner == 1]
        assert (stored_bonds(shares)[0] == near_pairs(whole.x)).all()


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_bonds_across_a_cut_are_shared_evenly(axis):
    """A body numbered in order and cut in two across any axis: each side does about half of the bonds."""
    whole = body((6, 4, 4))
    cell = np.stack(np.unravel_index(np.arange(whole.n_cells), (6, 4, 4)), axis=1)
    left = cell[:, axis] < (3, 2, 2)[axis]
    shares = [part(whole, np.flatnonzero(side)) for side in (left, ~left)]
    counts = [len(slots(share, share.bonds.boundary)[0]) for share in shares]
    assert abs(counts[0] - counts[1]) < 0.2 * sum(counts)  # the cut is small: four cells


@pytest.mark.parametrize("edge", [0.1, 1 / 3, 0.7])
@pytest.mark.parametrize("shift", [0.0, 1e3])
def test_round_off_decides_no_bond(edge, shift):
    """Points exactly r_c = 3 edges apart are bonded in every unit and place, thanks to the guard."""
    whole = body((6, 4, 4))
    exact = near_pairs(whole.x, 3.0 + 1e-4)
    length = np.linalg.norm(np.diff(whole.x[exact], axis=1)[:, 0], axis=1)
    assert np.count_nonzero(abs(length - 3.0) < 1e-9) > 1000
    moved = body((6, 4, 4), edge=edge)
    moved.x[:] += shift
    r_c = 3.0 * edge
    found = stored_bonds([part(moved, cutoff=r_c * (1 + families.CUTOFF_GUARD))])[0]
    assert (found == exact).all()
    if shift:
        assert len(stored_bonds([part(moved, cutoff=r_c)])[0]) < len(exact)


def test_the_guard_is_narrow():
    """A point two guards beyond r_c is no neighbour."""
    whole = body((2, 1, 1))
    whole.x[8:, 0] += 5.0
    lengths = np.linalg.norm(whole.x[8:, None] - whole.x[None, :8], axis=2)
    for excess, found in ((0.0, True), (0.9, True), (2.0, False)):
        cutoff = lengths.min() / (1 + excess * families.CUTOFF_GUARD) * (1 + families.CUTOFF_GUARD)
        pairs, _ = stored_bonds([part(whole, cutoff=cutoff)])
        assert ((pairs[:, 0] < 8) & (pairs[:, 1] >= 8)).any() == found


@pytest.mark.nojit
def test_own_cluster_and_padding_are_slots_without_a_bond():
    """In its own cluster a point is bonded to later lanes only; other slots and the last row are 0."""
    share = part(body((2, 1, 1)), cutoff=1.3)
    rows = share.bonds.interior
    assert rows.start[-1] == len(rows.offset) - 1
    assert rows.offset[-1] == 0
    data = rows.data.reshape(-1, 2, W)
    assert (data[-1] == 0.0).all()
    held = data[:-1, 0] != 0.0
    assert held.any(axis=1).all()  # no row is empty
    assert ((data[:-1, 1] != 0.0) == held).all()
    own_rows = 0
    for i in range(len(rows.start) - 1):
        clusters = rows.offset[rows.start[i] : rows.start[i + 1]] // (9 * W)
        assert (np.diff(clusters.astype(int)) > 0).all()
        assert (clusters >= i // W).all()
        for row, c in zip(range(rows.start[i], rows.start[i + 1]), clusters, strict=True):
            if c == i // W:
                assert not held[row, : i % W + 1].any()
                own_rows += 1
    assert own_rows == 12  # all but the last lane of four clusters


def test_a_range_of_clusters_at_a_time():
    """Searching clusters first:last in turn, or with little room, writes what one call writes."""
    whole = body((3, 2, 1))
    share = part(whole)
    points, rows = share.points, share.bonds.interior
    n = points.n_clusters
    centre, radius = np.empty((n, 3)), np.empty(n)
    families.cluster_balls(points.x, centre, radius)
    bins, everything = np.ones(3, np.int64), (np.array([0, n]), np.arange(n))  # one bin for all
    nothing = np.full(n // 2, -1), np.zeros((n // 2, 0))
    start = np.zeros_like(rows.start)
    start[1:] = -1
    found = []

    def search(first, last, n_room):
        room = np.empty(n_room, np.uint32)
        end = families.find_rows(
            first, last, points.x, n, False, points.cell_number, *nothing, centre, radius, CUTOFF,
            centre.min(axis=0), 1e3, bins, *everything, start, room, np.empty(n, np.int64),
        )  # fmt: skip
        found.append(room[: start[W * end] - start[W * first]])
        return end

    for first, last in ((0, 1), (1, 5), (5, 5)):
        assert search(first, last, 16 * n) == last
    assert search(5, n, 3) == 5
    assert search(5, n, W * (n - 5)) == 6
    assert search(6, n, W * n * n) == n
    assert (start == rows.start).all()
    assert (np.concatenate(found) == rows.offset[:-1]).all()


@pytest.mark.nojit
def test_cluster_balls():
    """Centre of the bounding box, and the farthest point."""
    x = np.random.default_rng(5).uniform(-3.0, 5.0, (16, 3))
    centre, radius = np.empty((4, 3)), np.empty(4)
    families.cluster_balls(layout(x), centre, radius)
    clusters = x.reshape(4, W, 3)
    middle = 0.5 * (clusters.min(axis=1) + clusters.max(axis=1))
    assert (centre == middle).all()
    expected = np.linalg.norm(clusters - middle[:, None], axis=2).max(axis=1)
    np.testing.assert_allclose(radius, expected, rtol=ROUND_OFF)


@pytest.mark.nojit
def test_count_rows_adds():
    """Rows by point and by cluster, on top of what is there."""
    rows = part(body((2, 1, 1))).bonds.interior
    by_point, at_cluster = np.full(16, 5), np.full(4, 7)
    families.count_rows(rows.start, rows.offset, by_point, at_cluster)
    assert (by_point == 5 + np.diff(rows.start)).all()
    clusters = rows.offset[:-1].astype(int) // (9 * W)
    assert (at_cluster == 7 + np.bincount(clusters, minlength=4)).all()


def correction(whole):
    """Seeded correction vectors as large as those of corners, different in all directions."""
    return np.random.default_rng(6).uniform(0.8, 6.0, whole.x.shape)


@pytest.mark.nojit
@pytest.mark.parametrize("finite", [True, False])
@pytest.mark.parametrize("corrected", [True, False])
def test_stored_numbers(finite, corrected):
    """K = c exp(-r^2) g_ij w_i w_j / (2 r) and 1 / r^2, or the same over r^3; only the storage rounds."""
    whole = body((2, 2, 1), "jittered")
    factor = correction(whole) if corrected else None
    share = part(whole, finite=finite, factor=factor)
    pairs, stored = stored_bonds([share])
    strength = strengths(whole, pairs, factor)
    r = np.sqrt((np.diff(whole.x[pairs], axis=1)[:, 0].astype(LONG) ** 2).sum(axis=1))
    expected = np.stack([strength / (2 * r), 1 / r**2], axis=1) if finite else (strength / r**3)[:, None]
    assert stored.shape == expected.shape
    assert (abs(stored - expected) <= SINGLE * expected).all()
    np.testing.assert_allclose(share.bonds.strongest, float(strength.max()), rtol=ROUND_OFF)
    np.testing.assert_allclose(share.bonds.stiffest, float((strength / (2 * r)).max()), rtol=ROUND_OFF)


@pytest.mark.parametrize("finite", [True, False])
def test_stored_numbers_are_the_same_bits_from_both_ends(finite):
    """Points in another order: other owners of each bond, the same float32 numbers."""
    whole = body((3, 2, 2), "jittered")
    factor = correction(whole)
    pairs, stored = stored_bonds([part(whole, finite=finite, factor=factor)])
    order = np.random.default_rng(8).permutation(len(whole.x))
    mirrored, again = stored_bonds([part(whole.renumbered(order), finite=finite, factor=factor[order])])
    mirrored = np.sort(order[mirrored], axis=1)
    sort = np.lexsort((mirrored[:, 1], mirrored[:, 0]))
    assert (mirrored[sort] == pairs).all()
    assert (again[sort] == stored).all()


def test_filling_again_overwrites():
    """The second filling, with the correction, leaves nothing of the first; strongest is only raised."""
    whole = body((2, 2, 1))
    share: Part = part(whole, factor=correction(whole))
    rows = share.bonds.interior
    expected = rows.data.copy()
    rows.data[: 2 * W * (len(rows.offset) - 1)] = 7.0
    strongest = np.array([1e9, 0.0])
    factor = layout(correction(whole))
    constants, counts = np.array([[RESPONSE_CONSTANT]]), np.zeros((1, 1), np.int64)
    points = share.points
    arguments = (points.x, points.volume, factor, constants, points.material, CUTOFF, True, strongest, counts)
    families.fill_rows(*rows.arrays, *arguments)
    assert counts[0, 0] == share.bonds.count
    assert (rows.data == expected).all()
    assert strongest.tolist() == [1e9, share.bonds.stiffest]
    families.fill_rows(*rows.arrays, *arguments[:2], NO_FACTOR, *arguments[3:])
    assert counts[0, 0] == 2 * share.bonds.count
    assert (rows.data != expected).any()
