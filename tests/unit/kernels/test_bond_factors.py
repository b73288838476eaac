"""Sweeps of the fit of bond factors against numpy, and the pieces of its preconditioner."""

import numpy as np
import pytest
from unit.kernels.bodies import W, body, part, parts, slots

from pdfem_mpi.kernels import bond_moments, moment_blocks, moment_grid
from pdfem_mpi.kernels.bond_moments import ROWS
from pdfem_mpi.kernels.monomials import BLOCK_ENTRIES, BLOCK_SCALES, MONOMIALS, N
from pdfem_mpi.kernels.rounding import integer_bits, pattern_for

pytestmark = pytest.mark.filterwarnings("ignore:overflow")  # numpy's integers warn as they wrap

ROUND_OFF = 1e-12  # of the largest sum: numpy uses the stored numbers, and only additions and products differ
FAMILY = 600  # bonds of a point at most, each rounded to a quantum
HELD, NEAREST = 1e-3, 1.7
both_layouts = pytest.mark.parametrize("finite", [True, False])
sizes = pytest.mark.parametrize(
    "n_cells", [pytest.param((2, 1, 1), marks=pytest.mark.nojit), (4, 3, 2)], ids=["tiny", "small"]
)


def multipliers(whole, size=1.0):
    """Seeded, of plain monomials, shape (n_points, 10)."""
    return size * np.random.default_rng(4).standard_normal((len(whole.x), N))


def table(share, v, terms, pattern):
    """The kernels' table of a part, with sums that take back a pattern for each of some terms."""
    T = np.zeros((share.points.n_clusters, ROWS, W))
    T[:, 0:3] = share.points.x.reshape(-1, 3, W)
    T[:, 3:13] = v[share.point].reshape(-1, W, N).swapaxes(1, 2)
    with np.errstate(over="ignore"):
        T.view(np.int64)[:, 13:23] = (-terms * integer_bits(pattern)).reshape(-1, 1, W)
    return T


def swept(shares, v, kernel, bound, *, symmetric=False):
    """Integer sums of all parts, shape (n_points, 10), and the quantum; ``kernel(share, rows, tables, pattern)``."""
    quantum, pattern = pattern_for(bound)
    total = np.zeros((len(v), N), np.int64)
    for share in shares:
        bonds = share.bonds
        T = table(share, v, bonds.added + bonds.taken if symmetric else bonds.added - bonds.taken, pattern)
        for rows in bonds.rows:
            kernel(share, rows, (T.reshape(-1), T.view(np.int64).reshape(-1)), pattern)
        np.add.at(total, share.point, T.view(np.int64)[:, 13:23].swapaxes(1, 2).reshape(-1, N))
    return total, quantum


def bonds_of(share):
    """Points, vectors, squared lengths and stored ``k / r^3`` of a part's bonds, whatever their layout."""
    found = [slots(share, rows) for rows in share.bonds.rows]
    i, j = (share.point[np.concatenate([part[k] for part in found])] for k in range(2))
    stored = np.concatenate([part[2] for part in found])
    return i, j, 2.0 * stored[:, 0] * stored[:, 1] if share.bonds.finite else stored[:, 0]


def monomials(xi):
    return np.prod(xi[:, None, :] ** MONOMIALS, axis=2)


def scattered(n, i, j, terms, sign):
    total = np.zeros((n, terms.shape[1]))
    np.add.at(total, i, terms)
    np.add.at(total, j, sign * terms)
    return total


def normal_products(shares, v, held=HELD, nearest=NEAREST):
    def kernel(share, rows, tables, pattern):
        bond_moments.add_normal_products(*rows.arrays, *tables, pattern, share.bonds.finite, held, nearest)

    bound = 4.0 * max(share.bonds.stiffest for share in shares) * np.abs(v).max() * np.sqrt(N)
    return swept(shares, v, kernel, bound)


def mark_some(share):
    """Give every seventh stored bond a negative number."""
    for rows in share.bonds.rows:
        numbers = rows.data.reshape(-1, 2 * W if share.bonds.finite else W)[:, :W]
        numbers *= np.where(np.arange(numbers.size).reshape(numbers.shape) % 7, 1.0, -1.0)


@both_layouts
@sizes
def test_normal_products(finite, n_cells):
    """``kappa (dv . t) t`` with ``kappa = k / r^7``; marked bonds count less, near ones not at all."""
    whole = body(n_cells, "jittered")
    share, v = part(whole, finite=finite), multipliers(whole)
    mark_some(share)
    total, quantum = normal_products([share], v)
    i, j, k = bonds_of(share)
    xi = whole.x[j] - whole.x[i]
    r2 = (xi**2).sum(axis=1)
    k = np.where(k < 0.0, -HELD * k, k) * (r2 > NEAREST)
    t = monomials(xi)
    expected = scattered(len(v), i, j, (k / r2**2 * ((v[i] - v[j]) * t).sum(axis=1))[:, None] * t, -1.0)
    assert abs(total * quantum - expected).max() < ROUND_OFF * abs(expected).max() + FAMILY * quantum


