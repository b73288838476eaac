"""Failure beside the sweeps: ratios, energies, breaking a list, blocks and noise, against slow loops over the bonds."""

import numpy as np
import pytest
from unit.kernels.bodies import LONG, W, body, layout, part, parts, slots, stored_bonds, table_rows

from pdfem_mpi.kernels import bond_failure, bond_response, bond_sweeps, point_table
from pdfem_mpi.kernels.exact_sums import SIZE, value
from pdfem_mpi.kernels.multigrid import add_point_blocks
from pdfem_mpi.kernels.rounding import integer_bits, pattern_for
from support.point_table import reset_forces

ROUND_OFF = 1e-11  # relative: a few operations in float64 on differences of displacements, which cancel a little
STRAIN = 2e-3
SMALL = (2, 1, 1)
KINEMATICS = pytest.mark.parametrize("finite", [False, True], ids=["linear", "finite"])
SIZES = pytest.mark.parametrize(
    "cells", [pytest.param(SMALL, marks=pytest.mark.nojit), (4, 3, 2)], ids=["tiny", "small"]
)
AMPLITUDE, SEED = 0.1, 7
SINGLE = 2.0**-23  # relative: twice the rounding of a stored number; finite rows store 1 / r0^2 so


def displaced(whole, strain=STRAIN):
    """A seeded gradient and as much at random."""
    rng = np.random.default_rng(3)
    return strain * (whole.x @ rng.uniform(-0.5, 0.5, (3, 3)) + 0.2 * rng.uniform(-1.0, 1.0, whole.x.shape))


def table_of(share, u):
    S = np.zeros((share.points.n_clusters, 9, W))
    S[:, 3:6] = share.points.x.reshape(-1, 3, W)
    u = layout(u[share.point])
    point_table.load_displacements(u, share.points.x, S.reshape(-1), share.points.n_clusters, share.bonds.finite)
    return S.reshape(-1)


def stretches(whole, u, pairs, finite):
    """Eq. 3, or its linear part, in extended precision."""
    i, j = pairs.T
    x, u = whole.x.astype(LONG), u.astype(LONG)
    xi, eta = x[j] - x[i], u[j] - u[i]
    square = (xi**2).sum(axis=1)
    if not finite:
        return (eta * xi).sum(axis=1) / square, np.sqrt(square)
    return np.sqrt(((xi + eta) ** 2).sum(axis=1) / square) - 1.0, np.sqrt(square)


def energies(whole, u, pairs, stored, finite):
    """``1/2 c exp(-r0^2) g w w s^2 r0`` from the stored numbers."""
    s, r0 = stretches(whole, u, pairs, finite)
    k = stored[:, 0].astype(LONG)
    return k * s**2 * r0**2 if finite else 0.5 * k * s**2 * r0**4


def records(n):
    return np.full((n, 2), -1), np.full((n, 2), np.nan, np.float32)


# --- how near to breaking


@KINEMATICS
@SIZES
def test_largest_ratio(finite, cells):
    """The largest of s over the critical stretch of the bond's classes, of intact bonds."""
    whole = body(cells, "jittered")
    u, share = displaced(whole), part(whole, finite=finite)
    inverse = np.array([[2.0, 0.0], [0.0, 1.0]])  # bonds between the classes do not break
    class_of = (np.arange(share.points.n_clusters) % 2).astype(np.uint8)
    pairs, _ = stored_bonds([share])
    s, _ = stretches(whole, u, pairs, finite)
    of_point = np.repeat(class_of, W)
    ratios = s * inverse[of_point[pairs[:, 0]], of_point[pairs[:, 1]]]
    order = np.sort(ratios.astype(float))
    for most, expected in ((np.inf, order[-1]), (0.5 * (order[-1] + order[-2]), order[-2])):
        found = bond_failure.largest_ratio(
            *share.bonds.interior.arrays, table_of(share, u), class_of, inverse, finite, 0.0, most
        )
        assert found == pytest.approx(expected, rel=SINGLE if finite else ROUND_OFF)
    assert ratios.argmax() != s.argmax()  # the classes decide


@KINEMATICS
def test_largest_ratio_passes_over_broken_bonds(finite):
    """A bond that is gone does not count, however far its ends are apart."""
    whole = body(SMALL)
    u, share = displaced(whole), part(whole, finite=finite)
    class_of, inverse = np.zeros(share.points.n_clusters, np.uint8), np.ones((1, 1))
    table, rows = table_of(share, u), share.bonds.interior
    pairs, _ = stored_bonds([share])
    s = stretches(whole, u, pairs, finite)[0]
    order = np.argsort(s)
    worst = pairs[order[-1:]]
    assert bond_failure.break_listed(worst, *rows.arrays, finite, *records(1), np.empty(1, np.int64)) == 1
    found = bond_failure.largest_ratio(*rows.arrays, table, class_of, inverse, finite, 0.0, np.inf)
    assert found == pytest.approx(float(s[order[-2]]), rel=SINGLE if finite else ROUND_OFF)


