"""Two rows of a point side by side give the bits of one after the other; which of both is chosen, and by what."""

from types import SimpleNamespace

import numpy as np
import pytest
from llvmlite import binding
from unit.kernels.bodies import body, part, stored_bonds
from unit.kernels.test_peridynamics import bound_for, displacements, finite_reference, linear_reference, table_of

from pdfem_mpi.kernels import (
    abreast,
    bond_response,
    bond_sweeps,
    dilatation_sweeps,
    volumetric_sweeps,
)
from pdfem_mpi.kernels.rounding import integer_bits, pattern_for
from pdfem_mpi.kernels.simd import W
from pdfem_mpi.peridynamics.rows import Rows
from support.helpers import run_python
from support.point_table import reset_forces

AVX512 = "+avx2,+fma,+avx512f,+avx512dq,+avx512vl"
HOST = binding.get_host_cpu_name()


def told(name=None, features=None, avx=True):
    """What numba is told of the processor."""
    return SimpleNamespace(CPU_NAME=name, CPU_FEATURES=features, ENABLE_AVX=avx)


@pytest.mark.parametrize(
    ("config", "rows"),
    [
        (told("znver3"), 1),
        (told("generic", ""), 1),
        (told("znver4", AVX512), 2),
        (told(features="+avx2,+fma,-avx512f,-avx512dq,-avx512vl"), 1),
        (told(features="+avx512f"), 1),
        (told(avx=False), 1),
    ],
)
def test_the_width_is_that_of_what_numba_compiles_for(config, rows):
    """Named processors have the features that are given with the name."""
    assert abreast.rows_abreast(config) == rows


def test_this_processor_is_asked_where_nothing_is_told():
    has = {name for name, is_there in binding.get_host_cpu_features().items() if is_there}
    expected = 2 if has >= {"avx512f", "avx512dq", "avx512vl"} else 1
    assert abreast.rows_abreast(told()) == abreast.rows_abreast(told(HOST)) == expected


def test_a_process_that_takes_itself_for_another_processor_compiles_the_other_width():
    code = "from pdfem_mpi.kernels.abreast import ROWS; print(ROWS)"
    for features, rows in ((AVX512, "2"), ("+avx2,+fma", "1")):
        done = run_python("-c", code, NUMBA_CPU_NAME="znver3", NUMBA_CPU_FEATURES=features)
        assert done.stdout.split() == [rows], done.stderr


def sweep_of(name, rows):
    failing = "failing" in name
    if "linear" in name:
        return bond_sweeps.linear_sweep(failing, rows)
    return bond_sweeps.finite_sweep("closed" in name, failing, rows)