@both_layouts
@pytest.mark.parametrize("bounded", [False, True], ids=["free", "bounded"])
@sizes
def test_moments(finite, bounded, n_cells):
    """``sum k g t(n)``; bounded: no factor below 0, and exactly those bonds are marked."""
    whole = body(n_cells, "jittered")
    share, v = part(whole, finite=finite), multipliers(whole)
    peak = np.zeros(1)

    def kernel(share, rows, tables, pattern):
        bond_moments.add_moments(*rows.arrays, *tables, pattern, finite, bounded, peak)

    i, j, k = bonds_of(share)
    total, quantum = swept([share], v, kernel, 100.0 * share.bonds.strongest)
    xi = whole.x[j] - whole.x[i]
    r2 = (xi**2).sum(axis=1)
    t = monomials(xi)
    g = 1.0 + ((v[i] - v[j]) * t).sum(axis=1) / r2**2
    assert (g < -0.01).any()
    used = np.maximum(g, 0.0) if bounded else g
    expected = scattered(len(v), i, j, (k * used)[:, None] * t, -1.0)
    assert abs(total * quantum - expected).max() < ROUND_OFF * abs(expected).max() + FAMILY * quantum
    assert peak[0] == pytest.approx(abs(k * used * r2**1.5).max(), rel=1e-12)
    marked = bonds_of(share)[2] < 0.0
    assert (marked == ((g < 0.0) & bounded)).all()


@both_layouts
@sizes
def test_factors_are_written_into_the_bonds(finite, n_cells):
    """Stored numbers times g, rounded to single precision once; what is told of them."""
    whole = body(n_cells, "jittered")
    for bounded in (False, True):
        share, v = part(whole, finite=finite), multipliers(whole)
        i, j, k = bonds_of(share)
        xi = whole.x[j] - whole.x[i]
        r2 = (xi**2).sum(axis=1)
        g = np.where(r2 > NEAREST, 1.0 + ((v[i] - v[j]) * monomials(xi)).sum(axis=1) / r2**2, 1.0)
        expected = k * (np.maximum(g, 0.0) if bounded else g)
        held, extremes = 0, np.array([0.0, 0.0, -np.inf, -np.inf])
        T = table(share, v, np.zeros(len(whole.x), np.int64), 0.0)
        before = [rows.data != 0.0 for rows in share.bonds.rows]
        for rows in share.bonds.rows:
            held += bond_moments.write_factors(*rows.arrays, T.reshape(-1), finite, bounded, NEAREST, extremes)
        width = 2 * W if finite else W
        found = []
        for rows, was in zip(share.bonds.rows, before, strict=True):
            data = rows.data.reshape(-1, width).astype(float)
            value = 2.0 * data[:, :W] * data[:, W:] if finite else data
            found.append(value[was.reshape(-1, width)[:, :W]])
        found = np.concatenate(found)
        np.testing.assert_allclose(found, expected, rtol=2.0**-23, atol=1e-12 * abs(k).max())
        assert held == (np.count_nonzero(g <= 0.0) if bounded else 0)
        assert extremes[0] == pytest.approx(abs(expected * r2**1.5).max(), rel=1e-6)
        assert extremes[1] == pytest.approx(abs(expected * r2).max() / 2, rel=1e-6)
        assert extremes[2] == pytest.approx(g.max(), rel=1e-9)
        assert -extremes[3] == pytest.approx(max(g.min(), 0.0) if bounded else g.min(), rel=1e-9)


@both_layouts
def test_a_second_factor_of_negative_numbers_adds_in_proportion_to_their_size(finite):
    """What undoes rounding: ``|k| (sign + (v_i - v_j) . t / r^4)``, whose change has the sign of the multipliers."""
    whole = body((2, 1, 1), "jittered")
    share, v = part(whole, finite=finite), multipliers(whole, 1e-3)
    mark_some(share)
    i, j, k = bonds_of(share)
    xi = whole.x[j] - whole.x[i]
    change = ((v[i] - v[j]) * monomials(xi)).sum(axis=1) / (xi**2).sum(axis=1) ** 2
    T = table(share, v, np.zeros(len(whole.x), np.int64), 0.0)
    for rows in share.bonds.rows:
        bond_moments.write_factors(*rows.arrays, T.reshape(-1), finite, False, 0.0, np.zeros(4))
    np.testing.assert_allclose(bonds_of(share)[2], k + abs(k) * change, rtol=2.0**-22)