@KINEMATICS
@SIZES
def test_largest_ratio_of_the_longer_bonds(finite, cells):
    """Bonds up to a length do not count, however far they are stretched."""
    whole = body(cells, "jittered")
    u, share = displaced(whole), part(whole, finite=finite)
    class_of, inverse = np.zeros(share.points.n_clusters, np.uint8), np.ones((1, 1))
    pairs, _ = stored_bonds([share])
    s, r0 = stretches(whole, u, pairs, finite)
    worst = r0[s.argmax()] * 1.001
    for nearest, counting in ((worst, r0 > worst), (0.0, r0 > 0.0), (2.0 * float(r0.max()), r0 < 0.0)):
        found = bond_failure.largest_ratio(
            *share.bonds.interior.arrays, table_of(share, u), class_of, inverse, finite, float(nearest) ** 2, np.inf
        )
        expected = float(s[counting].max()) if counting.any() else 0.0
        assert found == pytest.approx(expected, rel=SINGLE if finite else ROUND_OFF)


@KINEMATICS
def test_largest_ratio_is_the_same_bits_on_any_ranks(finite):
    """The maximum over the shares is that of the whole."""
    whole = body((3, 3, 2), "jittered")
    u, inverse = displaced(whole), np.full((1, 1), 400.0)

    def largest(shares):
        return max(
            bond_failure.largest_ratio(
                *rows.arrays, table_of(s, u), np.zeros(s.points.n_clusters, np.uint8), inverse, finite, 0.0, np.inf
            )
            for s in shares
            for rows in s.bonds.rows
        )

    assert largest(parts(whole, 3, finite=finite)) == largest([part(whole, finite=finite)]) > 0.0


# --- energies


def summed(shares, u):
    digits = np.zeros(SIZE, np.int64)
    for share in shares:
        for rows in share.bonds.rows:
            bond_failure.add_energies(*rows.arrays, table_of(share, u), share.bonds.finite, digits)
    return value(digits)


@KINEMATICS
@SIZES
def test_energies_of_all_bonds(finite, cells):
    """Their exact sum is that of the formula over the stored numbers."""
    whole = body(cells, "jittered")
    u, share = displaced(whole), part(whole, finite=finite)
    expected = energies(whole, u, *stored_bonds([share]), finite).sum()
    assert summed([share], u) == pytest.approx(float(expected), rel=2.0 * SINGLE if finite else ROUND_OFF)


@KINEMATICS
def test_energies_do_not_depend_on_ranks(finite):
    """Equal bits from any shares."""
    whole = body((3, 3, 2), "jittered")
    u = displaced(whole)
    assert summed(parts(whole, 3, finite=finite), u) == summed([part(whole, finite=finite)], u) > 0.0


@KINEMATICS
def test_energy_is_what_the_forces_do_work_against(finite):
    """Along a straight path the forces' work, by Simpson's rule, is the energy: eqs 2, 3 integrated."""
    whole = body(SMALL)
    share = part(whole, finite=finite)
    u = displaced(whole, 0.1 if finite else 1.0)
    sweep = bond_sweeps.SWEEPS[finite, False, False]
    quantum, pattern = pattern_for(share.bonds.strongest * 2.0**3)
    power = []
    for t in (0.0, 0.25, 0.5, 0.75, 1.0):
        S = table_of(share, t * u)
        SI = S.view(np.int64)
        reset_forces(SI, share.bonds.added - share.bonds.taken, integer_bits(pattern))
        rows = share.bonds.interior
        nothing = np.empty(0, np.uint8), np.empty(0), np.empty((0, 0)), *records(0), np.zeros(1, np.int64)
        table = bond_response.constants(pattern)
        sweep(0, len(rows.start) - 1, *rows.arrays, S, SI, table, np.zeros(2), *nothing)
        power.append(-(quantum * table_rows(SI, 6) * u[share.point]).sum())
    work = np.dot(power, (7.0, 32.0, 12.0, 32.0, 7.0)) / 90.0  # Boole's rule: sixth order
    assert summed([share], u) == pytest.approx(work, rel=1e-6)


@KINEMATICS
@SIZES
def test_energies_of_broken_bonds(finite, cells):
    """Bond by bond, from the records."""
    whole = body(cells, "jittered")
    u, share = displaced(whole), part(whole, finite=finite)
    i, j, stored = slots(share, share.bonds.interior)
    pairs, numbers = np.stack([j, i], axis=1), np.zeros((len(i), 2), np.float32)
    numbers[:, : stored.shape[1]] = stored
    found = np.full(len(i) + 1, 9.0)
    bond_failure.broken_energies(pairs, numbers, len(i), table_of(share, u), finite, found)
    expected = energies(whole, u, share.point[pairs], stored, finite).astype(float)
    np.testing.assert_allclose(found[:-1], expected, rtol=2.0 * SINGLE if finite else ROUND_OFF)
    assert found[-1] == 9.0
    if not finite:
        assert summed([share], u) == pytest.approx(found[:-1].sum(), rel=ROUND_OFF)


# --- breaking a list


