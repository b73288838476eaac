"""Mirror images of cells: copies and their transpose, and which bonds to own images a rank keeps."""

import numpy as np
import pytest

from pdfem_mpi.kernels import families
from pdfem_mpi.kernels.reflections import copy_images, return_images, share_own_images
from pdfem_mpi.mesh.mirrors import mirrors_at
from pdfem_mpi.peridynamics.images import MAGNITUDES, MIXED_PRODUCTS, VECTOR, Images

pytestmark = pytest.mark.nojit

W = 4


def some_images():
    """Of 3 cells: one mirrored in x, one in y and z, one in all."""
    sign = np.array([[-1.0, 1.0, 1.0], [1.0, -1.0, -1.0], [-1.0, -1.0, -1.0]])
    return Images(np.array([2, 0, 2]), np.array([1, 2, 3]), sign, np.zeros((3, 3)))


@pytest.mark.parametrize(
    ("parity", "expected"),
    [
        (VECTOR, [[-1, 1, 1], [1, -1, -1], [-1, -1, -1]]),
        (MAGNITUDES, [[1, 1, 1]] * 3),
        (MIXED_PRODUCTS, [[-1, 1, -1], [-1, 1, -1], [1, 1, 1]]),
        (((0, 0, 0), (0, 1, 2)), [[-1, -1], [1, 1], [-1, -1]]),
    ],
)
def test_factors_of_components(parity, expected):
    assert some_images().factors(parity).tolist() == expected


def test_copies_are_reflected():
    images, rng = some_images(), np.random.default_rng(0)
    table = rng.random((6, 2, 9, W))
    before = table.copy()
    copy_images(table[:, :, 3:6], images.source, images.factors(VECTOR))
    assert (table[:3] == before[:3]).all() and (table[3:, :, :3] == before[3:, :, :3]).all()
    for image, source, sign in zip(table[3:], images.source, images.sign, strict=True):
        assert (image[:, 3:6] == sign[:, None] * before[source, :, 3:6]).all()


def test_the_way_back_is_the_transpose():
    """``y . (C x) = (C^t y) . x`` in integers, for cells that are imaged twice too."""
    images, rng = some_images(), np.random.default_rng(1)
    factors = images.factors(VECTOR)
    x = rng.integers(-9, 9, (6, 2, 3, W))
    y = rng.integers(-9, 9, (6, 2, 3, W))
    copied = x.astype(float)
    copy_images(copied, images.source, factors)
    returned = y.copy()
    return_images(returned, images.source, factors)
    assert (y * copied.astype(np.int64)).sum() == (returned[:3] * x[:3]).sum()


@pytest.mark.parametrize("finite", [False, True])
def test_of_bonds_to_own_images_later_points_are_kept_and_the_own_one_halved(finite):
    """All points of a cell against all of its image, in rows as the search writes them."""
    stride = 2 * W if finite else W
    start = np.arange(0, 2 * 8 + 1, 2)
    offset = np.append(np.tile([2 * 9 * W, 3 * 9 * W], 8), 0).astype(np.uint32)
    data = np.ones(len(offset) * stride, np.float32)
    counts = np.array([[5, 0], [0, 100]])
    share_own_images(start, offset, data, np.array([7, 7]), np.array([1, 1], np.int16), finite, counts)
    first = data[: 16 * stride].reshape(8, 2, -1, W)[:, :, 0].reshape(8, 8)
    assert (first == np.triu(np.ones((8, 8))) - 0.5 * np.eye(8)).all()
    assert counts.tolist() == [[5, 0], [0, 100 - 28]]
    if finite:  # 1 / r0^2 stays, but on slots without a bond
        second = data[: 16 * stride].reshape(8, 2, -1, W)[:, :, 1].reshape(8, 8)
        assert (second == np.triu(np.ones((8, 8)))).all()


def test_bonds_to_images_of_other_cells_stay():
    start, offset = np.array([0, 1] + [1] * 7), np.array([2 * 9 * W, 0], np.uint32)
    data = np.ones(2 * W, np.float32)
    counts = np.array([[5]])
    share_own_images(start, offset, data, np.array([7, 3]), np.zeros(2, np.int16), False, counts)
    assert (data == 1.0).all()
    assert counts == 5


