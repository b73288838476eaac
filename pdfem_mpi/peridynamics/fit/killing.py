"""The free motions of the fit of bond factors: the fifty symmetric Killing tensor fields of rank 3."""

from itertools import combinations_with_replacement, permutations

import numpy as np

from pdfem_mpi.kernels.dense import orthonormal_rows
from pdfem_mpi.kernels.monomials import MONOMIALS, MULTIPLICITY, N
from pdfem_mpi.mesh.rigid_motions import rigid_motions

#: Combinations weaker than this fraction of the strongest are none.
INDEPENDENT = 1e-9


def free_motions(x: np.ndarray) -> np.ndarray:
    """An orthonormal basis of the Killing tensors' values at some positions, shape (at most 50, 10 n).

    The symmetric products ``P Q R`` of three rigid motions span them; ``(v_i - v_j) . (n n n)`` is 0 for each of
    them and any two positions. Components are scaled as those of `bond_moments`.
    """
    extent = x.max(axis=0) - x.min(axis=0)
    motions = rigid_motions((x - x.min(axis=0) - 0.5 * extent) / (0.5 * extent.max()))
    values = []
    for p, q, r in combinations_with_replacement(motions, 3):
        components = np.zeros((len(x), N))
        for a, powers in enumerate(MONOMIALS):
            axes = np.repeat(np.arange(3), powers)
            for i, j, k in permutations(axes):
                components[:, a] += p[:, i] * q[:, j] * r[:, k] / 6.0
        values.append((components * np.sqrt(MULTIPLICITY)).reshape(-1))
    return orthonormal_rows(np.stack(values), INDEPENDENT)
