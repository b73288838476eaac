"""The estimated error in the energy norm against the true one, and its parts against closed forms."""

import math

import numpy as np
import pytest

from pdfem_mpi.deck.loads import BodyForce, Support
from pdfem_mpi.solvers import cg
from pdfem_mpi.solvers.energy_error import Coefficients
from pdfem_mpi.solvers.preconditioner.preconditioner import make_preconditioner
from support.bodies import build, make_scene

# The estimate over the true error: 0.55 to 1.4 were found on bodies of these kinds, for residuals below a tenth
LOWEST, HIGHEST = 0.4, 2.5
EXACT = 1e-11  # tolerance of the solution that stands for the exact one

SHEAR = {
    "loads": (BodyForce(kind="body_force", face="x+", total=(0.0, 0.0, 1e-3)),),
    "supports": (Support(face="x-", x=0.0, y=0.0, z=0.0),),
}
PULLED = {"loads": (), "supports": (Support(face="x-", x=0.0, y=0.0, z=0.0), Support(face="x+", x=0.01))}
BODIES = {
    "peridynamics, free": ((16, 3, 3), 0, {}),
    "coupled, free": ((16, 3, 3), 8, {}),
    "coupled, sheared": ((16, 3, 3), 8, SHEAR),
    "peridynamics, pulled": ((16, 3, 3), 0, PULLED),
}


@pytest.mark.parametrize("name", BODIES)
def test_estimate_against_the_true_energy_error(name):
    """Loose and tight solves of the same body, compared in the energy norm with a solve to 1e-11."""
    cells, n_elements, options = BODIES[name]
    body = build(make_scene(cells, n_elements, **options))
    preconditioner = make_preconditioner(body.share, body.model, body.case)

    def solved(tolerance):
        body.state.u[:] = body.case.prescribed
        found = cg.solve(body.forces, body.state, body.case.external, body.case.fixed, tolerance, 200, preconditioner)
        return body.state.u.copy(), found

    exact, _ = solved(EXACT)
    whole = exact @ -body.internal(exact)
    for tolerance in (1e-2, 1e-3, 1e-5, 1e-7):
        u, found = solved(tolerance)
        error = u - exact
        true = math.sqrt(error @ -body.internal(error) / whole)
        assert LOWEST * true <= found.energy_error <= HIGHEST * true


def test_a_geometric_series_is_summed():
    """Steps that lower the square by 1, 1/4, 1/16, ... leave a third of the last one."""
    coefficients = Coefficients()
    for k in range(6):
        coefficients.add(0.5, 0.0, 2.0 * 0.25**k)
    assert coefficients.square_error() == pytest.approx(0.25**5 / 3.0, rel=1e-14)


def test_one_step_gives_no_estimate_and_a_standstill_a_cautious_one():
    coefficients = Coefficients()
    assert coefficients.square_error() is None
    coefficients.add(1.0, 0.0, 1.0)
    assert coefficients.square_error() is None
    coefficients.add(1.0, 0.5, 1.0)
    assert coefficients.square_error() == pytest.approx(9.0)


def test_smallest_ritz_value_becomes_the_smallest_eigenvalue():
    """Plain conjugate gradients on a diagonal matrix, as many steps as eigenvalues."""
    values = np.array([0.3, 0.7, 1.1, 2.0])
    r, p, coefficients, beta = np.array([1.0, -2.0, 0.5, 1.5]), np.zeros(4), Coefficients(), 0.0
    for _ in values:
        p = r + beta * p
        alpha = (r @ r) / (p @ (values * p))
        coefficients.add(alpha, beta, r @ r)
        after = r - alpha * values * p
        beta, r = (after @ after) / (r @ r), after
    assert coefficients.smallest_ritz() == pytest.approx(0.3, rel=1e-10)
