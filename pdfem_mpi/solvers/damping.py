"""How far block smoothing may step on these cells.

``x += omega B^-1 (b - K x)`` with the nodes' 3x3 blocks ``B`` contracts while ``omega`` times the largest eigenvalue of
``B^-1 K`` is below 2, and only then a cycle made of it is positive definite. That eigenvalue was measured as 2.7 to 2.8
for cubes and as up to 3.8 for the distorted cells around holes.
"""

from __future__ import annotations

import math

import numpy as np

from pdfem_mpi.forces import Forces
from pdfem_mpi.kernels.preconditioner import add_block_products
from pdfem_mpi.loading import exact_dots

#: Steps of the power method, which find the eigenvalue from below to some per cent.
STEPS = 12
#: Largest product of damping and the eigenvalue found that is left alone, and the product that replaces a larger one.
BOUND, GOAL = 1.9, 1.8


def safe_damping(forces: Forces, blocks: np.ndarray, fixed: np.ndarray, wanted: float) -> float:
    """The damping wanted, or a smaller one that the cells need; equal on all ranks, whatever their number. Collective.

    Parameters
    ----------
    forces : Forces
        Of a model of finite elements only.
    blocks : float64, shape (n_owned, 6), dimension length / force
        Inverse blocks of the owned nodes.
    fixed : bool, shape (3 n_owned,)
    wanted : float
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
        add_block_products(False, blocks, 1.0, force, step)
        work, growth, square = exact_dots(forces.model.comm, [(x, force), (step, force), (step, step)])
        if not work > 0.0 or not square > 0.0:
            return wanted  # nothing moves
        largest = growth / work
        x = step / math.sqrt(square)
    return wanted if wanted * largest <= BOUND else GOAL / largest
