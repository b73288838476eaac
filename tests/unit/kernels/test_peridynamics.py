"""Bond sweeps against numpy in extended precision; sums that no order, partition or numbering changes."""

import math

import numpy as np
import pytest
from unit.kernels.bodies import (
    LONG,
    W,
    add_at,
    body,
    layout,
    part,
    parts,
    slots,
    stored_bonds,
    strengths,
    table_rows,
)  # fmt: skip

from pdfem_mpi.kernels import bond_densities, bond_response, bond_sweeps, point_table
from pdfem_mpi.kernels.bond_response import SERIES_LIMIT, SMALLEST_SQUARE
from pdfem_mpi.kernels.rounding import integer_bits, pattern_for
from pdfem_mpi.peridynamics.critical_stretches import UNBREAKABLE
from pdfem_mpi.peridynamics.rows import Rows
from support.point_table import reset_forces

pytestmark = pytest.mark.filterwarnings("ignore:overflow")  # numpy's integers warn as they wrap

FINITE = {
    "series": bond_sweeps.add_forces_series,
    "closed": bond_sweeps.add_forces_closed,
    "series failing": bond_sweeps.add_forces_series_failing,
    "closed failing": bond_sweeps.add_forces_closed_failing,
}
LINEAR = {"linear": bond_sweeps.add_forces_linear, "linear failing": bond_sweeps.add_forces_linear_failing}
SWEEPS = FINITE | LINEAR
every_sweep = pytest.mark.parametrize("name", list(SWEEPS))
finite_sweeps = pytest.mark.parametrize("name", list(FINITE))
failing_sweeps = pytest.mark.parametrize("name", ["series failing", "closed failing"])
every_failing_sweep = pytest.mark.parametrize("name", ["series failing", "closed failing", "linear failing"])

SUMS = 1e-11  # of the largest force: rounding to quanta, of z = 2 x + u, and the series up to strains of 3e-3
TRUNCATION = 1.5e-8  # the series at its limit: 231/512 e^5
ROOM = 1000  # records: a point of these bodies has fewer slots, all of them more broken bonds
CANCELLATION = 2.0**-51  # of phi: the closed form has 1 + e; where e is small the solvers use the series
STORAGE = 1e-7  # two numbers rounded to float32, 6e-8 each, of random sign
NO_CRACK = UNBREAKABLE


def displacements(whole, strain, seed=1):
    """A seeded gradient and as much again at random, which strain the shortest bonds most."""
    rng = np.random.default_rng(seed)
    gradient = rng.uniform(-0.3, 0.3, (3, 3))
    return strain * (whole.x @ gradient + 0.1 * rng.uniform(-1.0, 1.0, whole.x.shape))


def squares(whole, u, pairs, inverse_square):
    """``e`` of each bond from lengths in extended precision, with the stored ``1 / r^2``."""
    i, j = pairs.T
    x, u = whole.x.astype(LONG), u.astype(LONG)
    xi, y = x[j] - x[i], x[j] + u[j] - x[i] - u[i]
    return ((y**2).sum(axis=1) - (xi**2).sum(axis=1)) * inverse_square, y


def phi(e):
    """``1 - r0 / r``, held at compression to a thousandth of the length."""
    return 1 - 1 / np.sqrt(np.maximum(1 + e, LONG(SMALLEST_SQUARE)))


def finite_reference(whole, u, pairs, stored, intact=True):
    """Forces of the bonds ``K phi 2 (xi + eta)`` on all points, and each bond's ``e``."""
    e, y = squares(whole, u, pairs, stored[:, 1])
    f = (2 * stored[:, 0] * phi(e) * intact)[:, None] * y
    return add_at(len(whole.x), pairs, f, -f), e


def linear_reference(whole, u, pairs, stored):
    """Forces ``K' (eta . xi) xi``, and each bond's ``K' (eta . xi)``."""
    i, j = pairs.T
    xi = (whole.x[j] - whole.x[i]).astype(LONG)
    f = stored[:, 0] * (xi * (u[j] - u[i])).sum(axis=1)
    return add_at(len(whole.x), pairs, f[:, None] * xi, -f[:, None] * xi), f


def bound_for(share, name, met):
    """Bound of a force component, as the solvers choose it, from the largest ``|e|`` or ``|K' eta . xi|``."""
    return 4.0 * met * (share.bonds.cutoff if name in LINEAR else share.bonds.strongest)


