"""The preconditioner of conjugate gradients: symmetric, positive, blind to rigid motions, close to the stiffness."""

import numpy as np
import pytest

from pdfem_mpi.deck.loads import BodyForce, Support
from pdfem_mpi.model.motions import rigid_modes
from pdfem_mpi.peridynamics.point_blocks import point_blocks
from pdfem_mpi.solvers.preconditioner.blocks import inverted, node_blocks, softest
from pdfem_mpi.solvers.preconditioner.preconditioner import make_preconditioner
from support.bodies import build, make_scene

ROUNDED = 1e-9  # relative: restrictions and inner forces are rounded to 2**-50 of bounds well above what is met
SMALLEST_RITZ, LARGEST_RITZ = 0.05, 3.0  # .2 to 2.3 were found; point-block Jacobi alone goes down to 1e-3
SINGLE = 1e-6  # relative: bonds are stored in single precision

SHEAR = {
    "loads": (BodyForce(kind="body_force", face="x+", total=(0.0, 0.0, 0.1)),),
    "supports": (Support(face="x-", x=0.0, y=0.0, z=0.0),),
}
SCENES = {
    "peridynamics, free": ((5, 3, 3), 0, {}),
    "coupled, free": ((8, 3, 2), 4, {}),
    "reading A": ((8, 3, 2), 4, {"coupling": "paper_a", "overlap": 2}),
    "elements": ((5, 3, 2), 5, {}),
    "peridynamics, held": ((5, 3, 3), 0, SHEAR),
    "coupled, held": ((8, 3, 2), 4, SHEAR),
    "finite": ((5, 3, 3), 0, {"kinematics": "finite"}),
}


@pytest.fixture(params=SCENES)
def body(request):
    cells, n_elements, options = SCENES[request.param]
    return build(make_scene(cells, n_elements, **options))


def vectors(body, n, seed=0):
    """Random residuals in balance: without part along the free rigid motions, 0 on fixed unknowns."""
    r = np.random.default_rng(seed).standard_normal((n, body.model.n_unknowns))
    r[:, body.case.fixed] = 0.0
    if len(body.case.free_motions):
        q = np.linalg.qr(np.stack(list(rigid_modes(body.model))).T)[0]
        r -= r @ q @ q.T
    return r


def applied(preconditioner, r):
    z = np.empty_like(r)
    preconditioner.apply_surely(r, float(np.abs(r).max()), z)
    return z


def test_it_is_symmetric_and_positive(body):
    """x.Py = y.Px and x.Px > 0: what conjugate gradients ask of a preconditioner."""
    preconditioner = make_preconditioner(body.share, body.model, body.case)
    x, y = vectors(body, 2)
    px, py = applied(preconditioner, x), applied(preconditioner, y)
    assert abs(x @ py - y @ px) <= ROUNDED * np.sqrt((x @ px) * (y @ py))
    assert x @ px > 0.0
    assert y @ py > 0.0


def test_fixed_unknowns_stay(body):
    """A correction never moves a prescribed displacement."""
    z = applied(make_preconditioner(body.share, body.model, body.case), vectors(body, 1)[0])
    assert (z[body.case.fixed] == 0.0).all()


def test_it_bounds_the_spectrum(body):
    """Ritz values of P K on forty unit displacements lie between bounds that do not depend on the body."""
    preconditioner = make_preconditioner(body.share, body.model, body.case)
    forces = type(body.forces)(body.model, tangent=body.model.bonds is not None and body.model.bonds.finite)
    if forces.tangent:
        forces.linearise(body.state.u, 0.0)
    free = np.flatnonzero(~body.case.fixed)
    columns = []
    for k in np.random.default_rng(2).choice(len(free), 40, replace=False):  # no rigid motion among their combinations
        u, f = np.zeros(body.model.n_unknowns), np.empty(body.model.n_unknowns)
        u[free[k]] = 1.0
        forces.evaluate_surely(u, np.zeros_like(u), f)
        f[body.case.fixed] = 0.0
        columns.append((u, -f, applied(preconditioner, -f)))
    u, k, pk = (np.array(rows) for rows in zip(*columns, strict=True))
    stiffness, both = u @ k.T, k @ pk.T  # Rayleigh quotients of P in the norm of K
    values = np.linalg.eigvals(np.linalg.solve(stiffness, both)).real
    assert values.min() > SMALLEST_RITZ
    assert values.max() < LARGEST_RITZ


def test_point_blocks_are_the_diagonal_of_the_stiffness():
    """Each block against the force of a unit displacement of its point or node."""
    body = build(make_scene((6, 3, 2), 3, correction="appendix_a"))
    model, n = body.model, 3 * body.model.unknowns.n_points
    of_points = point_blocks(model.points, model.bonds).values()
    blocks = np.concatenate([of_points[: n // 3], node_blocks(model, of_points)])
    pairs = ((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (2, 0))
    rng = np.random.default_rng(1)
    owner_of_overlap = set(model.overlap.connectivity.reshape(-1).tolist())
    for t in rng.choice(len(blocks), 12, replace=False):
        if t >= n // 3 and t - n // 3 in owner_of_overlap:
            continue  # there the block is an estimate
        places = [12 * (t // 4) + t % 4 + 4 * d if t < n // 3 else 3 * t + d for d in range(3)]
        for entry, (a, b) in enumerate(pairs):
            u = np.zeros(model.n_unknowns)
            u[places[a]] = 1.0
            assert -body.internal(u)[places[b]] == pytest.approx(blocks[t, entry], abs=SINGLE * np.abs(blocks[t]).max())


def test_soft_and_fixed_directions_of_a_block_are_held():
    """An eigenvalue of 0 is never divided by; a fixed component gets no correction."""
    body = build(make_scene((2, 2, 2)))
    blocks = np.array([[1.0, 0.0, 0.0, 0.0, 0.0, 0.0], [2.0, 4.0, 8.0, 0.0, 0.0, 0.0], [0.0] * 6])
    fixed = np.array([[False] * 3, [False, True, False], [False] * 3])
    found = inverted(blocks, fixed, softest(body.model.comm, blocks, np.ones(3)))
    expected = [[1.0, 0, 0, 0, 0, 0], [0.5, 0, 0.125, 0, 0, 0], [0.0] * 6]
    np.testing.assert_allclose(found, expected, atol=1e-15)
