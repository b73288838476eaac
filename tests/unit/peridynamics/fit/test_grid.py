"""The coarse level of the fit: its tensor by quadrature, its size, and its action on slowly varying multipliers."""

import math

import numpy as np
import pytest

from pdfem_mpi.kernels.monomials import MONOMIALS, MULTIPLICITY, N
from pdfem_mpi.peridynamics.bonds import RESPONSE_CONSTANT
from pdfem_mpi.peridynamics.clusters import point_rows
from pdfem_mpi.peridynamics.fit.dissection import count_entries
from pdfem_mpi.peridynamics.fit.equations import HELD
from pdfem_mpi.peridynamics.fit.grid import MOST_ENTRIES, grid_counts, limit_of_factors, make_factor_grid, tensor
from pdfem_mpi.peridynamics.fit.operator import Operator
from support.bodies import build, make_scene

CUTOFF = 2.5


def test_tensor_is_its_integral_over_directions_and_lengths():
    """``2 pi c int exp(-r^2) r^3 dr <n_d n_e t_a t_b>`` by a quadrature over the sphere."""
    z, weight = np.polynomial.legendre.leggauss(12)
    angle = 2.0 * math.pi * np.arange(24) / 24
    s = np.sqrt(1.0 - z**2)
    n = np.stack([np.outer(s, np.cos(angle)), np.outer(s, np.sin(angle)), np.outer(z, np.ones(24))], axis=-1)
    n, weight = n.reshape(-1, 3), np.repeat(weight, 24) / 48.0
    t = np.sqrt(MULTIPLICITY) * np.prod(n[:, None, :] ** MONOMIALS, axis=2)
    r = (np.arange(20_000) + 0.5) * CUTOFF / 20_000
    radial = 2.0 * math.pi * RESPONSE_CONSTANT * (np.exp(-(r**2)) * r**3).sum() * CUTOFF / 20_000
    expected = radial * (weight * n.T[:, None, None, None] * n.T[None, :, None, None] * t.T[:, None] * t.T).sum(axis=-1)
    np.testing.assert_allclose(tensor(CUTOFF), expected, atol=1e-7)  # midpoint rule


@pytest.mark.parametrize("extent", [(200.0, 8.0, 8.0), (80.0, 60.0, 4.0), (60.0, 50.0, 40.0), (6.0, 4.0, 1.0)])
def test_grid_fits_into_its_budget(extent):
    """Four edges an element where the factors allow it, longer ones else, at least one across thin directions."""
    counts = grid_counts(np.array(extent), 1.0)
    assert count_entries(counts, N) <= MOST_ENTRIES
    if extent[0] != 60.0:
        assert (counts == np.maximum(1, np.rint(np.array(extent) / 4))).all()
    else:
        assert 4.0 < 60.0 / counts[0] < 12.0


@pytest.mark.slow
def test_grid_is_the_limit_of_the_operator_for_slow_multipliers():
    """A linear field in a block: the grid solves for its forces, and finds its energy but for what surfaces cut off."""
    body = build(make_scene((8, 8, 8), correction="none", loads=()))
    model, d = body.model, body.share
    operator = Operator(model.comm, model.points, model.bonds, np.ones(1))
    x = point_rows(model.points.x)
    slopes = np.random.default_rng(3).standard_normal((3, N))
    v = np.ascontiguousarray((x @ slopes).reshape(-1, 4, N).swapaxes(1, 2))
    product = operator.multiply(v, math.sqrt(N) * np.abs(v).max(), HELD).swapaxes(1, 2).reshape(-1, N)
    grid = make_factor_grid(
        model.comm, model.points.x, model.points.volume, d.nodes.min(axis=0), d.nodes.max(axis=0), 1.0,
        limit_of_factors(d.cutoff), np.zeros(len(x), bool), 0.0,
    )  # fmt: skip
    # C^-1 of the operator's own product gives the field back, up to its mean and the rough part
    r = np.ascontiguousarray(product.reshape(-1, 4, N).swapaxes(1, 2))
    z = np.zeros_like(r)
    grid.add_correction(model.comm, r, 2.0**-45, 1.0, z)
    found = z.swapaxes(1, 2).reshape(-1, N)
    found -= found.mean(axis=0)
    energy = (found * product).sum() / ((x @ slopes) * product).sum()
    assert 0.7 < energy < 1.1