def outcome(share, u, name, rows, limit, bound, keep):
    """Forces, extremes, records and stored numbers after a sweep, in two ranges of points, over copies of the rows."""
    _, pattern = pattern_for(bound)
    S = table_of(share, u)
    SI = S.view(np.int64).reshape(-1)
    reset_forces(SI, share.bonds.added - share.bonds.taken, integer_bits(pattern))
    extremes, one_class = np.zeros(2), np.zeros(share.points.n_clusters, np.uint8)
    pairs, strengths = np.zeros((20000, 2), np.int64), np.zeros((20000, 2), np.float32)
    counter, found = np.zeros(1, np.int64), []
    sweep, table = sweep_of(name, rows), bond_response.constants(pattern)
    failing = one_class, np.array([limit]), np.array([[limit]]), pairs, strengths, counter
    for stored in share.bonds.rows:
        row = keep(stored)
        n = len(row.start) - 1
        for first, last in ((0, n // 3), (n // 3, n)):
            done = sweep(first, last, *row.arrays, S.reshape(-1), SI, table, extremes, *failing)
            assert done == last
        found.append(row.data.view(np.int32))
    n = int(counter[0])
    found += [SI.copy(), extremes.view(np.int64), pairs[:n], strengths[:n].view(np.int32)]
    return found


def as_stored(rows):
    """A copy of the rows."""
    return Rows(rows.start, rows.offset, rows.data.copy())


def of_few(rows):
    """The rows of points cut to none, one, two, three, ... of them."""
    n = np.minimum(np.diff(rows.start), np.arange(len(rows.start) - 1) % 6)
    kept = np.concatenate([np.arange(s, s + k) for s, k in zip(rows.start, n, strict=False)]).astype(np.int64)
    width = rows.data.size // rows.offset.size
    data = np.concatenate([rows.data.reshape(-1, width)[kept].reshape(-1), np.zeros(width, np.float32)])
    offset = np.append(rows.offset[kept], np.uint32(0))
    return Rows(np.concatenate([[0], np.cumsum(n)]), offset, data)


@pytest.mark.parametrize("keep", [as_stored, of_few])
@pytest.mark.parametrize("kind", ["box", "jittered"])
@pytest.mark.parametrize("name", ["series", "closed", "series failing", "closed failing", "linear", "linear failing"])
def test_rows_abreast_give_the_bits_of_one_row(name, kind, keep):
    """Forces, extremes, records and what is left in the rows, with some bonds beyond the limit."""
    whole = body((4, 3, 3), kind)
    share = part(whole, owned=np.arange(20), finite="linear" not in name)
    u = displacements(whole, 3e-3)
    reference = linear_reference if "linear" in name else finite_reference
    pairs, stored = stored_bonds([part(whole, finite="linear" not in name)])
    _, met = reference(whole, u, pairs, stored)
    limit = 3e-4 if "linear" in name else float(np.quantile(met.astype(float), 0.9))
    bound = bound_for(share, name.split()[0], float(abs(met).max()))
    one, two = (outcome(share, u, name, rows, limit, bound, keep) for rows in (1, 2))
    assert all((a == b).all() for a, b in zip(one, two, strict=True))
    assert (len(two[-1]) > 0) == ("failing" in name)
    assert two[2].any()


def dilatations(share, u, name, weighted, rows, limit):
    """Sums of the dilatations, extremes, records and stored numbers after a sweep over copies of the rows."""
    S, failing = table_of(share, u).reshape(-1), "failing" in name
    D, extremes = np.zeros(W * share.points.n_clusters), np.zeros(2)
    _, pattern = pattern_for(1.0)
    if share.bonds.finite:
        sweep, table = dilatation_sweeps.finite_sweep("closed" in name, failing, weighted, rows), None
    else:
        sweep, table = dilatation_sweeps.linear_sweep(failing, weighted, rows), pattern
    table = dilatation_sweeps.constants(pattern) if table is None else table
    pairs, strengths, counter = np.zeros((20000, 2), np.int64), np.zeros((20000, 2), np.float32), np.zeros(1, np.int64)
    one_class = np.zeros(share.points.n_clusters, np.uint8), np.array([limit]), np.array([[limit]])
    found = []
    for stored in share.bonds.rows:
        row, weights = as_stored(stored), fitted_weights(stored, weighted)
        n = len(row.start) - 1
        done = sweep(
            0, n, *row.arrays, S, D, D.view(np.int64), table, weights, extremes, *one_class, pairs, strengths, counter
        )
        assert done == n
        found.append(row.data.view(np.int32))
    n = int(counter[0])
    return [*found, D.view(np.int64), extremes.view(np.int64), pairs[:n], strengths[:n].view(np.int32)]


def fitted_weights(rows, weighted):
    n = 2 * W * len(rows.offset) if weighted else 0
    return np.random.default_rng(4).uniform(0.5, 1.5, n).astype(np.float32)


@pytest.mark.parametrize(
    ("name", "weighted"),
    [("series", False), ("series", True), ("closed", False), ("series failing", False), ("closed failing", False),
     ("linear", False), ("linear", True), ("linear failing", False)],
)  # fmt: skip
def test_dilatations_of_rows_abreast(name, weighted):
    """Sums, extremes, records and stored numbers, with some bonds beyond the limit."""
    share = part(body((4, 3, 3), "jittered"), owned=np.arange(20), finite="linear" not in name)
    u = displacements(body((4, 3, 3), "jittered"), 3e-3)
    limit = 3e-4 if "linear" in name else 1e-3
    one, two = (dilatations(share, u, name, weighted, rows, limit) for rows in (1, 2))
    assert all((a == b).all() for a, b in zip(one, two, strict=True))
    assert (len(two[-1]) > 0) == ("failing" in name)
    assert two[2].any()


@pytest.mark.parametrize("weighted", [False, True])
@pytest.mark.parametrize("name", ["series", "closed", "linear"])
def test_volumetric_forces_of_rows_abreast(name, weighted):
    share = part(body((4, 3, 3), "jittered"), owned=np.arange(20), finite=name != "linear")
    u = displacements(body((4, 3, 3), "jittered"), 3e-3)
    Q = np.random.default_rng(5).uniform(-1e-3, 1e-3, W * share.points.n_clusters)
    found = []
    for rows in (1, 2):
        _, pattern = pattern_for(1.0)
        S = table_of(share, u).reshape(-1)
        sweep = volumetric_sweeps.force_sweep(share.bonds.finite, name == "closed", weighted, rows)
        for stored in share.bonds.rows:
            last = len(stored.start) - 1
            table, weights = bond_response.constants(pattern), fitted_weights(stored, weighted)
            assert sweep(0, last, *stored.arrays, S, S.view(np.int64), table, Q, weights) == last
        found.append(S.view(np.int64).reshape(-1, 9, W)[:, 6:])
    assert (found[0] == found[1]).all()
    assert np.unique(found[0]).size > W * share.points.n_clusters
