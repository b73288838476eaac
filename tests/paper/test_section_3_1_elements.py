"""Section 3.1: internal forces of the finite elements, eqs (15)-(16), on distorted hexahedra."""

import numpy as np
import pytest

from support.bodies import YOUNGS_MODULUS, build, make_scene
from support.patch import distort
from support.scikit import trilinear_elements

# Of the sum of magnitudes; forces are rounded to 2**-50 of a bound a hundred times larger. Measured 1.5e-13
ROUND_OFF = 1e-12


@pytest.mark.parametrize("poissons_ratio", [0.0, 0.25, 0.45])
def test_internal_forces_equal_those_of_scikit_fem(poissons_ratio):
    """f = A k u at random displacements of the nodes of hexahedra without any parallel faces."""
    body = distort(build(make_scene((4, 3, 3), 4, poissons_ratio=poissons_ratio), loaded=False))
    mesh, units = body.share.mesh, body.model.units
    _, _, stiffness, dofs = trilinear_elements(mesh, YOUNGS_MODULUS, poissons_ratio)
    u = np.random.default_rng(11).uniform(-1e-3, 1e-3, mesh.nodes.shape)
    vector = np.empty(u.size)
    vector[dofs.T] = u
    expected = -(stiffness @ vector)[dofs.T]
    forces = body.internal((u[body.model.nodes.number] / units.length).reshape(-1)).reshape(-1, 3)
    found = np.empty_like(expected)
    found[body.model.nodes.number] = units.force * forces
    magnitudes = (abs(stiffness) @ np.abs(vector))[dofs.T]
    assert np.abs(found - expected).max() <= ROUND_OFF * magnitudes.max()
    assert np.abs(expected).max() > 0.1 * magnitudes.max()
