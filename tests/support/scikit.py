"""The finite elements of a mesh by scikit-fem: the oracle of the elements' tests."""

import math

import numpy as np
import skfem
from skfem.models.elasticity import lame_parameters, linear_elasticity

CORNERS = np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)])


def trilinear_elements(mesh, youngs_modulus, poissons_ratio):
    """The same hexahedra with the same 2x2x2 Gauss points.

    Returns
    -------
    body : skfem.MeshHex
    element : skfem.Element
    stiffness : sparse matrix
    dofs : int, shape (3, n_nodes)
        Rows of the stiffness for the nodes' components.
    """
    element = skfem.ElementVector(skfem.ElementHex1())
    order = [int(np.flatnonzero((place == CORNERS).all(axis=1))[0]) for place in skfem.ElementHex1.doflocs]
    body = skfem.MeshHex(np.ascontiguousarray(mesh.nodes.T), np.ascontiguousarray(mesh.cells[:, order].T))
    one = 0.5 + np.array([-0.5, 0.5]) / math.sqrt(3.0)
    points = np.stack([axis.reshape(-1) for axis in np.meshgrid(one, one, one)])
    basis = skfem.Basis(body, element, quadrature=(points, np.full(8, 1.0 / 8.0)))
    stiffness = skfem.asm(linear_elasticity(*lame_parameters(youngs_modulus, poissons_ratio)), basis)
    return body, element, stiffness, basis.nodal_dofs
