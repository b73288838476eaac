"""One sweep of appendix A and of its variant with the virial stress against numpy, and the update with its guard."""

import numpy as np
import pytest
from unit.kernels.bodies import W, add_at, body, layout, part, parts, stored_bonds, strengths, table_rows

from pdfem_mpi.kernels import correction_sweeps
from pdfem_mpi.kernels.rounding import integer_bits, pattern_for
from support.point_table import reset_forces

pytestmark = pytest.mark.filterwarnings("ignore:overflow")  # numpy's integers warn as they wrap

STORAGE = 1e-7  # of the largest sum: K rounded to float32, 6e-8, in each bond
NU = 0.25
both_layouts = pytest.mark.parametrize("finite", [True, False])
both_measures = pytest.mark.parametrize("virial", [False, True], ids=["appendix A", "virial"])
LONGEST = 1.25  # r / 2 of the longest bond, of the virial stress


def vectors(whole):
    """Seeded correction vectors between those of the bulk and of corners."""
    return np.random.default_rng(1).uniform(0.8, 6.0, whole.x.shape)


def responses(shares, factor, bound, virial=False):
    """``w_i G_d(i)``, or the virial stress, summed over the parts, as integers; and the quantum."""
    quantum, pattern = pattern_for(bound)
    total = np.zeros((sum(8 * share.points.n_owned for share in shares), 3), np.int64)
    for share in shares:
        T = np.zeros((share.points.n_clusters, 9, W))
        T[:, 0:3] = layout(factor[share.point]).reshape(-1, 3, W)
        T[:, 3:6] = share.points.x.reshape(-1, 3, W)
        TI = T.view(np.int64).reshape(-1)
        reset_forces(TI, share.bonds.added + share.bonds.taken, integer_bits(pattern))
        for rows in share.bonds.rows:
            correction_sweeps.add_responses(*rows.arrays, T.reshape(-1), TI, pattern, share.bonds.finite, virial)
        np.add.at(total, share.point, table_rows(T.view(np.int64), 6))
        assert (table_rows(T, 0) == factor[share.point]).all()
    return total, quantum


def reference(whole, pairs, factor, virial):
    """Eqs (A1)-(A4), (A8)-(A10): half of each uniaxial tension's force on one side minus the other's; or its virial."""
    i, j = pairs.T
    xi = whole.x[j] - whole.x[i]
    r = np.linalg.norm(xi, axis=1)
    normal = xi / r[:, None]
    terms = np.empty_like(normal)
    for d in range(3):
        gradient = -NU * np.eye(3)
        gradient[d, d] = 1.0
        stretch = (normal * (xi @ gradient)).sum(axis=1) / r
        measure = 0.5 * normal[:, d] * xi[:, d] if virial else abs(normal[:, d])
        terms[:, d] = strengths(whole, pairs, factor) * stretch * measure
    return add_at(len(whole.x), pairs, terms, terms).astype(float)


@both_layouts
@both_measures
@pytest.mark.parametrize(
    "n_cells", [pytest.param((2, 1, 1), marks=pytest.mark.nojit), (4, 3, 2)], ids=["tiny", "small"]
)
def test_responses(finite, virial, n_cells):
    """The force densities under three uniaxial tensions, with the current factors."""
    whole = body(n_cells, "jittered")
    share, factor = part(whole, finite=finite), vectors(whole)
    pairs, _ = stored_bonds([share])
    total, quantum = responses([share], factor, share.bonds.strongest * factor.max() * LONGEST, virial)
    expected = reference(whole, pairs, factor, virial)
    assert abs(total * quantum - expected).max() < STORAGE * abs(expected).max()


@both_layouts
@both_measures
def test_terms_fit_their_patterns(finite, virial):
    """A bond's term is at most ``strongest`` times the largest component of the correction vectors, and half of r."""
    whole = body((2, 2, 2), "jittered")
    share, factor = part(whole, finite=finite), vectors(whole)
    pairs, _ = stored_bonds([share])
    xi = np.diff(whole.x[pairs], axis=1)[:, 0]
    normal = xi / np.linalg.norm(xi, axis=1)[:, None]
    terms = strengths(whole, pairs, factor)[:, None] * ((1 + NU) * normal**2 - NU)
    terms *= 0.5 * normal * xi if virial else abs(normal)
    quantum, _ = pattern_for(share.bonds.strongest * factor.max() * (LONGEST if virial else 1.0))
    assert abs(terms).max() <= 2.0**50 * quantum


