"""An independent hexahedron in finite kinematics, slow and dense: total Lagrangian, St Venant and Kirchhoff.

Everything is written anew, shape functions and quadrature included; only the order of nodes (VTK) is the program's.
"""

from __future__ import annotations

from itertools import product
from typing import NamedTuple

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import spsolve

CORNERS = np.array([(-1, -1, -1), (1, -1, -1), (1, 1, -1), (-1, 1, -1), (-1, -1, 1), (1, -1, 1), (1, 1, 1), (-1, 1, 1)])


class Element(NamedTuple):
    """Strain energy, forces (8, 3) and tangent (24, 24) of one element."""

    energy: float
    force: np.ndarray
    tangent: np.ndarray


def gradients(x, place):
    """``dN_a / dx_j`` (8, 3) at a place of the reference cube, and the volume that it stands for."""
    factors = 1 + CORNERS * place
    by_place = np.stack([CORNERS[:, k] * factors[:, k - 1] * factors[:, k - 2] / 8 for k in range(3)], axis=1)
    jacobian = x.T @ by_place  # dx_i / dr_k
    return by_place @ np.linalg.inv(jacobian), np.linalg.det(jacobian)


def element(x, u, lam, mu):
    """Energy, forces and tangent of nodes at ``x``, (8, 3), displaced by ``u``."""
    energy, force, tangent = 0.0, np.zeros((8, 3)), np.zeros((8, 3, 8, 3))
    one = np.eye(3)
    for signs in product((-1, 1), repeat=3):
        gradient, volume = gradients(x, np.array(signs) / np.sqrt(3))
        place = one + u.T @ gradient  # F
        strain = 0.5 * (place.T @ place - one)
        stress = lam * np.trace(strain) * one + 2 * mu * strain
        energy += volume * 0.5 * np.tensordot(stress, strain)
        force += volume * gradient @ (place @ stress).T
        # dE/du_ai = sym(F^T (e_i grad N_a)), then its change of stress, and the geometric part
        change = 0.5 * np.einsum("ip,aq->aipq", place, gradient)
        change = change + change.swapaxes(2, 3)
        of_stress = lam * np.trace(change, axis1=2, axis2=3)[:, :, None, None] * one + 2 * mu * change
        tangent += volume * np.einsum("aipq,bjpq->aibj", change, of_stress)
        tangent += volume * np.einsum("ap,pq,bq,ij->aibj", gradient, stress, gradient, one)
    return Element(energy, force, tangent.reshape(24, 24))


def solve(x, cells, lam, mu, external, fixed, steps, tolerance=1e-13):
    """Newton's method, load step by load step: displacements (n, 3) at the end; ``fixed`` nodes do not move."""
    u, free = np.zeros_like(x), np.flatnonzero(~np.repeat(fixed, 3))
    rows = (3 * cells[:, :, None] + np.arange(3)).reshape(len(cells), 24)
    for step in range(1, steps + 1):
        while True:
            parts = [element(x[nodes], u[nodes], lam, mu) for nodes in cells]
            residual = step / steps * external.reshape(-1)
            np.subtract.at(residual, rows.reshape(-1), np.concatenate([part.force.reshape(-1) for part in parts]))
            if np.linalg.norm(residual[free]) <= tolerance * np.linalg.norm(external):
                break
            matrix = sparse.coo_array(
                (
                    np.concatenate([part.tangent.reshape(-1) for part in parts]),
                    (np.repeat(rows, 24, axis=1).reshape(-1), np.tile(rows, (1, 24)).reshape(-1)),
                ),
                shape=(x.size, x.size),
            ).tocsc()
            u.reshape(-1)[free] += spsolve(matrix[free][:, free], residual[free])
    return u