@KINEMATICS
@SIZES
def test_break_listed(finite, cells):
    """The listed bonds, in either order of their points, are recorded and gone; others stand; strangers are passed."""
    whole = body(cells)
    share = part(whole, finite=finite)
    rows = share.bonds.interior
    i, j, stored = slots(share, rows)
    chosen = np.random.default_rng(4).permutation(len(i))[:20]
    wanted = np.stack([i, j], axis=1)[chosen]
    wanted[::2] = wanted[::2, ::-1]
    stranger = np.array([[0, 0]])  # no bond joins a point with itself
    pairs, strengths = records(len(chosen) + 1)
    found, listed = np.empty(len(chosen) + 1, np.int64), np.concatenate([wanted, stranger])
    count = bond_failure.break_listed(listed, *rows.arrays, finite, pairs, strengths, found)
    assert count == len(chosen)
    assert (np.sort(wanted[found[:count]], axis=1) == np.sort(pairs[:count], axis=1)).all()
    assert (np.sort(pairs[:count], axis=1) == np.sort(wanted, axis=1)).all()
    assert (strengths[:count, : stored.shape[1]] == stored[chosen]).all()
    left = np.setdiff1d(np.arange(len(i)), chosen)
    after = slots(share, rows)
    assert (after[0] == i[left]).all()
    assert (after[1] == j[left]).all()
    assert (after[2] == stored[left]).all()
    assert bond_failure.break_listed(wanted, *rows.arrays, finite, *records(len(wanted)), found) == 0  # once only


# --- blocks of broken bonds


def blocks(share, pattern):
    """All six sums of `add_point_blocks`, [cluster][entry][lane]."""
    halves = []
    for mixed in (False, True):
        S = np.zeros((share.points.n_clusters, 9, W))
        S[:, 3:6] = share.points.x.reshape(-1, 3, W)
        SI = S.view(np.int64).reshape(-1)
        reset_forces(SI, share.bonds.added + share.bonds.taken, integer_bits(pattern))
        rows = share.bonds.interior
        add_point_blocks(*rows.arrays, S.reshape(-1), SI, pattern, share.bonds.finite, mixed)
        halves.append(S.view(np.int64)[:, 6:9])
    return np.concatenate(halves, axis=1)


@KINEMATICS
@SIZES
def test_broken_blocks_are_what_the_blocks_lose(finite, cells):
    """As integers: the sums before, minus those of the broken bonds, are the sums of the others."""
    whole = body(cells, "jittered")
    share = part(whole, finite=finite)
    _, pattern = pattern_for(2.0 * share.bonds.stiffest)
    with np.errstate(over="ignore"):
        before = blocks(share, pattern)
        i, j, _ = slots(share, share.bonds.interior)
        wanted = np.stack([i, j], axis=1)[::3].copy()
        pairs, strengths = records(len(wanted))
        arrays, found = share.bonds.interior.arrays, np.empty(len(wanted), np.int64)
        assert bond_failure.break_listed(wanted, *arrays, finite, pairs, strengths, found) == len(wanted)
        lost = np.zeros_like(before).reshape(-1)
        bond_failure.add_broken_blocks(pairs, strengths, share.points.x, finite, pattern, lost)
        assert (before - lost.reshape(before.shape) == blocks(share, pattern)).all()
    assert (lost != 0).any()


# --- noise


def add_noise(share, seed=SEED):
    with np.errstate(over="ignore"):
        for rows in share.bonds.rows:
            bond_failure.add_noise(*rows.arrays, share.points.cell_number, AMPLITUDE, seed, share.bonds.finite)
    return share


@KINEMATICS
@SIZES
def test_noise_is_even_within_its_amplitude(finite, cells):
    """Factors of ``1 +- amplitude``: mean and variance of even ones; ``1 / r0^2`` is left alone; no bond twice."""
    whole = body(cells)
    pairs, before = stored_bonds([part(whole, finite=finite)])
    again, after = stored_bonds([add_noise(part(whole, finite=finite))])
    assert (pairs == again).all()
    x = (after[:, 0] / before[:, 0] - 1.0) / AMPLITUDE
    assert abs(x).max() <= 1.0 + 2.0 * SINGLE / AMPLITUDE
    n = len(x)
    assert abs(x.mean()) < 4.0 / np.sqrt(3.0 * n)  # four standard deviations
    assert abs((x**2).mean() - 1.0 / 3.0) < 4.0 * np.sqrt(4.0 / 45.0 / n)
    assert len(np.unique(x)) > 0.999 * n  # in single precision two may agree by chance
    assert (after[:, 1:] == before[:, 1:]).all()


@KINEMATICS
def test_noise_belongs_to_the_bond(finite):
    """The same on any ranks and from either end; another with another seed."""
    whole = body((3, 3, 2), "jittered")
    _, alone = stored_bonds([add_noise(part(whole, finite=finite))])
    _, shared = stored_bonds([add_noise(share) for share in parts(whole, 3, finite=finite)])
    _, other = stored_bonds([add_noise(part(whole, finite=finite), SEED + 1)])
    assert (alone == shared).all()
    assert (alone[:, 0] != other[:, 0]).mean() > 0.99