@both_layouts
@sizes
def test_blocks_are_those_of_the_operator(finite, n_cells):
    """28 sums of degree six fill the diagonal block that unit multipliers of one point give."""
    whole = body(n_cells, "jittered")
    share = part(whole, finite=finite)
    mark_some(share)
    sums = []
    for number in range(3):

        def kernel(share, rows, tables, pattern, number=number):
            bond_moments.add_blocks(*rows.arrays, *tables, pattern, finite, HELD, NEAREST, number)

        total, quantum = swept([share], np.zeros((len(whole.x), N)), kernel, 4.0 * share.bonds.stiffest, symmetric=True)
        sums.append(total * quantum)
    sums = np.concatenate(sums, axis=1)
    chosen = 5
    block = sums[chosen][BLOCK_ENTRIES]
    for a in range(N):
        v = np.zeros((len(whole.x), N))
        v[chosen, a] = 1.0
        total, quantum = normal_products([share], v)
        np.testing.assert_allclose(block[a], total[chosen] * quantum, rtol=0, atol=2.0 * FAMILY * quantum)


def test_sums_do_not_depend_on_ranks_or_numbers():
    """Equal integers."""
    whole = body((3, 3, 2), "jittered")
    v = multipliers(whole)
    expected, _ = normal_products([part(whole)], v)
    assert (normal_products(parts(whole, 3), v)[0] == expected).all()
    order = np.random.default_rng(2).permutation(len(whole.x))
    renumbered, _ = normal_products([part(whole.renumbered(order))], v[order])
    assert (renumbered == expected[order]).all()


@pytest.mark.nojit
def test_inverse_blocks():
    """Cholesky's method against numpy, and a direction without stiffness, which is left alone."""
    rng = np.random.default_rng(7)
    n = rng.standard_normal((40, 3))
    n /= np.linalg.norm(n, axis=1)[:, None]
    t = monomials(n)
    full = (t * rng.uniform(0.5, 1.0, (40, 1))).T @ t
    flat = monomials(n * [1.0, 1.0, 0.0])
    flat = flat.T @ flat
    sums = np.zeros((2, 3 * N))
    for p, matrix in enumerate((full, flat)):
        sums[p, BLOCK_ENTRIES] = matrix
    pinned = np.array([0.25, 0.0])
    inverse = np.zeros((2, 55), np.float32)
    moment_blocks.invert_blocks(sums, pinned, inverse)
    unpacked = np.zeros((2, N, N))
    unpacked[:, *np.tril_indices(N)] = inverse
    unpacked += np.tril(unpacked, -1).swapaxes(1, 2)
    scaled = full * BLOCK_SCALES + 0.25 * np.eye(N)
    np.testing.assert_allclose(unpacked[0] @ scaled, np.eye(N), atol=1e-5)  # stored in single precision
    soft = np.array([exponents[2] > 0 for exponents in MONOMIALS])
    assert not unpacked[1][soft].any()
    stiff = np.ix_(~soft, ~soft)
    np.testing.assert_allclose(unpacked[1][stiff] @ (flat * BLOCK_SCALES)[stiff], np.eye(4), atol=1e-5)

    r, z = rng.standard_normal((1, N, W)), np.full((1, N, W), 9.0)
    packed = np.concatenate([inverse, inverse])
    moment_blocks.multiply_blocks(packed, r.reshape(-1), z.reshape(-1))
    for lane in range(W):
        np.testing.assert_allclose(z[0, :, lane], unpacked[lane % 2] @ r[0, :, lane], rtol=1e-12, atol=1e-12)


@pytest.mark.nojit
def test_interpolation_reproduces_quadratic_functions_and_restriction_is_its_transpose():
    """On a grid whose nodes are numbered in some order."""
    rng = np.random.default_rng(8)
    counts, lower, inverse_h = np.array([2, 3, 1]), np.array([-1.0, 0.5, 2.0]), np.array([2.0, 1.0, 0.25])
    upper = lower + counts / inverse_h
    x = rng.uniform(lower, upper, (8, 3))
    x[0], x[1] = lower, upper  # the last cell holds its upper corner
    flat = np.ascontiguousarray(x.reshape(-1, W, 3).swapaxes(1, 2)).reshape(-1)
    number = rng.permutation(int(np.prod(2 * counts + 1)))
    index = np.stack(np.unravel_index(np.arange(len(number)), 2 * counts + 1), axis=1)
    coarse = np.zeros((len(number), N))
    slopes, squares = rng.standard_normal((2, 3, N))
    nodes = lower + 0.5 * index / inverse_h
    coarse[number] = nodes @ slopes + nodes**2 @ squares
    z = np.zeros((2, N, W))
    grid = (8, flat, lower, inverse_h, counts, number)
    moment_grid.interpolate_moments(*grid, coarse, z.reshape(-1))
    found = z.swapaxes(1, 2).reshape(8, N)
    np.testing.assert_allclose(found, x @ slopes + x**2 @ squares, rtol=1e-12, atol=1e-12)

    r = rng.standard_normal((2, N, W))
    sums = np.zeros((len(number), N), np.int64)
    moment_grid.restrict_moments(*grid, r.reshape(-1), 2.0**-40, sums)
    assert (sums * 2.0**-40 * coarse).sum() == pytest.approx((r * z).sum(), rel=1e-10)
