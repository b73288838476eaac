"""What lies within the reach of cells, against all pairs."""

import numpy as np

from pdfem_mpi.kernels.near_cells import largest_near, mark_around, near_larger, raise_bins


def test_cells_near_larger_ones_and_those_around_are_found():
    """In bins as wide as the reach, against all pairs."""
    random = np.random.default_rng(7)
    centre, reach = random.uniform(0.0, 4.0, size=(300, 3)), 0.7
    place = (1 + centre // reach).astype(np.int32)
    shape = tuple(place.max(axis=0) + 2)
    number = np.ravel_multi_index(tuple(place.T.astype(np.int64)), shape)
    members = np.argsort(number, kind="stable")
    ends = np.searchsorted(number[members], np.arange(np.prod(shape) + 1))
    bins = np.stack([ends[:-1], ends[1:]], axis=1).reshape(*shape, 2)
    value, more = random.uniform(size=300), 0.1 * random.uniform(size=300)
    limit, (inside, more_inside, around, more_around) = random.uniform(1.0, 1.1, size=100), np.empty((4, *shape))
    tops = inside, more_inside, around, more_around
    chosen, marked = np.empty(100, bool), np.zeros(300, bool)
    raise_bins(bins, members, value, inside, around)
    raise_bins(bins, members, more, more_inside, more_around)
    near_larger(bins, members, place, centre, reach**2, value, more, *tops, limit, chosen)
    near = ((centre[:100, None] - centre) ** 2).sum(axis=2) <= reach**2
    sums = (near * value).max(axis=1) + (near * more).max(axis=1)
    np.testing.assert_array_equal(chosen, sums > limit)
    found = np.empty(100)
    largest_near(bins, members, place, centre, reach**2, value, more, *tops, np.zeros(100), found)
    np.testing.assert_array_equal(found, sums)
    assert 0 < np.count_nonzero(chosen) < 100
    cells = np.array([3, 50, 299])
    mark_around(bins, members, place, centre, reach**2, cells, marked)
    near = ((centre[cells, None] - centre) ** 2).sum(axis=2) <= reach**2
    np.testing.assert_array_equal(marked, near.any(axis=0))
    assert 3 < np.count_nonzero(marked) < 100