def brute_force(x, images, cutoff):
    """Bonds (p, q, image) that cross planes, one of each pair of mirror images, as a set of lengths by (p, q)."""
    found = {}
    for sign, shift in zip(*images, strict=True):
        y = sign * x + shift
        r = np.linalg.norm(x[:, None] - y[None], axis=2)
        for p, q in zip(*np.nonzero(r <= cutoff), strict=True):
            found.setdefault((int(min(p, q)), int(max(p, q))), []).append(float(r[p, q]))
    # a bond of two points is found from either end, those of a point to its images once each
    return {pair: sorted(lengths) for pair, lengths in found.items()}


@pytest.mark.parametrize("faces", [("x-",), ("x-", "y-"), ("x-", "y+", "z-"), ("z-", "z+")], ids=str)
def test_each_bond_across_mirror_planes_is_found_once(faces):
    """Two cells, jittered: rows against all images, each pair of points with the lengths of its bonds."""
    cutoff, rng = 1.3, np.random.default_rng(3)
    low, high = np.zeros(3), np.array([2.0, 1.0, 1.0])
    x = rng.uniform(0.05, 0.95, (16, 3)) + np.repeat([[0, 0, 0], [1, 0, 0]], 8, axis=0)
    images = mirrors_at(faces, low, high).reflections((low, high), (low - cutoff, high + cutoff))
    image_x = np.concatenate([sign * x + shift for sign, shift in zip(*images, strict=True)])
    n_images = 2 * len(images[0])
    flat = np.concatenate([x, image_x]).reshape(-1, W, 3).swapaxes(1, 2).reshape(-1)
    number = np.tile([4, 5], 1 + len(images[0]))
    n_clusters = 4 + 2 * n_images
    centre, radius = np.empty((n_clusters, 3)), np.empty(n_clusters)
    families.cluster_balls(flat, centre, radius)
    nothing = np.full(n_clusters // 2, -1), np.zeros((n_clusters // 2, 0))
    search = (flat, 4, True, number, *nothing, centre, radius, cutoff)
    bins = (centre.min(axis=0), 100.0, np.ones(3, np.int64), np.array([0, n_clusters]), np.arange(n_clusters))
    start, scratch = np.zeros(17, np.int64), np.empty(n_clusters, np.int64)
    room = np.empty(16 * n_clusters, np.uint32)
    assert families.find_rows(0, 4, *search, *bins, start, room, scratch) == 4
    offset = np.append(room[: start[-1]], np.uint32(0))
    data = np.zeros(len(offset) * 2 * W, np.float32)
    arrays = (start, offset, data)
    material, counts = np.zeros(len(number), np.int16), np.zeros((1, 1), np.int64)
    families.fill_rows(
        *arrays,
        flat,
        np.ones(4 * n_clusters),
        np.empty(0),
        np.ones((1, 1)),
        material,
        cutoff,
        True,
        np.zeros(2),
        counts,
    )
    share_own_images(*arrays, number, material, True, counts)
    found, weight = {}, 0.0
    for i in range(16):
        for row in range(start[i], start[i + 1]):
            for k in range(W):
                if data[2 * W * row + k] == 0.0:
                    continue
                q = (int(offset[row]) // 36 * W + k) % 16
                r = data[2 * W * row + W + k] ** -0.5
                full = 0.5 * np.exp(-(r**2)) / r
                share = data[2 * W * row + k] / full
                assert share == pytest.approx(0.5 if q == i else 1.0, rel=1e-5)
                found.setdefault((min(i, q), max(i, q)), []).append(r)
                weight += share
    expected = brute_force(x, images, cutoff)
    assert found.keys() == expected.keys()
    for pair, lengths in found.items():
        whole = sorted(lengths * (1 if pair[0] == pair[1] else 2))
        assert whole == pytest.approx(expected[pair], rel=1e-5), pair
    assert counts == sum(map(len, found.values()))
    assert weight == pytest.approx(0.5 * sum(map(len, expected.values())), rel=1e-6)
