"""The coarse level of the fit of the weights of the dilatation: its limit by quadrature, and its free motions."""

import math

import numpy as np

from pdfem_mpi.kernels.dilatation_fit import N
from pdfem_mpi.peridynamics.bonds import RESPONSE_CONSTANT
from pdfem_mpi.peridynamics.clusters import point_rows
from pdfem_mpi.peridynamics.fit.dilatation import _System
from pdfem_mpi.peridynamics.fit.dilatation_grid import free_motions, limit_of_weights
from support.bodies import build, make_scene

CUTOFF = 2.5
ROOT = math.sqrt(2.0)


def tensor_of(p):
    """A symmetric tensor from its six stored components: xx, yy, zz, and sqrt(2) times yz, zx, xy."""
    xx, yy, zz, yz, zx, xy = *p[:3], *(np.asarray(p[3:]) / ROOT)
    return np.array([[xx, xy, zx], [xy, yy, yz], [zx, yz, zz]])


def test_the_limit_is_the_integral_over_bonds():
    """For a linear ``P`` and a quadratic ``v`` the expansion about a bond's middle is exact: ``D`` as it is written."""
    rng = np.random.default_rng(5)
    p, slopes = rng.standard_normal(6), rng.standard_normal((3, 6))
    gradient, second = rng.standard_normal((3, 3)), rng.standard_normal((3, 3, 3))

    def strain(x):
        return tensor_of(p + x @ slopes)

    def vector(x):
        return gradient @ x + 0.5 * np.einsum("abc,b,c->a", second + second.swapaxes(1, 2), x, x)

    z, weight = np.polynomial.legendre.leggauss(8)
    total, n_radii = 0.0, 200
    radii, of_radius = np.polynomial.legendre.leggauss(n_radii)
    radii, of_radius = 0.5 * CUTOFF * (radii + 1.0), 0.5 * CUTOFF * of_radius
    for height, share in zip(z, weight, strict=True):
        for angle in 2.0 * math.pi * np.arange(16) / 16:
            s = math.sqrt(1.0 - height**2)
            n = np.array([s * math.cos(angle), s * math.sin(angle), height])
            squares = np.zeros(n_radii)
            for k, r in enumerate(radii):
                one, two, xi = -0.5 * r * n, 0.5 * r * n, r * n
                shared = xi @ (vector(one) - vector(two))
                squares[k] = sum(((xi @ strain(x) @ xi + shared) / r) ** 2 for x in (one, two))
            total += share / 32.0 * (of_radius * np.exp(-(radii**2)) * radii**2 * squares).sum()
    expected = 0.5 * RESPONSE_CONSTANT * 4.0 * math.pi * total
    slots = {None: np.concatenate([p, np.zeros(3)])}
    slots |= {d: np.concatenate([slopes[d], gradient[:, d]]) for d in range(3)}
    found = sum(slots[d] @ table @ slots[e] for (d, e), table in limit_of_weights(CUTOFF).tables.items())
    assert math.isclose(found, expected, rel_tol=1e-12)


def test_free_motions_take_no_bond_with_them():
    """Twenty fields: the operator of a body gives them no more than round-off."""
    body = build(make_scene((3, 2, 2), correction="none", loads=(), poissons_ratio=0.33))
    model = body.model
    system = _System(model.comm, model.points, model.bonds, np.ones(1))
    motions = free_motions(point_rows(model.points.x))
    assert motions.shape == (20, N * len(point_rows(model.points.x)))
    np.testing.assert_allclose(motions @ motions.T, np.eye(20), atol=1e-12)
    rough = np.random.default_rng(1).standard_normal(motions.shape[1])
    rough /= np.linalg.norm(rough)

    def products(values):
        v = np.ascontiguousarray(values.reshape(-1, 4, N).swapaxes(1, 2))
        return np.linalg.norm(system.multiply(v, math.sqrt(N) * np.abs(v).max()))

    of_rough = products(rough)
    assert all(products(motion) < 1e-12 * of_rough for motion in motions)