class Swept:
    """Forces of the body's points after the sweeps of all parts, summed as integers.

    Attributes
    ----------
    integers : int64, shape (n_points, 3)
    force : float64, shape (n_points, 3)
    extremes : float64, shape (2,)
    broken : int
    records : float64, shape (broken, 4)
        Points (lower, higher) of the broken bonds, and their two stored numbers.
    """

    def __init__(self, shares, u, name, bound, critical_stretch=NO_CRACK):
        self.quantum, pattern = pattern_for(bound)
        table = bond_response.constants(pattern)
        limit = critical_stretch if name in LINEAR else critical_stretch * (2.0 + critical_stretch)
        self.records = np.empty((0, 4))
        self.integers = np.zeros((sum(8 * share.points.n_owned for share in shares), 3), np.int64)
        self.extremes, self.broken = np.zeros(2), 0
        for share in shares:
            S = table_of(share, u)
            SI = S.view(np.int64).reshape(-1)
            reset_forces(SI, share.bonds.added - share.bonds.taken, integer_bits(pattern))
            for rows in share.bonds.rows:
                n = len(rows.start) - 1
                for first, last in ((0, n // 3), (n // 3, n)):
                    while first < last:
                        failing = nothing_fails(share, limit)
                        first = SWEEPS[name](
                            first, last, *rows.arrays, S.reshape(-1), SI, table, self.extremes, *failing
                        )
                        self._keep(share, *failing[3:])
            np.add.at(self.integers, share.point, table_rows(S.view(np.int64), 6))
        self.force = self.integers * self.quantum

    def _keep(self, share, pairs, strengths, counter):
        n = int(counter[0])
        self.broken += n
        ends = np.sort(share.point[pairs[:n]], axis=1)
        self.records = np.concatenate([self.records, np.concatenate([ends, strengths[:n]], axis=1)])


def nothing_fails(share, limit=UNBREAKABLE):
    """One class of bonds with one limit, and empty records."""
    one_class = np.zeros(share.points.n_clusters, np.uint8), np.array([limit]), np.array([[limit]])
    return *one_class, np.empty((ROOM, 2), np.int64), np.full((ROOM, 2), np.nan, np.float32), np.zeros(1, np.int64)


def table_of(share, u):
    """The table of one part: its displacements, and positions as its kinematics want them."""
    local = layout(u[share.point])
    S = np.zeros((share.points.n_clusters, 9, W))
    S[:, 3:6] = share.points.x.reshape(-1, 3, W)
    point_table.load_displacements(local, share.points.x, S.reshape(-1), share.points.n_clusters, share.bonds.finite)
    return S


def swept(whole, u, name, critical_stretch=NO_CRACK, shares=None, headroom=1.0):
    """Sweep a body with the bound its reference asks for; broken bonds are gone from ``shares``."""
    shares = [part(whole, finite=name not in LINEAR)] if shares is None else shares
    pairs, stored = stored_bonds(shares)
    reference = linear_reference if name in LINEAR else finite_reference
    force, met = reference(whole, u, pairs, stored)
    bound = bound_for(shares[0], name, headroom * float(abs(met).max()))
    return Swept(shares, u, name, bound, critical_stretch), force, met


def worst(result, reference):
    """Largest error of a force component over the largest component."""
    return float(abs(result - reference).max() / abs(reference).max())


@pytest.mark.nojit
@every_sweep
def test_tiny_body(name):
    """Two cells; where bad indices raise."""
    whole = body((2, 1, 1), "jittered")
    result, force, _ = swept(whole, displacements(whole, 1e-3), name)
    assert worst(result.force, force) < SUMS


@pytest.mark.parametrize("kind", ["box", "jittered", "graded"])
@pytest.mark.parametrize("strain", [1e-6, 1e-4, 3e-3])
@every_sweep
def test_forces(name, strain, kind):
    """All sweeps, with the stored numbers: eqs (2), (3), (14)."""
    whole = body((4, 3, 3), kind)
    result, force, met = swept(whole, displacements(whole, strain), name)
    assert 0 < abs(met).max() < (1.0 if name in LINEAR else 3 * strain)
    assert worst(result.force, force) < SUMS + (CANCELLATION / strain if "closed" in name else 0.0)
    assert result.broken == 0


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("name", ["series", "series failing"])
def test_series_at_its_limit(name, sign):
    """All bonds at the largest |e| for which the solvers use it."""
    whole = body((4, 3, 3))
    stretch = math.sqrt(1 + sign * 0.99 * SERIES_LIMIT) - 1
    result, force, met = swept(whole, stretch * whole.x, name)
    assert 0.98 * SERIES_LIMIT < abs(met).min() < abs(met).max() < SERIES_LIMIT
    assert worst(result.force, force) < TRUNCATION


@pytest.mark.parametrize("strain", [1e-2, 0.1])
@pytest.mark.parametrize("name", ["closed", "closed failing"])
def test_closed_form_at_large_strain(name, strain):
    """Beyond the series."""
    whole = body((4, 3, 3), "jittered")
    result, force, _ = swept(whole, displacements(whole, strain), name)
    assert worst(result.force, force) < SUMS


@pytest.mark.parametrize("stretch", [0.3, -0.3, -0.99])
@pytest.mark.parametrize("name", ["closed", "closed failing"])
def test_uniform_stretch_and_compression(name, stretch):
    """Every bond has the same stretch s and pulls with ``strength s`` along itself."""
    whole = body((4, 3, 3))
    result, force, met = swept(whole, stretch * whole.x, name)
    assert worst(result.force, force) < SUMS
    pairs, _ = stored_bonds([part(whole)])
    xi = np.diff(whole.x[pairs], axis=1)[:, 0]
    f = (strengths(whole, pairs) * stretch / np.linalg.norm(xi, axis=1))[:, None] * xi
    # 1 + e = (1 + s)^2 magnifies the rounding of the stored 1 / r^2 by (1 + s)^-2
    assert worst(result.force, add_at(len(whole.x), pairs, f, -f)) < STORAGE / (1 + stretch) ** 2
    np.testing.assert_allclose(met.astype(float), (1 + stretch) ** 2 - 1, rtol=STORAGE)


@pytest.mark.parametrize("left", [0.0, 1e-6, 1e-4])
@pytest.mark.parametrize("name", ["closed", "closed failing"])
def test_compression_to_nothing_stays_finite(name, left):
    """Below a thousandth of the length ``1 + e`` is held: no division by nothing, no large force."""
    whole = body((3, 2, 2))
    result, force, met = swept(whole, (left - 1.0) * whole.x, name)
    assert met.min() < SMALLEST_SQUARE - 1 + 1e-6
    scale = part(whole).bonds.strongest
    assert abs(result.force - force).max() < 1e-9 * scale  # x + u cancels to 1e-16, phi is 999
    assert abs(result.force).max() < 100 * scale


@finite_sweeps
def test_rigid_rotation_gives_no_force(name):
    """90 degrees and a translation: no bond changes its length."""
    whole = body((4, 3, 3), "jittered")
    rotation = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    u = whole.x @ rotation.T - whole.x + [0.3, -2.0, 7.0]
    share = part(whole)
    result = Swept([share], u, name, share.bonds.strongest * 2.0**-20)
    total = np.bincount(near_ends(share), minlength=len(whole.x)).max() * share.bonds.strongest
    assert abs(result.force).max() < 1e-14 * total  # e is a sum of terms of size 2 that cancel to round-off
    assert abs(result.extremes).max() < 1e-13


def near_ends(share):
    """Both points of all bonds."""
    return stored_bonds([share])[0].reshape(-1)


def test_small_rotation_gives_no_linear_force():
    """The linear sweep: eta is normal to xi for an infinitesimal rotation."""
    whole = body((3, 3, 2), "jittered")
    u = 1e-3 * np.cross([1.0, -2.0, 0.5], whole.x) + 4.0
    share = part(whole, finite=False)
    result = Swept([share], u, "linear", share.bonds.strongest * 2.0**-10)
    assert abs(result.force).max() < 1e-12 * share.bonds.strongest  # u = 4 is rounded to 1e-15


@pytest.mark.parametrize("strain", [1e-6, 3e-3])
@every_sweep
def test_forces_with_coefficients_in_double_precision(name, strain):
    """Against eqs (2), (3) as printed, without stored numbers: only their rounding to float32 is seen."""
    whole = body((4, 3, 2), "jittered")
    u = displacements(whole, strain)
    factor = np.random.default_rng(6).uniform(0.8, 6.0, whole.x.shape)
    share = part(whole, finite=name not in LINEAR, factor=factor)
    result, _, _ = swept(whole, u, name, shares=[share])
    pairs, _ = stored_bonds([share])
    i, j = pairs.T
    xi, eta = (whole.x[j] - whole.x[i]).astype(LONG), (u[j] - u[i]).astype(LONG)
    r = np.sqrt((xi**2).sum(axis=1))
    y = xi + eta
    length = np.sqrt((y**2).sum(axis=1))
    if name in LINEAR:
        stretch, y, length = (xi * eta).sum(axis=1) / r**2, xi, r
    else:
        stretch = (length - r) / r
    f = (strengths(whole, pairs, factor) * stretch / length)[:, None] * y
    assert worst(result.force, add_at(len(whole.x), pairs, f, -f)) < STORAGE


@finite_sweeps
def test_linear_and_finite_agree_for_small_displacements(name):
    """The tangent at the undeformed state: the difference is of the order of the strain."""
    whole = body((3, 2, 2))
    u = displacements(whole, 1e-7)
    result, _, _ = swept(whole, u, name)
    other, _, _ = swept(whole, u, "linear")
    assert worst(result.force, other.force) < 2 * STORAGE + 1e-6


@every_sweep
def test_extremes(name):
    """Largest and smallest ``e`` (linear: the largest ``|K' eta . xi|`` alone) met, never narrowed."""
    whole = body((3, 3, 2), "jittered")
    result, _, met = swept(whole, displacements(whole, 1e-3), name)
    expected = [abs(met).max(), 0.0] if name in LINEAR else [met.max(), met.min()]
    np.testing.assert_allclose(result.extremes, np.array(expected, float), rtol=1e-11)
    share = part(whole, finite=name not in LINEAR)
    rows, S = share.bonds.interior, table_of(share, displacements(whole, 1e-3))
    extremes = np.array([5.0, -7.0])
    SWEEPS[name](
        0, len(rows.start) - 1, *rows.arrays, S.reshape(-1), S.view(np.int64).reshape(-1),
        bond_response.constants(1.0), extremes, *nothing_fails(share),
    )  # fmt: skip
    assert extremes.tolist() == [5.0, -7.0]


@pytest.mark.parametrize("stretch", [1e-9, 0.0025, 0.5, 3.0, -0.3, -0.999])
def test_a_force_is_far_below_the_range_of_its_patterns(stretch):
    """|p| <= strength |e| < 2^51 quanta, with the bound the solvers take: |e| times the strongest bond."""
    whole = body((3, 2, 2), "jittered")
    share = part(whole)
    pairs, stored = stored_bonds([share])
    _, e = finite_reference(whole, stretch * whole.x, pairs, stored)
    quantum, _ = pattern_for(float(abs(e).max()) * share.bonds.strongest)
    _, y = squares(whole, stretch * whole.x, pairs, stored[:, 1])
    f = abs((2 * stored[:, 0] * phi(e))[:, None] * y)
    assert f.max() <= 2.0**50 * quantum
    linear = part(whole, finite=False)
    _, tangent = linear_reference(whole, stretch * whole.x, *stored_bonds([linear]))
    quantum, _ = pattern_for(float(abs(tangent).max()) * linear.bonds.cutoff)
    assert (abs(tangent)[:, None] * abs(np.diff(whole.x[pairs], axis=1)[:, 0])).max() <= 2.0**50 * quantum


# --- failure


def critical(whole, u, fraction=0.1):
    """A critical stretch that some of the bonds pass, in the widest gap near that number."""
    pairs, stored = stored_bonds([part(whole)])
    e = np.sort(finite_reference(whole, u, pairs, stored)[1])
    k = int((1 - fraction) * len(e)) + np.argmax(np.diff(e[int((1 - fraction) * len(e)) :][:50]))
    assert e[k + 1] - e[k] > 1e-10 * e[k]  # round-off decides on no bond
    return float(np.sqrt(1 + 0.5 * (e[k] + e[k + 1])) - 1)


def by_points(records):
    """Records in the order of their points, as nested lists."""
    return sorted(np.asarray(records, float).tolist())


@pytest.mark.parametrize("kind", ["box", "jittered"])
@pytest.mark.parametrize("fraction", [0.2, 0.05, 0.001])
def test_bonds_beyond_the_linear_critical_stretch_break(kind, fraction):
    """Eq. 4 with the stretch ``eta . xi / |xi|^2``: exactly the bonds of the reference, their forces gone at once."""
    whole = body((4, 3, 3), kind)
    u = displacements(whole, 3e-3)
    share = part(whole, finite=False)
    pairs, stored = stored_bonds([share])
    xi, eta = np.diff(whole.x[pairs], axis=1)[:, 0], np.diff(u[pairs], axis=1)[:, 0]
    stretch = (xi * eta).sum(axis=1) / (xi * xi).sum(axis=1)
    ordered = np.sort(stretch)
    k = int((1 - fraction) * len(ordered))
    s0 = 0.5 * (ordered[k] + ordered[k + 1])
    assert ordered[k + 1] - ordered[k] > 1e-10 * s0
    result, _, _ = swept(whole, u, "linear failing", s0, [share])
    intact = stretch <= s0
    assert result.broken == np.count_nonzero(~intact) > 0
    force = add_at(
        len(whole.x),
        pairs[intact],
        (f := stored[intact] * (xi * eta).sum(axis=1)[intact, None] * xi[intact]),
        -f,
    )
    assert worst(result.force, force) < SUMS
    left, numbers = stored_bonds([share])
    assert (left == pairs[intact]).all()
    assert (numbers == stored[intact]).all()
    assert by_points(result.records[:, :3]) == by_points(np.concatenate([pairs, stored], axis=1)[~intact])


@failing_sweeps
@pytest.mark.parametrize("kind", ["box", "jittered"])
@pytest.mark.parametrize("fraction", [0.2, 0.05, 0.001])
def test_bonds_beyond_the_critical_stretch_break(name, kind, fraction):
    """Eq. 4: exactly the bonds of the reference; their forces are gone at once, their numbers 0."""
    whole = body((4, 3, 3), kind)
    u = displacements(whole, 3e-3)
    s0 = critical(whole, u, fraction)
    share = part(whole)
    pairs, stored = stored_bonds([share])
    result, _, e = swept(whole, u, name, s0, [share])
    intact = np.sqrt(1 + e) - 1 <= s0
    force, _ = finite_reference(whole, u, pairs, stored, intact)
    assert worst(result.force, force) < SUMS
    assert result.broken == np.count_nonzero(~intact) > 0
    assert by_points(result.records) == by_points(np.concatenate([pairs, stored], axis=1)[~intact])
    left, numbers = stored_bonds([share])
    assert (left == pairs[intact]).all()
    assert (numbers == stored[intact]).all()
    for rows in share.bonds.rows:
        data = rows.data.reshape(-1, 2, W)
        assert ((data[:, 0] == 0.0) == (data[:, 1] == 0.0)).all()
    np.testing.assert_allclose(result.extremes, [float(e[intact].max()), float(e.min())], rtol=1e-9)
    again = Swept([share], u, name, bound_for(share, name, float(abs(e).max())), s0)
    assert again.broken == 0
    assert (again.integers == result.integers).all()
    assert again.extremes[0] == result.extremes[0]


@pytest.mark.nojit
@every_failing_sweep
def test_tiny_body_breaks(name):
    """Two cells pulled apart: the bonds across the gap break, and the halves are free of force."""
    whole = body((2, 1, 1))
    u = np.where(np.arange(16)[:, None] < 8, 0.0, [0.5, 0.0, 0.0])
    share = part(whole, finite=name not in LINEAR)
    between = stored_bonds([share])[0] // 8
    result = Swept([share], u, name, share.bonds.strongest, 1e-3)
    assert result.broken == np.count_nonzero(between[:, 0] != between[:, 1])
    assert (result.integers == 0).all()


@failing_sweeps
def test_bonds_at_the_critical_stretch_hold(name):
    """s > s_0 breaks: a body stretched by just less keeps all bonds, by just more none."""
    whole = body((2, 2, 2))
    for s0, kept in ((1e-3 * (1 + 2e-7), True), (1e-3 * (1 - 2e-7), False)):  # 1 / r^2 is rounded to 6e-8
        share = part(whole)
        result, _, _ = swept(whole, 1e-3 * whole.x, name, s0, [share])
        assert result.broken == (0 if kept else share.bonds.count)
        assert (result.integers == 0).all() != kept


@failing_sweeps
def test_compressed_bonds_do_not_break(name):
    """Only extension does, and the smallest ``e`` of a point that lost bonds is still seen."""
    whole = body((3, 2, 2))
    result, _, _ = swept(whole, -5e-3 * whole.x, name, 1e-3)
    assert result.broken == 0
    u = np.array([[5e-3, -6e-3, -6e-3]]) * whole.x
    result, _, e = swept(whole, u, name, 1e-3)
    assert 0 < result.broken < len(e)
    np.testing.assert_allclose(result.extremes[1], float(e.min()), rtol=1e-9)


@failing_sweeps
@pytest.mark.parametrize("distance", [10.0, 1e6, 1e120])
def test_a_point_torn_off(name, distance):
    """However far: its forces are taken back to the last bit, and the rest does not feel it."""
    whole = body((3, 2, 2), "jittered")
    u = displacements(whole, 1e-3)
    lone = 37
    u[lone, 1] += distance
    bound = part(whole).bonds.strongest * 2.0**-6
    share = part(whole)
    ends = near_ends(share)
    n_bonds = np.count_nonzero(ends == lone)
    result = Swept([share], u, name, bound, 0.01)
    assert result.broken == n_bonds
    assert (result.integers[lone] == 0).all()
    again = Swept([share], u, name, bound, 0.01)
    assert again.broken == 0
    assert (again.integers == result.integers).all()
    pairs, stored = stored_bonds([part(whole)])
    force, _ = finite_reference(whole, u, pairs, stored, (pairs != lone).all(axis=1))
    assert worst(result.force, force) < SUMS
    assert result.extremes[0] < 0.01


# --- sums


def with_other_row_order(share, seed):
    """The rows of each point in another order."""
    rng = np.random.default_rng(seed)
    changed = []
    for rows in share.bonds.rows:
        order = np.concatenate(
            [rng.permutation(np.arange(a, b)) for a, b in zip(rows.start, rows.start[1:], strict=False)]
            + [np.array([len(rows.offset) - 1])]
        ).astype(int)
        data = rows.data.reshape(len(rows.offset), -1)[order].reshape(-1)
        changed.append(Rows(rows.start, rows.offset[order], data))
    return changed


CASES = dict.fromkeys(SWEEPS, NO_CRACK) | {"series failing": 3e-4, "closed failing": 3e-4, "linear failing": 3e-4}
cases = pytest.mark.parametrize(("name", "s0"), list(CASES.items()), ids=list(CASES))


def one_rank(whole, name, s0):
    """Displacements, bound and the result to compare with."""
    u = displacements(whole, 1e-3)
    share = part(whole, finite=name not in LINEAR)
    bound = bound_for(share, name, 0.01)
    result = Swept([share], u, name, bound, s0)
    assert (result.broken > 0) == (s0 < 1.0)
    return u, bound, result


@cases
def test_rows_in_another_order(name, s0):
    """Equal integers, extremes and counts."""
    whole = body((4, 3, 2), "jittered")
    u, bound, expected = one_rank(whole, name, s0)
    share = part(whole, finite=name not in LINEAR)
    before = share.bonds.interior.offset.copy()
    share.bonds.interior.offset[:], share.bonds.interior.data[:] = (
        with_other_row_order(share, 3)[0].offset,
        with_other_row_order(share, 3)[0].data,
    )
    assert (share.bonds.interior.offset != before).any()
    result = Swept([share], u, name, bound, s0)
    assert_equal(result, expected)


def assert_equal(result, expected, order=None):
    """To the last bit."""
    integers = expected.integers if order is None else expected.integers[order]
    assert (result.integers == integers).all()
    assert (result.extremes == expected.extremes).all()
    assert result.broken == expected.broken


@cases
@pytest.mark.parametrize("n_parts", [2, 3, 4])
def test_cells_dealt_to_ranks(name, s0, n_parts):
    """Ghost rows and owned rows sum to what one rank has."""
    whole = body((4, 3, 2), "jittered")
    u, bound, expected = one_rank(whole, name, s0)
    shares = parts(whole, n_parts, finite=name not in LINEAR)
    assert all(len(share.bonds.boundary.offset) > 1 for share in shares)
    assert_equal(Swept(shares, u, name, bound, s0), expected)


@cases
def test_points_renumbered(name, s0):
    """Other clusters, lanes and bond owners."""
    whole = body((4, 3, 2), "jittered")
    u, bound, expected = one_rank(whole, name, s0)
    order = np.random.default_rng(9).permutation(len(whole.x))
    share = part(whole.renumbered(order), finite=name not in LINEAR)
    assert_equal(Swept([share], u[order], name, bound, s0), expected, order)


@cases
def test_internal_forces_sum_to_nothing(name, s0):
    """Exactly, as integers; and their moment to the rounding of a force's direction."""
    whole = body((4, 3, 2), "jittered")
    u, _, result = one_rank(whole, name, s0)
    assert (result.integers.sum(axis=0) == 0).all()
    assert (result.integers != 0).any()
    y = whole.x + (0 if name in LINEAR else u)
    arms = np.cross(y, result.force)
    assert abs(arms.sum(axis=0)).max() < 1e-12 * abs(arms).sum()  # float64 sums of some hundred terms


@every_sweep
@pytest.mark.nojit
def test_rest_is_free_of_force(name):
    """No displacement, no force: what the patterns of M leave is exactly taken back by the start value."""
    whole = body((2, 1, 1))
    share = part(whole, finite=name not in LINEAR)
    result = Swept([share], np.zeros_like(whole.x), name, 1.0, 1e-3)
    assert (result.integers == 0).all()
    assert result.broken == 0
    assert (result.extremes == 0.0).all()


@every_sweep
def test_sweeps_add_to_forces(name):
    """Twice the sweep, twice the sums."""
    whole = body((2, 2, 1))
    u = displacements(whole, 1e-3)
    share = part(whole, finite=name not in LINEAR)
    once = Swept([share], u, name, 1.0)
    _, pattern = pattern_for(1.0)
    S = table_of(share, u)
    SI = S.view(np.int64).reshape(-1)
    reset_forces(SI, 2 * (share.bonds.added - share.bonds.taken), integer_bits(pattern))
    rows = share.bonds.interior
    table = bond_response.constants(pattern)
    for _ in range(2):
        whole_sweep = 0, len(rows.start) - 1, *rows.arrays, S.reshape(-1), SI, table, np.zeros(2)
        SWEEPS[name](*whole_sweep, *nothing_fails(share))
    assert (table_rows(S.view(np.int64), 6) == 2 * once.integers).all()
    assert (table_rows(S, 0) == u).all()


# --- the table


@pytest.mark.nojit
@pytest.mark.parametrize("finite", [True, False])
def test_load_displacements(finite):
    """Rows 0-2, and z = 2 x + u in rows 3-5 for finite kinematics, of the first clusters only."""
    rng = np.random.default_rng(11)
    x, u = rng.normal(size=(5, 3, W)), rng.normal(size=(3, 3, W))
    S = np.full((5, 9, W), 7.0)
    point_table.load_displacements(u.reshape(-1), x.reshape(-1), S.reshape(-1), 3, finite)
    assert (S[:3, 0:3] == u).all()
    assert (S[:3, 3:6] == (2.0 * x[:3] + u if finite else 7.0)).all()
    S[:3, :6] = 7.0
    assert (S == 7.0).all()


@pytest.mark.nojit
def test_complete_z():
    """z = 2 x + u of clusters whose u is there already."""
    rng = np.random.default_rng(12)
    x, S = rng.normal(size=(5, 3, W)), rng.normal(size=(5, 9, W))
    before = S.copy()
    point_table.complete_z(2, 4, x.reshape(-1), S.reshape(-1))
    before[2:4, 3:6] = 2.0 * x[2:4] + before[2:4, 0:3]
    assert np.array_equal(S, before)


@pytest.mark.nojit
@pytest.mark.parametrize("finite", [True, False])
def test_start_evaluation(finite):
    """Displacements of the free clusters; minus the patterns to come, wrapped to 64 bits, in rows 6-8 of every one."""
    rng = np.random.default_rng(14)
    x, u = rng.normal(size=(3, 3, W)), rng.normal(size=(2, 3, W))
    excess = np.array([0, 4, -8, 2000, 1, 2, 3, -4, 7, 0, 0, 1])
    pattern = integer_bits(1.5 * 2.0**20)
    S = np.full((3, 9, W), 7.0)
    expected = S.copy()
    point_table.load_displacements(u.reshape(-1), x.reshape(-1), expected.reshape(-1), 2, finite)
    SI = S.view(np.int64)
    tables = x.reshape(-1), S.reshape(-1), SI.reshape(-1)
    point_table.start_evaluation(u.reshape(-1), *tables, finite, excess, pattern)
    wrapped = [(-int(n) * pattern + 2**63) % 2**64 - 2**63 for n in excess]
    assert (SI[:, 6:9] == np.array(wrapped).reshape(3, 1, W)).all()
    assert (S[:, :6] == expected[:, :6]).all()


@pytest.mark.nojit
def test_read_forces():
    """external + quantum times integers, rounded once to float64 each, for the free clusters only."""
    rng = np.random.default_rng(13)
    SI = rng.integers(-(2**55), 2**55, (3, 9, W))
    external, force = rng.normal(size=24), np.full(24, 9.0)
    point_table.read_forces(SI.reshape(-1), 2.0**-50, external, force)
    expected = external + (SI[:2, 6:9] * 2.0**-50).reshape(-1)
    assert (force == expected).all()


# --- fictitious densities


def densities(shares, bound):
    """Sums of eq. 11 over the bonds of all parts, as integers; and the quantum."""
    quantum, pattern = pattern_for(bound)
    total = np.zeros((sum(8 * share.points.n_owned for share in shares), 3), np.int64)
    bonds_alone = np.empty(0)  # nothing stiffens them
    for share in shares:
        S = np.zeros((share.points.n_clusters, 9, W))
        S[:, 3:6] = share.points.x.reshape(-1, 3, W)
        terms = share.bonds.added + share.bonds.taken
        SI = S.view(np.int64).reshape(-1)
        reset_forces(SI, terms, integer_bits(pattern))
        for rows in share.bonds.rows:
            bond_densities.add_densities(*rows.arrays, S.reshape(-1), SI, pattern, share.bonds.finite, bonds_alone)
        np.add.at(total, share.point, table_rows(S.view(np.int64), 6))
    return total, quantum


@pytest.mark.parametrize("finite", [True, False])
@pytest.mark.parametrize(
    "n_cells", [pytest.param((2, 1, 1), marks=pytest.mark.nojit), (4, 3, 2)], ids=["tiny", "small"]
)
def test_densities(finite, n_cells):
    """Eq. 11 with g_ij: 1/4 sum_j g_ij w_i w_j (2 c) exp(-r^2) |n_d| / r; only storage rounds."""
    whole = body(n_cells, "jittered")
    factor = np.random.default_rng(6).uniform(0.8, 6.0, whole.x.shape)
    share = part(whole, finite=finite, factor=factor)
    pairs, _ = stored_bonds([share])
    xi = np.diff(whole.x[pairs], axis=1)[:, 0]
    r = np.linalg.norm(xi, axis=1)
    f = (0.25 * 2.0 * strengths(whole, pairs, factor) / r)[:, None] * abs(xi / r[:, None])
    total, quantum = densities([share], share.bonds.stiffest)
    np.testing.assert_allclose(total * quantum, add_at(len(whole.x), pairs, f, f).astype(float), rtol=STORAGE)


@pytest.mark.parametrize("finite", [True, False])
def test_densities_do_not_depend_on_ranks_or_numbers(finite):
    """Equal integers."""
    whole = body((3, 3, 2), "jittered")
    share = part(whole, finite=finite)
    bound = share.bonds.stiffest
    expected, _ = densities([share], bound)
    assert (densities(parts(whole, 3, finite=finite), bound)[0] == expected).all()
    order = np.random.default_rng(2).permutation(len(whole.x))
    renumbered = part(whole.renumbered(order), finite=finite)
    assert (densities([renumbered], bound)[0] == expected[order]).all()


def test_slots_of_other_layout():
    """Finite and linear rows hold the same bonds."""
    whole = body((2, 2, 1))
    finite, linear = (slots(s, s.bonds.interior)[:2] for s in (part(whole), part(whole, finite=False)))
    assert all((a == b).all() for a, b in zip(finite, linear, strict=True))
