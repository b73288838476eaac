"""How far block smoothing steps on these cells.

``x += omega B^-1 (b - K x)`` with the nodes' 3x3 blocks ``B`` contracts while ``omega L < 2``, with ``L`` the largest
eigenvalue of ``B^-1 K``: 2.7 to 2.8 for cubes, up to 3.8 for the distorted cells around holes. A cycle of one smoothing
before and one after its coarse correction is then positive definite by itself. The preconditioner's has ``OMEGA B^-1``
beside it, and the sum is positive on the stiffest modes while ``omega L (omega L - 2) < OMEGA L``. A product a little
above 2 uses that: it needs fewer iterations than two smoothings with 1.8 each.
"""

from __future__ import annotations

import math

import numpy as np

from pdfem_mpi.kernels.multigrid import add_block_products
from pdfem_mpi.model.forces import Forces
from pdfem_mpi.parallel.sums import exact_dots

#: Steps of the power method, which find the eigenvalue from below to some per cent.
STEPS = 12
#: Damping times the eigenvalue found.
PRODUCT = 2.3


def damping(forces: Forces, blocks: np.ndarray, fixed: np.ndarray) -> float:
    """The weight ``omega``; equal on all ranks, whatever their number. Collective.

    Parameters
    ----------
    forces : Forces
        Of a model of finite elements only.
    blocks : float64, shape (n_owned, 6), dimension length / force
        Inverse blocks of the owned nodes.
    fixed : bool, shape (3 n_owned,)
    """
    nodes = forces.model.nodes
    scattered = (nodes.number[: nodes.n_owned, None] * 3 + np.arange(3)) * 2654435761 % 2**32  # Knuth's hash
    x = (scattered / 2**31 - 1.0).reshape(-1)
    x[fixed] = 0.0
    nothing, force, step = np.zeros_like(x), np.empty_like(x), np.empty_like(x)
    largest = 0.0
    for _ in range(STEPS):
        forces.evaluate_surely(x, nothing, force)
        np.negative(force, out=force)
        force[fixed] = 0.0
        step[:] = 0.0
        add_block_products(blocks, 1.0, force, step)
        work, growth, square = exact_dots(forces.model.comm, [(x, force), (step, force), (step, step)])
        if not work > 0.0 or not square > 0.0:
            return PRODUCT  # nothing moves
        largest = growth / work
        x = step / math.sqrt(square)
    return PRODUCT / largest