@both_layouts
def test_responses_do_not_depend_on_ranks_or_numbers(finite):
    """Equal integers."""
    whole = body((3, 3, 2), "jittered")
    share, factor = part(whole, finite=finite), vectors(whole)
    bound = share.bonds.strongest * factor.max()
    expected, _ = responses([share], factor, bound)
    assert (responses(parts(whole, 3, finite=finite), factor, bound)[0] == expected).all()
    order = np.random.default_rng(2).permutation(len(whole.x))
    renumbered = part(whole.renumbered(order), finite=finite)
    assert (responses([renumbered], factor[order], bound)[0] == expected[order]).all()


@pytest.mark.nojit
def test_infinite_response_is_its_integral():
    """Eq. A5 over all space by quadrature: c int exp(-r^2) |n_x| ((1 + nu) n_x^2 - nu) dV."""
    r = (np.arange(20_000) + 0.5) * 5e-4
    n = (np.arange(20_000) + 0.5) / 20_000
    radial = 9.0 / np.pi * (np.exp(-(r**2)) * r**2).sum() * 5e-4
    angular = 4.0 * np.pi * (n * ((1 + NU) * n**2 - NU)).mean()
    assert abs(correction_sweeps.INFINITE_RESPONSE - radial * angular) < 1e-6  # midpoint rule


def updated(integers, factor, volume, n_clusters=None, quantum=2.0**-30, target=1.7):
    """Correction vectors of three clusters after an update, what it returns, and the table."""
    T = np.full((3, 9, W), 7.0)
    T[:, 0:3] = factor
    T.view(np.int64)[:, 6:9] = integers
    before = T.copy()
    n_clusters = 3 if n_clusters is None else n_clusters
    worst = correction_sweeps.update_factors(
        n_clusters, T.reshape(-1), T.view(np.int64).reshape(-1), volume, quantum, np.full(3, target)
    )
    assert (T.view(np.int64)[:, 3:] == before.view(np.int64)[:, 3:]).all()
    return T[:, 0:3], worst


@pytest.mark.nojit
def test_update():
    """``g_c,d *= g_inf / G_d`` (A11), multiplicative, and the largest deviation before it."""
    rng = np.random.default_rng(3)
    integers = rng.integers(2**29, 2**31, (3, 3, W))
    factor, volume = rng.uniform(0.5, 5.0, (3, 3, W)), rng.uniform(0.1, 0.3, 12)
    response = integers * 2.0**-30 / volume.reshape(3, 1, W)
    result, worst = updated(integers, factor, volume)
    np.testing.assert_allclose(result, factor * 1.7 / response, rtol=1e-15)
    assert worst == abs(response / 1.7 - 1).max()


@pytest.mark.nojit
def test_a_direction_without_response_keeps_its_factor():
    """Guard of the division: G <= 0 neither updates nor counts."""
    integers = np.full((3, 3, W), 2**30)
    integers[0, 1, 2], integers[2, 0, 3] = 0, -(2**30)
    result, worst = updated(integers, np.full((3, 3, W), 2.0), np.ones(12), target=1.0)
    assert (result == 2.0).all()  # of all others G is the target
    assert worst == 0.0
    result, worst = updated(integers, np.full((3, 3, W), 2.0), np.ones(12), target=4.0)
    kept = np.argwhere(result == 2.0).tolist()
    assert kept == [[0, 1, 2], [2, 0, 3]]
    assert np.count_nonzero(result == 8.0) == 34
    assert worst == 0.75


@pytest.mark.nojit
def test_ghosts_are_left_to_their_owners():
    """Only the first clusters are updated."""
    integers = np.full((3, 3, W), 2**30)
    result, worst = updated(integers, np.ones((3, 3, W)), np.ones(12), n_clusters=1, target=3.0)
    assert (result[0] == 3.0).all()
    assert (result[1:] == 1.0).all()
    assert updated(integers, np.ones((3, 3, W)), np.ones(12), n_clusters=0)[1] == 0.0
    assert worst == 1 - 1 / 3


@both_layouts
def test_twenty_sweeps_bring_the_responses_to_the_target(finite):
    """The iteration converges: largest deviation .7 before, below .02 after."""
    whole = body((4, 4, 3))
    share = part(whole, finite=finite)
    factor, target = np.ones_like(whole.x), correction_sweeps.INFINITE_RESPONSE * 2 / 3
    worst = []
    for _ in range(correction_sweeps.SWEEPS + 1):
        total, quantum = responses([share], factor, share.bonds.strongest * factor.max())
        G = total * quantum / whole.volume[:, None]
        worst.append(abs(G / target - 1).max())
        factor = factor * target / G
    assert worst[0] > 0.7
    assert worst[-1] < 0.02
    assert (np.diff(worst) < 0).all()
